"""Lists the applications that have a stream, and changes the rules that select applications."""

from __future__ import annotations

from typing import Any

from audioflinger_hook.config.applications import ApplicationRule
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.status import Application
from device.server import AppRules, ServerSnapshot
from device.server.app_rules import app_name
from device.server.left_out import client_of, recording_clients

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
    rules = config.rules
    everyone = AppRules().select(snapshot, haptic_sink)
    if rules is not None:
        felt = {stream.index for stream in rules.select(snapshot, haptic_sink)}
    else:
        sink = getattr(source, "monitor_of", None)
        felt = {stream.index for stream in everyone if stream.device_name == sink}
    recording = recording_clients(snapshot)
    found: dict[str, Application] = {}
    for stream in everyone:
        name = app_name(stream)
        before = found.get(name, Application(name, plays=False, is_felt=False))
        why = config.left_out.why(stream, records=client_of(stream) in recording)
        takes = stream.index in felt and (is_mixed or not why)
        if not why and acting is not None and acting.rule.matches(stream):
            why = f'rule "{acting.match}"'
        found[name] = Application(
            name,
            plays=before.plays or not stream.corked,
            is_felt=before.is_felt or takes,
            rule=why or before.rule,
        )
    return tuple(found.values())[:APPLICATIONS_MAX]


def not_left_out(applications: tuple[Application, ...]) -> str:
    """Return a warning about applications that should be left out but are felt; "" for none."""
    names = [
        f"{one.name} ({one.rule})"
        for one in applications
        if one.plays and one.is_felt and one.rule and not one.rule.startswith("rule ")
    ]
    if not names:
        return ""
    return (
        f"cannot be left out, because the mixed sound is tapped: {', '.join(names)}; "
        "name them under exclude in [applications] to leave them out"
    )


def choosing(
    name: str, is_felt: bool, include: tuple[str, ...], exclude: tuple[str, ...]
) -> dict[str, tuple[str, ...]]:
    """Return the new rules, keyed by config key. is_felt: True includes, False excludes `name`."""
    rule = f"application:{name}" if ":" in name else name
    own = {name.casefold(), rule.casefold()}
    excluded = tuple(one for one in exclude if one.casefold() not in own)
    included = tuple(one for one in include if one.casefold() not in own)
    if is_felt:
        # Without include rules, all applications are included.
        included = (*included, rule) if include else ()
    else:
        excluded = (*excluded, rule)
        included = included if included or not include else include
    return {"applications.include": included, "applications.exclude": excluded}
