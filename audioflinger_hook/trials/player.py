"""Plays trials: the daemon plays sound and vibration, so that one audio clock has both."""

import json
import os
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from scipy.signal import resample_poly

from audioflinger_hook.daemon.trial_sound import COLUMNS, RATE_HZ
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status_client import NO_DAEMON
from audioflinger_hook.service.status_server import NAME, PROTOCOL
from audioflinger_hook.sources.file import FileTap
from device.errors import InternalError, LostError, NotFoundError, UsageError, WriteError
from device.units import Float32Array

ANSWER_S = 5.0  # longest wait for the daemon, in addition to the trial
ASK_S = 0.1  # between two questions whether the daemon is ready


class NotPlayedError(LostError):
    """The device or the server was lost, or is not ready; offer the trial again after `wait`."""


@dataclass(frozen=True)
class Played:
    """What the daemon played. Times are in seconds of the audio clock (CLOCK_MONOTONIC).

    sound_began_s, vibration_began_s: when the first frame is heard and felt; None without this
    file. Both are equal: the daemon aligns them by its offset.
    seconds: duration that was played. stopped: whether `stop` ended it early, with a fade.
    peak_dbfs, level_dbfs: peak, and r.m.s. over the duration, of the strongest actuator's signal:
    the vibration as sent to the device, after gain, damping and protection; at least -150. Within
    some seconds after a louder trial, the peak may be an upper bound.
    protection_db: largest attenuation by protection that was seen, 0 to 150. limited_blocks:
    number of blocks of 2 ms in which protection limited the vibration.
    a8_m_s2, vdv_m_s175: exposure by this trial alone (see `Exposure`); None without a rig. Of
    several trials, squares of A(8) and fourth powers of VDV add up.
    """

    sound_began_s: float | None
    vibration_began_s: float | None
    seconds: float
    stopped: bool
    peak_dbfs: float
    level_dbfs: float
    protection_db: float
    limited_blocks: int
    a8_m_s2: float | None
    vdv_m_s175: float | None


class Player(Protocol):
    """Plays one trial at a time. While it is open, tapped sound is not felt.

    `DaemonPlayer` asks the running daemon. A test or a simulation may give its own.
    """

    def play(self, sound: Path | None, vibration: Path | None) -> Played:
        """Play both files from their first frames on; return after the end.

        sound: file of 1 or 2 channels for the default output, or None. vibration: file of one
        channel, or a .npy file of mono float32 at 48 kHz, in shares of full scale before the
        config's gain; or None. Both get raised-cosine ends of 50 ms. An asynchrony of a study is
        silence at the beginning of one of the files; both together take at most 120 s.

        NotPlayedError: the device or the server was lost, or is not ready. The trial counts as not
        played: call `wait`, then offer it again. UsageError: a file is not usable. NotFoundError:
        no daemon runs. LostError, InternalError: the daemon has ended or does not answer.
        """
        ...

    def stop(self) -> None:
        """End the trial that plays with a fade of 50 ms. Any thread; without a trial, nothing."""
        ...

    def wait(self, timeout_s: float) -> bool:
        """Wait until the daemon can play a trial; return whether it can."""
        ...

    def close(self) -> None:
        """End the trial that plays; tapped sound is felt again. May be repeated."""
        ...


