"""Named PCMs (ALSA devices), and the sinks, monitors and cards that they open.

PortAudio lists ALSA's devices once, when it starts, by name. So a private ALSA configuration
defines the names, in a file in memory. ALSA reads it again when its path changes, so a PCM can
open another device each time, also a card that returns under another number.

At first every PCM opens ALSA's `null`, and `default`, which PortAudio 19.6 needs, always does. So
PortAudio starts without a sound server, and no unnamed device can play or record.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from device.errors import LostError
from device.process import memory_file

# media.role (no other program's), application.id and application.name of all our streams
ROLE, APPLICATION_ID, APPLICATION_NAME = "haptic", "haptic-cushion", "Haptic Cushion"

FALLBACK_SINK = "cushion_refuge"  # name of the silent sink that catches our output
TAG = "cushion.stream"  # property of a stream that identifies one opening of it

PLUGIN = "libasound_module_pcm_pulse.so"  # ALSA's plugin for sound servers

_REWRITTEN = ("ALSA_CONFIG_PATH", "PULSE_PROP", "PULSE_PROP_OVERRIDE")


class Pcm:
    """One name that PortAudio knows, made by `PcmConfig`.

    target: what the next opening opens, set by the thread that opens streams; it may be missing.
    """

    def __init__(self, config: PcmConfig, name: str) -> None:
        self.config = config
        self.name = name
        self.target = Target()


class PcmConfig:
    """A private ALSA configuration that defines PCMs of the given names, one word each.

    Make it before PortAudio and other threads start: it sets the environment of the process and
    its children. PULSE_LATENCY_MSEC is removed, as it would block the output, and no JACK server
    is started. The user's PULSE_PROP stays. One thread at a time uses it.

    names: of the PCMs. pcms: by name. LostError: the system has no memory for the file.
    """

    def __init__(self, *names: str) -> None:
        self.pcms: Mapping[str, Pcm] = {name: Pcm(self, name) for name in names}
        self._file = -1
        self._before = {
            name: os.environ.get(name)
            for name in (*_REWRITTEN, "PULSE_LATENCY_MSEC", "JACK_NO_START_SERVER")
        }
        os.environ.pop("PULSE_LATENCY_MSEC", None)
        os.environ["JACK_NO_START_SERVER"] = "1"
        # Later changes only exchange values: a new variable would reallocate the environment, which
        # a library's thread may be reading.
        for name in _REWRITTEN:
            os.environ[name] = self._before[name] or ""
        self._write()

    @contextmanager
    def opening(self, pcm: Pcm, tag: str, *, output: bool) -> Iterator[None]:
        """Let opening `pcm` open its target, with our properties and tag, inside this context."""
        self._write()
        theirs = self._before["PULSE_PROP"] or ""
        ours = f"application.id={APPLICATION_ID} media.role={ROLE} {TAG}={tag}"
        if output:  # on PipeWire it then ends with its sink, and does not move to the default one
            ours += " node.dont-reconnect=true"  # a tap with it could not be moved any more
        os.environ["PULSE_PROP"] = f"{theirs} {ours}".strip()
        # ALSA's plugin sets its own application name; only an override replaces it.
        os.environ["PULSE_PROP_OVERRIDE"] = f'application.name="{APPLICATION_NAME}"'
        try:
            yield
        finally:
            os.environ["PULSE_PROP"] = theirs
            os.environ["PULSE_PROP_OVERRIDE"] = self._before["PULSE_PROP_OVERRIDE"] or ""

    def close(self) -> None:
        """Remove the configuration and restore the environment, after PortAudio has ended."""
        self._use(-1)
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def _write(self) -> None:
        """Write the configuration to a new file, as ALSA may not notice a changed one."""
        text = [f"pcm.{pcm.name} {{ {pcm.target.definition} }}" for pcm in self.pcms.values()]
        try:
            file = memory_file("alsa")
            os.write(file, "\n".join([*text, "pcm.default { type null }", ""]).encode())
        except OSError as error:
            raise LostError(
                f"no ALSA configuration can be made in memory ({error.strerror}); end some other "
                "programs, and start again"
            ) from None
        os.environ["ALSA_CONFIG_PATH"] = f"/proc/{os.getpid()}/fd/{file}"  # for children, too
        self._use(file)

    def _use(self, file: int) -> None:
        before, self._file = self._file, file
        if before >= 0:
            os.close(before)


class Target:
    """The device that a PCM opens, at first none; `str()` gives its name for messages.

    trouble: why opening it may fail, and what to do.
    """

    trouble = "no device was set for this PCM"

    def __str__(self) -> str:
        return "nowhere"

    @property
    def definition(self) -> str:
        """The content of `pcm.NAME { }` in ALSA's configuration."""
        return "type null"


@dataclass(frozen=True)
class ServerDevice(Target):
    """A sink or source, by the server's name for it. server: its address; None for the default."""

    device: str
    server: str | None = None

    trouble = (
        "the sound server does not answer or has no such device; "
        "`cushion devices` lists its devices"
    )

    def __str__(self) -> str:
        return self.device

    @property
    def definition(self) -> str:
        """For ALSA's plugin for sound servers."""
        server = f" server {_quoted(self.server)}" if self.server else ""
        return f"type pulse device {_quoted(self.device)}{server}"


@dataclass(frozen=True)
class CardDevice(Target):
    """A sound card without a server, by numbers; rate, format and channels must be its own."""

    card: int
    device: int = 0

    trouble = (
        "the card was unplugged, another program uses it, or it does not support this format, "
        "rate or channel count; /proc/asound/cards lists the cards"
    )

    def __str__(self) -> str:
        return f"hw:{self.card},{self.device}"

    @property
    def definition(self) -> str:
        """For ALSA's direct access to the kernel."""
        return f"type hw card {self.card} device {self.device}"


def missing_plugin(library: str = "libasound.so.2") -> str:
    """Return that ALSA's plugin for sound servers is missing and how to get it; "" if it loads.

    Also "" where ALSA's library itself cannot be asked. Any thread may call it.
    """
    try:
        alsa = ctypes.CDLL(library)
        load, unload = alsa.snd_dlopen, alsa.snd_dlclose
    except (OSError, AttributeError):
        return ""
    load.argtypes = (ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t)
    load.restype = ctypes.c_void_p
    unload.argtypes = (ctypes.c_void_p,)
    why = ctypes.create_string_buffer(256)
    if loaded := load(PLUGIN.encode(), os.RTLD_LAZY, why, len(why)):
        unload(loaded)
        return ""
    return (
        f"ALSA's plugin for sound servers, {PLUGIN}, is missing; install the package "
        "libasound2-plugins (Debian, Ubuntu), alsa-plugins-pulseaudio (Fedora) or "
        "alsa-plugins (Arch), and start again"
    )


def _quoted(text: str) -> str:
    """Quote any text for ALSA's configuration: PipeWire accepts any sink name."""
    octal = (f"\\{byte:03o}" for byte in text.encode("utf-8", "surrogateescape"))
    plain = text.isascii() and text.isprintable() and not set(text) & set('"\\')
    return f'"{text if plain else "".join(octal)}"'
