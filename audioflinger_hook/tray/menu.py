"""The entries of the tray's menu. Pure functions of what the daemon reports."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

STEP_DB = 3.0  # change of the strength by one click


@dataclass(frozen=True)
class Entry:
    """One entry. toggle: "checkmark", "radio" or "". request: for the daemon; None: shows only."""

    label: str
    request: Mapping[str, Any] | None = None
    toggle: str = ""
    checked: bool = False


def entries(settings: Mapping[str, Any] | None, problem: str = "") -> list[Entry]:
    """Return the menu for the daemon's settings; None: no daemon is connected, for `problem`."""
    if settings is None:
        return [Entry(problem or "Connecting")]
    keys = {key["key"]: key for key in settings.get("keys", ())}
    muted = bool(settings.get("muted"))
    shown = [Entry("Vibration on", {"mute": not muted}, "checkmark", not muted)]
    if "gain_db" in keys:
        gain_db = float(keys["gain_db"]["value"])
        shown += [
            Entry(f"Strength: {gain_db:g} dB"),
            _step("Stronger", gain_db, STEP_DB, keys["gain_db"]["schema"]),
            _step("Weaker", gain_db, -STEP_DB, keys["gain_db"]["schema"]),
        ]
    if "profile" in keys:
        profile = keys["profile"]
        shown += [
            Entry(f"Profile: {name}", {"set": {"profile": name}}, "radio", name == profile["value"])
            for name in profile["schema"].get("enum", ())
        ]
    return shown


def _step(label: str, gain_db: float, step_db: float, allowed: Mapping[str, Any]) -> Entry:
    wanted_db = min(max(gain_db + step_db, allowed["minimum"]), allowed["maximum"])
    return Entry(label, {"set": {"gain_db": wanted_db}} if wanted_db != gain_db else None)
