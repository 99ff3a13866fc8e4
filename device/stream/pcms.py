"""Named PCMs: the names that PortAudio knows, and the sinks, monitors and cards they lead to.

PortAudio lists ALSA's devices once, when it starts, and then knows nothing but their names. So its
list is made of names of our own, from a private ALSA configuration. ALSA reads that again whenever
its path has changed: a PCM can be led elsewhere before each opening, with the same PortAudio. So
a card that was pulled out and plugged in again needs no new list either, whatever its number is.

Until then every PCM leads to ALSA's `null`, and PCMs called `default` always do, so that PortAudio
starts without a sound server, and nothing can play or record what nobody named. (PortAudio 19.6
aborts the process if it finds no `default`.)
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from device.errors import InternalError, UsageError
from device.stream.private_dir import PrivateDir

ROLE = "haptic"
"""media.role of all our streams; the server's other programs have no such role."""

APPLICATION_ID = "haptic-cushion"
"""application.id of all our streams."""

APPLICATION_NAME = "Haptic Cushion"
"""What mixers show for our streams."""

FALLBACK_SINK = "cushion_refuge"
"""Name of the silent sink that stands by for our output: see `guard`."""

TAG = "cushion.stream"
"""The property that holds the tag of one opening of one stream."""

_REWRITTEN = ("ALSA_CONFIG_PATH", "PULSE_PROP", "PULSE_PROP_OVERRIDE")


class Pcm:
    """One name that PortAudio knows. Made by `PcmConfig`; the thread that opens streams leads it.

    name: for PortAudio; target: what the next opening leads to.
    """

    def __init__(self, config: PcmConfig, name: str) -> None:
        self.config = config
        self.name = name
        self.target: Target = Nowhere()

    def __repr__(self) -> str:
        return f"Pcm({self.name} -> {self.target})"


class PcmConfig:
    """The private ALSA configuration with PCMs of the given names, in a folder of its own.

    Make it before PortAudio starts and before other threads do: it sets the environment, for the
    whole process and its children. PULSE_LATENCY_MSEC is dropped (it would hang the output), a
    JACK server is never started. PULSE_PROP of the user is kept, ours come after it. `close`
    removes the folder and restores the environment.

    folder: holds ours, made if missing; None for $XDG_RUNTIME_DIR/cushion, or the one for
    temporary files where that cannot be had. What processes that were killed have left there is
    removed. One thread at a time calls the methods.

    Raises
    ------
    UsageError
        The folder cannot be written.
    """

    def __init__(self, *names: str, folder: Path | None = None) -> None:
        wrong = [name for name in names if not name.isidentifier() or name == "default"]
        if wrong or len(set(names)) != len(names) or not names:
            raise InternalError(f"PCMs cannot be called {', '.join(names)}: one word each")
        self.pcms: Mapping[str, Pcm] = {name: Pcm(self, name) for name in names}
        self._folder = PrivateDir(folder)
        self._version = 0
        self._before = {
            name: os.environ.get(name)
            for name in (*_REWRITTEN, "PULSE_LATENCY_MSEC", "JACK_NO_START_SERVER")
        }
        os.environ.pop("PULSE_LATENCY_MSEC", None)
        os.environ["JACK_NO_START_SERVER"] = "1"
        # Later on values are only exchanged, which no thread of a library can trip over; a new
        # variable would move the whole environment under one that is reading it.
        for name in _REWRITTEN:
            os.environ[name] = self._before[name] or ""
        self._write()

    @contextmanager
    def opening(self, pcm: Pcm, tag: str, *, output: bool) -> Iterator[None]:
        """A context in which opening `pcm` leads to its device, with our properties and this tag.

        output: whether it is opened for playback.

        Connections to the server made meanwhile by other threads carry these properties as well;
        only streams mind. One thread at a time may be in this context.
        """
        self._write()
        theirs = self._before["PULSE_PROP"] or ""
        # ALSA names itself as the application: only an override changes that.
        os.environ["PULSE_PROP"] = f"{theirs} {_properties(tag, output)}".strip()
        os.environ["PULSE_PROP_OVERRIDE"] = f'application.name="{APPLICATION_NAME}"'
        try:
            yield
        finally:
            os.environ["PULSE_PROP"] = theirs
            os.environ["PULSE_PROP_OVERRIDE"] = self._before["PULSE_PROP_OVERRIDE"] or ""

    def close(self) -> None:
        """Remove the folder and restore the environment, once PortAudio has ended."""
        self._folder.close()
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def _write(self) -> None:
        """Write the configuration under a new name: ALSA could take a changed file for the old."""
        old = self._folder.path / f"{self._version}.conf"
        self._version += 1
        new = self._folder.path / f"{self._version}.conf"
        text = [f"pcm.{pcm.name} {{ {pcm.target.definition} }}" for pcm in self.pcms.values()]
        try:
            new.write_text("\n".join([*text, "pcm.default { type null }", ""]))
        except OSError as error:
            raise UsageError(
                f"{new} cannot be written ({error.strerror}); make room there, or set "
                "XDG_RUNTIME_DIR or TMPDIR to another folder"
            ) from None
        os.environ["ALSA_CONFIG_PATH"] = str(new)
        old.unlink(missing_ok=True)


def _properties(tag: str, output: bool) -> str:
    """The properties by which a stream is known, in the form that PULSE_PROP takes.

    node.dont-reconnect is PipeWire's: an output whose sink is missing or vanishes then ends, where
    it would be led to the default sink. A tap goes without: it could not be moved any more.
    """
    ending = " node.dont-reconnect=true" if output else ""
    return f"application.id={APPLICATION_ID} media.role={ROLE} {TAG}={tag}{ending}"


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