class DaemonPlayer:
    """Plays trials through this user's daemon; implements `Player`.

    why_not: why the daemon could not play a trial when it was last asked, or "".
    NotFoundError: no daemon runs. UsageError: another program plays trials.
    """

    def __init__(self, environ: Mapping[str, str] = os.environ) -> None:
        self._lines = b""
        self._plays = False
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._folder = RuntimeFolder(environ, create=False)
            self._socket.connect(self._folder.address(NAME))
        except (NotFoundError, FileNotFoundError, ConnectionRefusedError) as error:
            self._socket.close()
            raise NotFoundError(NO_DAEMON) from error
        self._file = self._folder.path / f"trial-{os.getpid()}.npy"
        try:
            self._say({"ask": "trials", "protocol": PROTOCOL})
            self._heard(ANSWER_S)
            self._ready()
        except BaseException:
            self.close()
            raise

    def play(self, sound: Path | None, vibration: Path | None) -> Played:
        """Play both files; see `Player`."""
        frames = mixed(sound, vibration)
        try:
            np.save(self._file, frames)
        except OSError as error:
            raise WriteError(f"cannot write {self._file}: {error.strerror}") from error
        self._plays = True
        try:
            self._say({"play": self._file.name})
            answer = self._heard(len(frames) / RATE_HZ + 2.0 * ANSWER_S)
        finally:
            self._plays = False
            self._file.unlink(missing_ok=True)
        if "lost" in answer:
            raise NotPlayedError(f"the trial was not played: {answer['lost']}")
        began_s = answer.pop("began_s")
        heard_s, felt_s = (None if path is None else began_s for path in (sound, vibration))
        return Played(heard_s, felt_s, **answer)

    def stop(self) -> None:
        """End the trial that plays with a fade."""
        if self._plays:
            with suppress(LostError):
                self._say({"stop": True})

    def wait(self, timeout_s: float) -> bool:
        """Wait until the daemon can play a trial; see `Player`."""
        pause = threading.Event()
        for _ in range(1 + round(timeout_s / ASK_S)):
            if not self._ready():
                return True
            pause.wait(ASK_S)
        return False

    def close(self) -> None:
        """End the session with the daemon. May be repeated."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # wakes `play` in another thread
        self._socket.close()
        self._folder.close()

    def _ready(self) -> str:
        self._say({"ready": True})
        self.why_not = str(self._heard(ANSWER_S).get("why", ""))
        return self.why_not

    def _say(self, document: dict[str, Any]) -> None:
        try:
            self._socket.sendall(json.dumps(document).encode() + b"\n")
        except OSError as error:
            raise LostError(_ENDED) from error

    def _heard(self, timeout_s: float) -> dict[str, Any]:
        """Return the daemon's next line. UsageError: the daemon refuses the request."""
        while b"\n" not in self._lines:
            try:
                self._socket.settimeout(timeout_s)
                received = self._socket.recv(65_536)
            except TimeoutError:
                raise InternalError("the daemon does not answer; restart it") from None
            except OSError:  # `close` was called
                received = b""
            if not received:
                raise LostError(_ENDED)
            self._lines += received
        line, _, self._lines = self._lines.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise UsageError(f"the daemon refuses the trial: {answer['error']}")
        return answer


_ENDED = "the daemon has ended; start it again with `cushion run`, and repeat the command"


def mixed(sound: Path | None, vibration: Path | None) -> Float32Array:
    """Return a trial's frames for the daemon, (frames, COLUMNS) at 48 kHz; the shorter file ends.

    UsageError: a file is not usable, or neither is given.
    """
    if sound is None and vibration is None:
        raise UsageError("a trial needs a sound or a vibration")
    heard, felt = (
        np.zeros((0, 1), np.float32) if path is None else _read(path) for path in (sound, vibration)
    )
    for path, frames, most in ((sound, heard, 2), (vibration, felt, 1)):
        if frames.shape[1] > most:
            raise UsageError(f"{path} has {frames.shape[1]} channels; allowed: up to {most}")
    both = np.zeros((max(len(heard), len(felt)), COLUMNS), np.float32)
    both[: len(heard), :2] = heard
    both[: len(felt), 2:] = felt
    return np.clip(both, -1.0, 1.0)


def _read(path: Path) -> Float32Array:
    """Return a file's frames at 48 kHz, (frames, channels)."""
    if path.suffix == ".npy":
        try:
            return np.asarray(np.load(path, allow_pickle=False), np.float32).reshape(-1, 1)
        except (OSError, ValueError, EOFError) as error:
            raise UsageError(f"{path} is no array of numbers ({error})") from None
    tap, parts = FileTap(path), []
    try:
        while (part := tap.read()) is not None:
            parts.append(part)
    finally:
        tap.close()
    frames = np.concatenate(parts)
    if tap.samplerate != RATE_HZ:
        frames = resample_poly(frames, RATE_HZ, tap.samplerate, axis=0).astype(np.float32)
    return frames
