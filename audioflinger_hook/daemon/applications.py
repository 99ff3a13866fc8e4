"""Lists the applications that have a stream."""

from dataclasses import replace
from typing import Any

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.status import Application
from device.server import AppRules, ServerSnapshot
from device.server.app_rules import app_name
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
