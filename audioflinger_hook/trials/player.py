"""Plays trials: the daemon plays sound and vibration, so that one audio clock has both."""

import json
import os
import shlex
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import resample_poly

from audioflinger_hook.config.file import names_a_device
from audioflinger_hook.daemon.trial_sound import COLUMNS, RATE_HZ
from audioflinger_hook.service.install import own_command
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import ExposureFigures, Status
from audioflinger_hook.service.status_client import NO_DAEMON, ask_status
from audioflinger_hook.service.status_server import NAME, PROTOCOL
from audioflinger_hook.sources.file import FileTap
from device.address import parse_device
from device.errors import InternalError, LostError, NotFoundError, UsageError, WriteError
from device.process import started
from device.units import Float32Array

ANSWER_S = 5.0  # longest wait for the daemon, in addition to the trial
ASK_S = 0.1  # between two questions whether the daemon is ready
BEGINS_S = 20.0  # longest time until a daemon plays trials
FADED_S = 0.3  # from the end of a trial to the end of its daemon, for the fade

Frames = Path | Float32Array | None


class NotPlayedError(LostError):
    """The device or the server was lost, or is not ready; offer the trial again after `wait`."""


@dataclass(frozen=True)
class Played:
    """What the daemon played. Times are in seconds of the audio clock (CLOCK_MONOTONIC).

    sound_began_s, vibration_began_s: when the first frame is heard and felt; None without this
    file. Both are equal: the daemon aligns them by its offset.
    seconds: duration that was played. stopped: whether `stop` ended it early, with a fade.
    level_dbfs: r.m.s. over the duration of the strongest actuator's signal: the vibration as sent
    to the device, after gain, damping and protection; at least -150.
    protection_db: largest attenuation by protection that was seen, 0 to 150.
    a8_m_s2, vdv_m_s175: exposure by this trial alone (see `Exposure`); None without a rig. Of
    several trials, squares of A(8) and fourth powers of VDV add up.
    """

    sound_began_s: float | None
    vibration_began_s: float | None
    seconds: float
    stopped: bool
    level_dbfs: float
    protection_db: float
    a8_m_s2: float | None
    vdv_m_s175: float | None


class DaemonPlayer:
    """Plays one trial at a time through the user's daemon. Until `close`, no other sound is felt.

    clock: returns seconds. why_not: why the daemon could not play a trial when it was last asked,
    or "". NotFoundError: no daemon runs. UsageError: another program plays trials.
    """

    def __init__(self, clock: Callable[[], float], environ: Mapping[str, str] = os.environ) -> None:
        self._clock, self._environ = clock, environ
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

    @property
    def status(self) -> Status:
        """The daemon's status. For errors, see `ask_status`."""
        return ask_status(ANSWER_S, self._clock, self._environ)

    def exposure(self) -> ExposureFigures | None:
        """Return the exposure of today, None without a rig. For errors, see `ask_status`."""
        return self.status.exposure

    def play(self, sound: Frames, vibration: Frames) -> Played:
        """Play both from their first frames on; return after the end.

        sound: file of 1 or 2 channels for the default output, or None. vibration: file of one
        channel, in shares of full scale before the config's gain; or None. Frames at RATE_HZ,
        (frames, channels), may replace a file. Both get raised-cosine ends of 50 ms. An asynchrony
        of a study is silence at the beginning of one of them; together they take at most 120 s.

        NotPlayedError: the device or the server was lost, or is not ready. The trial counts as not
        played: call `wait`, then offer it again. UsageError: a file is not usable. NotFoundError:
        no daemon runs. LostError, InternalError: the daemon has ended or does not answer.
        """
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
        """End the trial that plays with a fade of 50 ms. Any thread; without a trial, nothing."""
        if self._plays:
            with suppress(LostError):
                self._say({"stop": True})

    def wait(self, timeout_s: float) -> bool:
        """Wait until the daemon can play a trial; return whether it can."""
        pause = threading.Event()
        for _ in range(1 + round(timeout_s / ASK_S)):
            if not self._ready():
                return True
            pause.wait(ASK_S)
        return False

    def close(self) -> None:
        """End the trial that plays; tapped sound is felt again. May be repeated."""
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


def mixed(sound: Frames, vibration: Frames) -> Float32Array:
    """Return a trial's frames for the daemon, (frames, COLUMNS) at RATE_HZ; the shorter one ends.

    UsageError: a file is not usable, or neither is given.
    """
    if sound is None and vibration is None:
        raise UsageError("a trial needs a sound or a vibration")
    heard, felt = _read(sound, 2), _read(vibration, 1)
    both = np.zeros((max(len(heard), len(felt)), COLUMNS), np.float32)
    both[: len(heard), :2] = heard
    both[: len(felt), 2:] = felt
    return np.clip(both, -1.0, 1.0)


def _read(source: Frames, most: int) -> Float32Array:
    """Return frames at RATE_HZ, (frames, channels)."""
    if not isinstance(source, Path):
        return np.zeros((0, 1), np.float32) if source is None else source
    parts = []
    with closing(FileTap(source)) as tap:
        if tap.channels > most:
            raise UsageError(f"{source} has {tap.channels} channels; allowed: up to {most}")
        while (part := tap.read()) is not None:
            parts.append(part)
    frames = np.concatenate(parts)
    if tap.samplerate != RATE_HZ:
        frames = resample_poly(frames, RATE_HZ, tap.samplerate, axis=0).astype(np.float32)
    return frames


@contextmanager
def opened(
    device: str, clock: Callable[[], float], environ: Mapping[str, str] = os.environ
) -> Iterator[DaemonPlayer]:
    """Yield a player of the daemon that plays to a device, once it plays trials.

    If no daemon runs, one is started, which ends with the block. device: its address, "" for the
    daemon's or the config's. clock: returns seconds. UsageError: no device is named, or the daemon
    plays to another. LostError: the daemon plays no trials.
    """
    wanted, child = str(parse_device(device)) if device else "", None
    pause = threading.Event().wait
    with ExitStack() as stack:
        try:
            ask_status(ANSWER_S, clock, environ)
        except NotFoundError:
            if not wanted and not names_a_device():
                raise UsageError(
                    "no device is named: give one with --device, see `cushion devices`, or try "
                    "simulated people with --simulate"
                ) from None
            command = [*own_command(), "run", *(["--device", wanted] if wanted else [])]
            child = started(command)
            stack.callback(child.wait)
            stack.callback(child.terminate)
            stack.callback(pause, FADED_S)
        for _ in range(round(BEGINS_S / ASK_S)):
            if child is not None and child.poll() is not None:
                raise LostError(f"the daemon has ended; see what `{shlex.join(command)}` says")
            with suppress(NotFoundError):
                player = stack.enter_context(closing(DaemonPlayer(clock, environ)))
                break
            pause(ASK_S)
        else:
            raise LostError("the daemon does not begin")
        address = player.status.device.address
        if wanted and address != wanted:
            told = f"the daemon plays to {address}, not to {wanted}"
            raise UsageError(f"{told}; stop it, or leave --device out")
        if not player.wait(BEGINS_S):
            raise LostError(f"the daemon plays no trials: {player.why_not}")
        yield player
