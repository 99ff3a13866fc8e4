"""Who uses a card now, and how it was opened, as the kernel reports it."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from device.alsa.cards import PlaybackDevice, read_fields, read_text

DEVICES = Path("/dev/snd")

_CLOSED = "closed"


@dataclass(frozen=True)
class HwParams:
    """How a card was opened. format: ALSA's name. samplerate: Hz."""

    format: str
    samplerate: int
    channels: int
    period_frames: int
    buffer_frames: int

    @property
    def delay_s(self) -> float:
        """Seconds from the card's request for a frame until it plays it.

        It asks when a period is free; the rest of its buffer precedes that frame.
        """
        return (self.buffer_frames - self.period_frames) / self.samplerate


@dataclass(frozen=True)
class Owner:
    """Who has opened a card. process: its id, or that of the thread. name: "" if unknown."""

    process: int
    name: str

    def __str__(self) -> str:
        return f"{self.name or 'another program'} (process {self.process})"


def read_hw_params(playback: PlaybackDevice) -> tuple[HwParams, ...]:
    """Return how the device was opened, once per open stream; usually one.

    Empty while it is closed. Entries that cannot be parsed are left out.
    """
    opened = []
    for folder in _substreams(playback):
        found = read_fields(folder / "hw_params")
        with suppress(KeyError, ValueError, IndexError):
            opened.append(
                HwParams(
                    found["format"],
                    int(found["rate"].split()[0]),
                    int(found["channels"]),
                    int(found["period_size"]),
                    int(found["buffer_size"]),
                )
            )
    return tuple(opened)


def find_owner(playback: PlaybackDevice, processes: Path = Path("/proc")) -> Owner | None:
    """Return who uses the device; None if a stream of it is free."""
    first = None
    for folder in _substreams(playback):
        status = folder / "status"
        if read_text(status).strip() in (_CLOSED, ""):
            return None
        digits = read_fields(status).get("owner_pid", "")
        if first is None and digits.isdecimal():
            thread = processes / digits
            process = read_fields(thread / "status").get("Tgid", digits)
            first = Owner(int(process), read_text(processes / process / "comm").strip())
    return first


def why_blocked(
    playback: PlaybackDevice, devices: Path = DEVICES, processes: Path = Path("/proc")
) -> str | None:
    """Return why a device cannot be opened, and what to do, in one line; None if it can.

    devices: the directory of device files.
    """
    node = devices / f"pcmC{playback.card.number}D{playback.device}{playback.folder.name[-1]}"
    if node.exists() and not os.access(node, os.R_OK | os.W_OK):
        return (
            f"this user may not open {playback} ({node}); log in at the machine itself, or join "
            "the group audio"
        )
    user = find_owner(playback, processes)
    if user is None:
        return None
    return (
        f"{playback} is in use by {user}; end that program, or name the sink that the sound server "
        "has for this card (see `cushion devices`)"
    )


def _substreams(playback: PlaybackDevice) -> list[Path]:
    return sorted(playback.folder.glob("sub*"))
