"""Named PCMs (ALSA devices), and the sinks, monitors and cards that they open.

PortAudio reads the names of ALSA's devices only once, when it starts. Therefore a private ALSA
configuration, a file in memory, defines fixed names. ALSA reads the configuration again when the
file's path changes, so that the same name can then open another device.

At first every PCM opens ALSA's `null` device. The PCM `default`, which PortAudio 19.6 needs, always
opens `null`. Therefore PortAudio can start without a sound server. PortAudio finds no other PCMs.
"""

import ctypes
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from device.errors import LostError
from device.process import memory_file

# media.role (used by no other program), application.id and application.name of all our streams
ROLE, APPLICATION_ID, APPLICATION_NAME = "haptic", "haptic-cushion", "Haptic Cushion"

FALLBACK_SINK = "cushion_refuge"  # name of the silent sink that receives our moved streams
TAG = "cushion.stream"  # property with a value that is unique for each opened stream

PLUGIN = "libasound_module_pcm_pulse.so"  # ALSA's plugin for sound servers

_REWRITTEN = ("ALSA_CONFIG_PATH", "PULSE_PROP", "PULSE_PROP_OVERRIDE")


class Pcm:
    """A PCM of a `PcmConfig`, which PortAudio finds by `name`. target: device that it opens."""

    def __init__(self, config: "PcmConfig", name: str) -> None:
        self.config, self.name, self.target = config, name, Target()


class PcmConfig:
    """A private ALSA configuration that defines one PCM for each given name.

    Make this object before PortAudio and other threads start: the constructor changes the
    environment of the process. It removes PULSE_LATENCY_MSEC, which would block the output, and
    prevents the start of a JACK server. The user's properties in PULSE_PROP are kept. Only one
    thread at a time may use the object. names: one word each. role: media.role of the streams; with
    any role except ROLE, the daemon treats them as streams of another application. pcms: PCMs by
    name. LostError: the file in memory cannot be made.
    """

    def __init__(self, *names: str, role: str = ROLE) -> None:
        self._role = role
        self.pcms: Mapping[str, Pcm] = {name: Pcm(self, name) for name in names}
        self._file = -1
        self._before = {
            name: os.environ.get(name)
            for name in (*_REWRITTEN, "PULSE_LATENCY_MSEC", "JACK_NO_START_SERVER")
        }
        os.environ.pop("PULSE_LATENCY_MSEC", None)
        os.environ["JACK_NO_START_SERVER"] = "1"
        # Later changes only exchange values: a new variable would reallocate the environment while
        # another thread may read it.
        for name in _REWRITTEN:
            os.environ[name] = self._before[name] or ""
        self._write()

    @contextmanager
    def opening(self, pcm: Pcm, tag: str, *, output: bool) -> Iterator[None]:
        """Let `pcm` open its target inside this context; the stream gets our properties and tag."""
        self._write()
        theirs = self._before["PULSE_PROP"] or ""
        ours = f"media.role={self._role}"
        if self._role == ROLE:
            ours = f"application.id={APPLICATION_ID} {ours} {TAG}={tag}"
        if output:  # PipeWire then ends an output whose sink vanishes, instead of moving it
            ours += " node.dont-reconnect=true"  # a capture needs to be movable
        os.environ["PULSE_PROP"] = f"{theirs} {ours}".strip()
        # ALSA's plugin sets its own application name; only this override replaces it.
        os.environ["PULSE_PROP_OVERRIDE"] = f'application.name="{APPLICATION_NAME}"'
        try:
            yield
        finally:
            os.environ["PULSE_PROP"] = theirs
            os.environ["PULSE_PROP_OVERRIDE"] = self._before["PULSE_PROP_OVERRIDE"] or ""

    def close(self) -> None:
        """Remove the configuration and restore the environment. PortAudio must have ended."""
        self._use(-1)
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def _write(self) -> None:
        """Write the configuration to a new file, because ALSA may not notice changes of a file."""
        text = [f"pcm.{pcm.name} {{ {pcm.target.definition} }}" for pcm in self.pcms.values()]
        try:
            file = memory_file("alsa")
            os.write(file, "\n".join([*text, "pcm.default { type null }", ""]).encode())
        except OSError as error:
            raise LostError(
                f"no ALSA configuration can be made in memory ({error.strerror}); end some other "
                "programs, and start again"
            ) from None
        os.environ["ALSA_CONFIG_PATH"] = f"/proc/{os.getpid()}/fd/{file}"  # valid in children, too
        self._use(file)

    def _use(self, file: int) -> None:
        before, self._file = self._file, file
        if before >= 0:
            os.close(before)


class Target:
    """The device that a PCM opens, `null` by default; `str()` gives its name for messages."""

    trouble = "no device was set for this PCM"  # possible cause and remedy if opening fails

    def __str__(self) -> str:
        return "nowhere"

    @property
    def definition(self) -> str:
        """The content of `pcm.NAME { }` in ALSA's configuration."""
        return "type null"


@dataclass(frozen=True)
class ServerDevice(Target):
    """A sink or source on a sound server. server: address of the server; None for the default."""

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
        """Definition for ALSA's plugin for sound servers."""
        server = f" server {_quoted(self.server)}" if self.server else ""
        return f"type pulse device {_quoted(self.device)}{server}"


@dataclass(frozen=True)
class CardDevice(Target):
    """A card's device, used without a sound server; only the card's own rates and formats work."""

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
        """Definition for ALSA's plugin for direct access to the card."""
        return f"type hw card {self.card} device {self.device}"


def missing_plugin(library: str = "libasound.so.2") -> str:
    """Return how to install ALSA's plugin for servers; "" if it is there or cannot be checked."""
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
    """Quote any text for ALSA's configuration, because PipeWire accepts any sink name."""
    octal = (f"\\{byte:03o}" for byte in text.encode("utf-8", "surrogateescape"))
    plain = text.isascii() and text.isprintable() and not set(text) & set('"\\')
    return f'"{text if plain else "".join(octal)}"'
