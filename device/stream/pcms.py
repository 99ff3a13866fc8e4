"""Named PCMs (ALSA devices), and the sinks, monitors and cards that they open.

PortAudio lists ALSA's devices once, when it starts, by name. So a private ALSA configuration
defines the names. ALSA reads it again when its path changes, so a PCM can open another device each
time, also a card that returns under another number.

At first every PCM opens ALSA's `null`, and `default`, which PortAudio 19.6 needs, always does. So
PortAudio starts without a sound server, and no unnamed device can play or record.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from device.errors import UsageError
from device.stream.pulse_plugin import missing_plugin

PREFIX = "cushion-alsa-"
_ATTEMPTS = 10
_OPEN = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class PrivateDir:
    """A new directory that only this user may enter, held until `close`. For one thread.

    inside: its parent, made if missing. None stands for $XDG_RUNTIME_DIR/cushion, or the directory
    for temporary files where that is not possible. path: of the directory. UsageError: no directory
    can be made there.
    """

    def __init__(self, inside: Path | None = None) -> None:
        parent = inside or runtime_dir() or Path(tempfile.gettempdir())
        try:
            parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            remove_stale(parent)
            self.path, self._lock_file = _make(parent)
        except OSError as error:
            raise UsageError(
                f"the ALSA configuration cannot be written to {parent} ({error.strerror}); set "
                "XDG_RUNTIME_DIR or TMPDIR to a folder that can be written"
            ) from None

    def close(self) -> None:
        """Remove the directory with its content. May be repeated; raises nothing."""
        if self._lock_file >= 0:
            shutil.rmtree(self.path, ignore_errors=True)
            os.close(self._lock_file)
            self._lock_file = -1


def runtime_dir() -> Path | None:
    """Return $XDG_RUNTIME_DIR/cushion, made if missing; None if other users may enter it."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    if not base.startswith("/") or set(base) & set(" :"):  # where ALSA splits a path
        return None
    folder = Path(base) / "cushion"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except (OSError, ValueError):
        return None
    private = stat.S_ISDIR(found.st_mode) and not stat.S_IMODE(found.st_mode) & 0o077
    return folder if private and found.st_uid == os.geteuid() else None


def remove_stale(parent: Path) -> int:
    """Remove this user's directories that no process holds, and count them; raises nothing."""
    with suppress(OSError):
        return sum(map(_remove_if_stale, list(parent.glob(f"{PREFIX}*"))))
    return 0


def _remove_if_stale(folder: Path) -> bool:
    try:
        held = os.open(folder, _OPEN)
    except OSError:
        return False
    try:
        if os.fstat(held).st_uid != os.geteuid():
            return False
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
        return True
    except OSError:  # a process holds it
        return False
    finally:
        os.close(held)


def _make(parent: Path) -> tuple[Path, int]:
    """Return a new directory and the descriptor that locks it."""
    for _ in range(_ATTEMPTS):
        path = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        try:
            held = os.open(path, _OPEN)
        except FileNotFoundError:
            continue
        fcntl.flock(held, fcntl.LOCK_EX)
        # Another process may have removed it before it was locked.
        with suppress(FileNotFoundError):
            if os.path.samestat(path.lstat(), os.fstat(held)):
                return path, held
        os.close(held)
    raise UsageError(f"another program keeps removing directories in {parent}; stop that program")


# media.role (no other program's), application.id and application.name of all our streams
ROLE, APPLICATION_ID, APPLICATION_NAME = "haptic", "haptic-cushion", "Haptic Cushion"

FALLBACK_SINK = "cushion_refuge"
"""Name of the silent sink that catches our output: see `FallbackSink`."""

