"""What a PCM can lead to, in the language of ALSA's configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from device.errors import UsageError


class Target(Protocol):
    """Where one opening of a PCM leads; `str()` of it is its name for people."""

    @property
    def definition(self) -> str:
        """What stands between the braces of `pcm.NAME { }`."""
        ...

    @property
    def trouble(self) -> str:
        """What may be wrong if it cannot be opened, and what to do."""
        ...


@dataclass(frozen=True)
class Nowhere:
    """Nothing is played there, and nothing recorded."""

    definition = "type null"
    trouble = "nobody has said where it leads"

    def __str__(self) -> str:
        return "nowhere"


@dataclass(frozen=True)
class ServerDevice:
    """A sink or source of the sound server, by the server's name for it.

    server: its address, None for the usual one.

    Raises
    ------
    UsageError
        The name is empty.
    """

    device: str
    server: str | None = None

    trouble = (
        "the sound server does not answer or has no such device; "
        "`cushion devices` lists what it has"
    )

    def __post_init__(self) -> None:
        if not self.device:
            raise UsageError('the name of a device cannot be ""; give a sink\'s name')

    def __str__(self) -> str:
        return self.device

    @property
    def definition(self) -> str:
        """ALSA's plugin for sound servers."""
        server = f" server {_quoted(self.server)}" if self.server else ""
        return f"type pulse device {_quoted(self.device)}{server}"


@dataclass(frozen=True)
class CardDevice:
    """A sound card itself, by the numbers of card and device.

    No plugin stands in between: rate, format and channels are the card's own, or it does not open.
    """

    card: int
    device: int = 0

    trouble = (
        "the card was pulled out, something else plays there, or it has no such format, rate or "
        "channels; /proc/asound/cards lists what there is"
    )

    def __str__(self) -> str:
        return f"hw:{self.card},{self.device}"

    @property
    def definition(self) -> str:
        """ALSA's way to the kernel."""
        return f"type hw card {self.card} device {self.device}"


def _quoted(text: str) -> str:
    """Text as ALSA reads it from a configuration, whatever is in it.

    PipeWire lets anything be a sink's name, and the default sink is not ours to choose.
    """
    octal = (f"\\{byte:03o}" for byte in text.encode("utf-8", "surrogateescape"))
    plain = text.isascii() and text.isprintable() and not set(text) & set('"\\')
    return f'"{text if plain else "".join(octal)}"'
