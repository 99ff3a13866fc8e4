"""The [[application]] rule that acts: that of the application that began to play last."""

from dataclasses import replace

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.daemon.run_config import RunConfig
from device.drive.settings import GAIN_MIN_DB
from device.server import AppRules, ServerSnapshot
from device.server.app_rules import first_match
from device.server.forwarding import sinks_heard_on
from device.server.left_out import microphones_of


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
            selected = (config.rules or AppRules()).select(snapshot, haptic_sink)
            playing = {
                one.index: one
                for one in selected
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