TAG = "cushion.stream"  # property of a stream that identifies one opening of it

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
    """A private ALSA configuration that defines PCMs of the given names.

    Make it before PortAudio and other threads start: it sets the environment of the process and
    its children. PULSE_LATENCY_MSEC is removed, as it would block the output, and no JACK server
    is started. The user's PULSE_PROP stays, and ours follows it. One thread at a time uses it.

    Parameters
    ----------
    names : str
        Of the PCMs, one word each.
    folder : Path or None
        Parent of the private directory; see `PrivateDir`.

    Attributes
    ----------
    pcms : Mapping[str, Pcm]
        The PCMs by name.

    Raises
    ------
    UsageError
        The directory cannot be written.
    """

    def __init__(self, *names: str, folder: Path | None = None) -> None:
        self.pcms: Mapping[str, Pcm] = {name: Pcm(self, name) for name in names}
        self._folder = PrivateDir(folder)
        self._version = 0
        self._before = {
            name: os.environ.get(name)
            for name in (*_REWRITTEN, "PULSE_LATENCY_MSEC", "JACK_NO_START_SERVER")
        }
        os.environ.pop("PULSE_LATENCY_MSEC", None)
        os.environ["JACK_NO_START_SERVER"] = "1"
        # Later changes only exchange values, which is safe while a library's thread reads them.
        # A new variable would reallocate the whole environment.
        for name in _REWRITTEN:
            os.environ[name] = self._before[name] or ""
        self._write()

    @contextmanager
    def opening(self, pcm: Pcm, tag: str, *, output: bool) -> Iterator[None]:
        """Return a context in which opening `pcm` opens its target with our properties and tag.

        output: whether it is opened for playback. One thread at a time may be in this context.
        """
        self._write()
        theirs = self._before["PULSE_PROP"] or ""
        # ALSA's plugin sets its own application name; only an override replaces it.
        os.environ["PULSE_PROP"] = f"{theirs} {_properties(tag, output)}".strip()
        os.environ["PULSE_PROP_OVERRIDE"] = f'application.name="{APPLICATION_NAME}"'
        try:
            yield
        finally:
            os.environ["PULSE_PROP"] = theirs
            os.environ["PULSE_PROP_OVERRIDE"] = self._before["PULSE_PROP_OVERRIDE"] or ""

    def close(self) -> None:
        """Remove the directory and restore the environment, after PortAudio has ended."""
        self._folder.close()
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def _write(self) -> None:
        """Write the configuration to a new path, as ALSA may not notice a changed file."""
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
    """Return our stream's properties in the form of PULSE_PROP.

    node.dont-reconnect is PipeWire's: without it, an output that loses its sink would move to the
    default sink; with it, the output ends. A tap does without, as it could not be moved any more.
    """
    ending = " node.dont-reconnect=true" if output else ""
    return f"application.id={APPLICATION_ID} media.role={ROLE} {TAG}={tag}{ending}"


class Target:
    """The device that a PCM opens, at first none; `str()` gives its name for messages."""

    trouble = "no device was set for this PCM"
    """Why opening it may fail, and what to do."""

    def __str__(self) -> str:
        return "nowhere"

    def missing(self) -> str:
        """Return what this machine lacks to open it, and how to get it; "" for nothing."""
        return ""

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
        "`cushion devices` lists what it has"
    )

    def __str__(self) -> str:
        return self.device

    def missing(self) -> str:
        """Return that ALSA's plugin for sound servers is missing; "" if it is there."""
        return missing_plugin()

    @property
    def definition(self) -> str:
        """For ALSA's plugin for sound servers."""
        server = f" server {_quoted(self.server)}" if self.server else ""
        return f"type pulse device {_quoted(self.device)}{server}"


@dataclass(frozen=True)
class CardDevice(Target):
    """A sound card without a server, by the numbers of card and device.

    Without a plugin in between, rate, format and channels must be the card's own.
    """

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


def _quoted(text: str) -> str:
    """Quote any text for ALSA's configuration: PipeWire accepts any sink name."""
    octal = (f"\\{byte:03o}" for byte in text.encode("utf-8", "surrogateescape"))
    plain = text.isascii() and text.isprintable() and not set(text) & set('"\\')
    return f'"{text if plain else "".join(octal)}"'
