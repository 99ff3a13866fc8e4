"""Lists the applications that have a stream, and finds the [[application]] rule that acts."""

from dataclasses import replace
from typing import Any

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.status import Application
from device.drive.settings import GAIN_MIN_DB
from device.server import AppRules, ServerSnapshot
from device.server.app_rules import app_name, first_match
from device.server.forwarding import sinks_heard_on
from device.server.left_out import REASONS, microphones_of

APPLICATIONS_MAX = 32  # the status shows at most this number of applications


def applications_in(
    snapshot: ServerSnapshot | None,
    config: RunConfig,
    source: Any,
    haptic_sink: str | None,
    acting: ApplicationRule | None = None,
    *,
    is_mixed: bool = False,
) -> tuple[Application, ...]:
    """Return at most APPLICATIONS_MAX applications that have a stream. Any thread may call it.

    source: the monitor that is captured if the config has no rules. haptic_sink: sink of the
    vibration; streams to it are left out. acting: the rule that acts. is_mixed: whether a monitor
    is tapped, so that no stream can be left out.
    """
    if snapshot is None:
        return ()
    rules, mixed = config.rules, set[int]()
    everyone = AppRules().select(snapshot, haptic_sink)
    if rules is not None:
        felt = {stream.index for stream in rules.select(snapshot, haptic_sink)}
    else:
        sink = getattr(source, "monitor_of", None)
        heard = sinks_heard_on(snapshot, sink) if sink else ()
        felt = {stream.index for stream in everyone if stream.device_name in heard}
        if not is_mixed:
            mixed = {one.index for one in everyone if one.index in felt and one.device_name != sink}
    microphones = microphones_of(snapshot)
    found: dict[str, Application] = {}
    for stream in everyone:
        name = app_name(stream)
        before = found.get(name, Application(name, plays=False, is_felt=False))
        why = config.left_out.why(stream, microphones)
        takes = stream.index in felt and (is_mixed or stream.index in mixed or not why)
        if not why and acting is not None and acting.rule.matches(stream):
            why = f'rule "{acting.match}"'
        found[name] = Application(
            name,
            plays=before.plays or not stream.corked,
            is_felt=before.is_felt or takes,
            rule=why or before.rule,
        )
    whole = {app_name(stream) for stream in everyone if is_mixed or stream.index in mixed}
    return tuple(
        replace(one, rule=f"part left out: {one.rule}")
        if one.is_felt and one.rule in REASONS and one.name not in whole
        else one
        for one in found.values()
    )[:APPLICATIONS_MAX]


def not_left_out(applications: tuple[Application, ...]) -> str:
    """Return a warning about applications that should be left out but are felt; "" for none."""
    names = ", ".join(
        f"{one.name!r} ({one.rule})"
        for one in applications
        if one.plays and one.is_felt and one.rule in REASONS
    )
    return names and (
        "these applications are felt, although they should be left out, because the mixed sound "
        f"is tapped: {names}; name them under exclude in [applications]"
    )


class ActingRule:
    """Finds the rule that acts. Only one thread may call `update`. rule: it, None without one."""

    def __init__(self) -> None:
        self.rule: ApplicationRule | None = None
        self._playing: list[int] = []  # indexes of streams, in the order in which they began

    def update(
        self,
        snapshot: ServerSnapshot | None,
        config: RunConfig,
        haptic_sink: str | None,
        tapped_sink: str | None = None,
    ) -> bool:
        """Look at the streams that play; return whether another rule acts now.

        haptic_sink: sink of the vibration; streams to it have no rule. tapped_sink: only streams
        that are heard there have a rule; None for all.
        """
        before, self.rule = self.rule, None
        if snapshot is not None and config.live.application_rules:
            heard = None if tapped_sink is None else sinks_heard_on(snapshot, tapped_sink)
            playing = {
                one.index: one
                for one in (config.rules or AppRules()).select(snapshot, haptic_sink)
                if not (one.corked or one.mute) and (heard is None or one.device_name in heard)
            }
            self._playing = [index for index in self._playing if index in playing]
            self._playing += sorted(playing.keys() - set(self._playing))
            microphones = microphones_of(snapshot)
            rules = [(r.rule, r) for r in config.live.application_rules if r.profile or r.gain_db]
            for index in self._playing:  # the newest stream's rule acts
                rule: ApplicationRule | None = first_match(rules, playing[index])
                if rule is not None and not config.left_out.why(playing[index], microphones):
                    self.rule = rule
        return self.rule != before


def with_rule(config: RunConfig, rule: ApplicationRule | None) -> RunConfig:
    """Return a config with the rule's profile, and its gain added to the user's gain."""
    if rule is None:
        return config
    settings = config.settings
    if rule.profile is not None:
        settings = settings.choosing(profile=rule.profile)
    gain_db = max(GAIN_MIN_DB, settings.gain_db + rule.gain_db)
    return replace(config, settings=settings.choosing(gain_db=gain_db))
