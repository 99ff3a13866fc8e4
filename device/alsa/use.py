"""Who plays on a card just now, and how: the kernel's word, not PortAudio's."""

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
    """How a card was opened. format: ALSA's name; period, buffer: in frames."""

    format: str
    samplerate: int
    channels: int
    period: int
    buffer: int

    @property
    def delay_s(self) -> float:
        """From when the card asks for a frame until it plays it, in seconds.

        It asks once a period is free: all else of its buffer is before that frame.
        """
        return (self.buffer - self.period) / self.samplerate


@dataclass(frozen=True)
class Owner:
    """Who has opened a card. process: its number, or that of the thread that did; name: "" if
    unknown.
    """

    process: int
    name: str

    def __str__(self) -> str:
        return f"{self.name or 'another program'} (process {self.process})"


def read_hw_params(playback: PlaybackDevice) -> tuple[HwParams, ...]:
    """How the device was opened, once for everybody who plays there; mostly one. Any thread.

    None while it is closed; what is not understood is left out.
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
    """Who plays there, None while it is free for us. Any thread."""
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
    """Why it cannot be opened now, and what to do, one line; None if nothing speaks against it.

    devices: the folder of device files. Any thread.
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
        f"{playback} is in use by {user}; end what plays there, or name the sink of the sound "
        "server that it is, see `cushion devices`"
    )


def _substreams(playback: PlaybackDevice) -> list[Path]:
    return sorted(playback.folder.glob("sub*"))
