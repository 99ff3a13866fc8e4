"""What a USB device's sound card says of its volume and mute, for commands that list devices."""

from __future__ import annotations

import math
from typing import Any

from device.alsa.mixer import CardMixer
from device.errors import CushionError
from device.usb import UsbAudioDevice


def mixer_of(device: UsbAudioDevice) -> dict[str, Any]:
    """Return the controls of a device's cards, for JSON.

    Levels in dB by channel, None for silence; of a volume whose steps mean nothing in dB they are
    left out. problem: why something could not be read, None where nothing speaks against it.
    """
    volumes: list[dict[str, Any]] = []
    mutes: list[dict[str, Any]] = []
    problem = None
    for card in device.cards:
        if not card.playback:
            continue
        try:
            with CardMixer(card.number) as mixer:
                for volume in mixer.volumes:
                    told: dict[str, Any] = {"name": volume.name}
                    levels, decibels = mixer.volume_db(volume), volume.decibels
                    if levels is not None and decibels is not None:
                        told["db"] = [_finite(level) for level in levels]
                        told["lowest_db"] = _finite(decibels.lowest_db)
                        told["highest_db"] = _finite(decibels.highest_db)
                    volumes.append(told)
                for switch in mixer.switches:
                    mutes.append({"name": switch.name, "muted": list(mixer.muted(switch))})
        except CushionError as error:
            problem = str(error)
    return {"volumes": volumes, "mutes": mutes, "problem": problem}


def mixer_lines(mixer: dict[str, Any]) -> list[str]:
    """Return the same for people."""
    lines = []
    for each in mixer["volumes"]:
        shown = "in steps of unknown size"
        if "db" in each:
            now = ", ".join(dict.fromkeys(map(_level, each["db"])))
            shown = f"{now}, {_level(each['lowest_db'])} to {_level(each['highest_db'])}"
        lines.append(f"{each['name']} of the sound card: {shown}")
    for each in mixer["mutes"]:
        shown = "muted" if all(each["muted"]) else "partly muted" if any(each["muted"]) else ""
        lines.append(f"{each['name']} of the sound card: {shown or 'not muted'}")
    if mixer["problem"]:
        lines.append(f"volume of the sound card unknown: {mixer['problem']}")
    return lines


def volume_now(mixer: dict[str, Any]) -> str:
    """Return the loudest channel's level, or "muted"; "" where it is unknown."""
    if any(each["muted"] and all(each["muted"]) for each in mixer["mutes"]):
        return "muted"
    levels = [level for each in mixer["volumes"] for level in each.get("db", ())]
    heard = [level for level in levels if level is not None]
    if levels and not heard:
        return "silence"
    return f"{max(heard):+.1f} dB" if heard else ""


def _finite(level_db: float) -> float | None:
    return level_db if math.isfinite(level_db) else None


def _level(level_db: float | None) -> str:
    return "silence" if level_db is None else f"{level_db:+.2f} dB"
