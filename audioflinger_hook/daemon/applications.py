"""Lists the applications that have a stream, and changes the rules that select applications."""

from __future__ import annotations

from typing import Any

from audioflinger_hook.service.status import Application
from device.server import AppRules, ServerSnapshot
from device.server.app_rules import app_name

APPLICATIONS_MAX = 32  # the status shows at most this number of applications


def applications_in(
    snapshot: ServerSnapshot | None, rules: AppRules | None, source: Any, haptic_sink: str | None
) -> tuple[Application, ...]:
    """Return at most APPLICATIONS_MAX applications that have a stream. Any thread may call it.

    rules: select the captured applications. source: the monitor that is captured if `rules` is
    None. haptic_sink: sink of the vibration; streams to it are left out.
    """
    if snapshot is None:
        return ()
    everyone = AppRules().select(snapshot, haptic_sink)
    if rules is not None:
        felt = {stream.index for stream in rules.select(snapshot, haptic_sink)}
    else:
        sink = getattr(source, "monitor_of", None)
        felt = {stream.index for stream in everyone if stream.device_name == sink}
    found: dict[str, Application] = {}
    for stream in everyone:
        name = app_name(stream)
        before = found.get(name, Application(name, plays=False, is_felt=False))
        found[name] = Application(
            name,
            plays=before.plays or not stream.corked,
            is_felt=before.is_felt or stream.index in felt,
        )
    return tuple(found.values())[:APPLICATIONS_MAX]


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
