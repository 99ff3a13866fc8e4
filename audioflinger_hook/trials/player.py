"""Plays trials: the daemon plays sound and vibration, so that one audio clock has both."""

import os
import shlex
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from scipy.signal import resample_poly

from audioflinger_hook.config.file import names_a_device
from audioflinger_hook.daemon.trial_sound import COLUMNS, RATE_HZ
from audioflinger_hook.service.install import own_command
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_client import ask_control, ask_status
from device.address import parse_device
from device.errors import CushionError, LostError, NotFoundError, UsageError, WriteError
from device.process import started
from device.units import Float32Array

ANSWER_S = 5.0  # longest wait for an answer of the daemon
POLL_S, RENEW_S = 0.03, 0.2  # between two questions while a trial plays, and between trials
ASK_S = 0.1  # between two questions whether the daemon is ready
BEGINS_S = 20.0  # longest time until a daemon plays trials
FADED_S = 0.3  # from the end of a trial to the end of its daemon, for the fade

Frames = Path | Float32Array | None  # a file, or (frames, channels) at RATE_HZ


class NotPlayedError(LostError):
    """The device or the server was lost, or is not ready; offer the trial again after `wait`."""


@dataclass(frozen=True)
class Played:
    """What the daemon played. Times are in seconds of the audio clock (CLOCK_MONOTONIC).

    sound_began_s, vibration_began_s: when the first frame is heard and felt; None without it. Both
    are equal: the daemon aligns them by its offset.
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
    or "". Errors of all methods: NotFoundError: no daemon runs. UsageError: another program plays
    trials. InternalError: the daemon does not answer. LostError: `close` was called.
    """

    def __init__(self, clock: Callable[[], float], environ: Mapping[str, str] = os.environ) -> None:
        self._clock, self._environ, self.why_not = clock, environ, ""
        self._who, self._closing = f"{os.getpid()}-{id(self):x}", threading.Event()
        self._renewing = threading.Thread(target=self._renew, name="trial-lease", daemon=True)
        self._renewing.start()

    def status(self) -> Status:
        """Return the daemon's status."""
        return ask_status(ANSWER_S, self._clock, self._environ)

    def play(self, sound: Frames, vibration: Frames) -> Played:
        """Play both from their first frames on; return after the end.

        sound: for the default output, 1 or 2 channels. vibration: 1 channel, in shares of full
        scale before the config's gain. Both get raised-cosine ends of 50 ms, and take at most
        120 s. NotPlayedError: the device or the server was lost, or is not ready: the trial counts
        as not played. UsageError: a file cannot be played.
        """
        with RuntimeFolder(self._environ, create=False) as folder:
            file = folder.path / f"trial-{self._who}.npy"
        frames = mixed(sound, vibration)
        try:
            np.save(file, frames)
            played = self._ask(play=file.name)
            while played is None:
                self._closing.wait(POLL_S)
                played = self._ask()
        except OSError as error:
            raise WriteError(f"cannot write {file}: {error.strerror}") from error
        finally:
            file.unlink(missing_ok=True)
        if "lost" in played:
            raise NotPlayedError(f"the trial was not played: {played['lost']}")
        began_s = played.pop("began_s")
        heard_s, felt_s = (None if one is None else began_s for one in (sound, vibration))
        return Played(heard_s, felt_s, **played)

    def stop(self) -> None:
        """End the trial that plays with a fade of 50 ms. Any thread; without a trial, nothing."""
        with suppress(CushionError):
            self._ask(stop=True)

    def wait(self, timeout_s: float) -> bool:
        """Wait until a daemon can play a trial; return whether it can. `why_not` says why not."""
        for _ in range(1 + round(timeout_s / ASK_S)):
            try:
                self._ask()
            except NotFoundError as error:
                self.why_not = str(error)
            if not self.why_not:
                return True
            self._closing.wait(ASK_S)
        return False

    def close(self) -> None:
        """End the trial that plays; tapped sound is felt again. May be repeated."""
        self._closing.set()
        self._renewing.join()
        with suppress(CushionError):
            self._ask(end=True)

    def _renew(self) -> None:
        while not self._closing.wait(RENEW_S):
            with suppress(CushionError):
                self._ask()

    def _ask(self, **more: Any) -> dict[str, Any] | None:
        """Renew the lease; return what was played, None before the end of a trial."""
        if self._closing.is_set() and "end" not in more:
            raise LostError("the session of trials has ended")
        asked = {"trial": {"who": self._who, **more}}
        answer = ask_control(asked, ANSWER_S, self._clock, self._environ)
        self.why_not = str(answer["why"])
        played: dict[str, Any] | None = answer["played"]
        return played


def mixed(sound: Frames, vibration: Frames) -> Float32Array:
    """Return a trial's frames for the daemon, (frames, COLUMNS) at RATE_HZ; the shorter one ends.

    UsageError: a file cannot be played.
    """
    parts = []
    for source, most in ((sound, COLUMNS - 1), (vibration, 1)):
        frames = np.zeros((0, most), np.float32)
        if isinstance(source, Path):
            try:
                frames, rate = soundfile.read(source, dtype="float32", always_2d=True)
            except (soundfile.LibsndfileError, OSError) as error:
                raise UsageError(f"{source} cannot be played ({error})") from None
            if rate != RATE_HZ:
                frames = resample_poly(frames, RATE_HZ, rate, axis=0)
            if frames.shape[1] > most:
                raise UsageError(f"{source} has {frames.shape[1]} channels; allowed: up to {most}")
        elif source is not None:
            frames = source
        parts.append(np.broadcast_to(frames, (len(frames), most)))
    both = np.zeros((max(map(len, parts)), COLUMNS), np.float32)
    both[: len(parts[0]), :2], both[: len(parts[1]), 2:] = parts
    return np.clip(both, -1.0, 1.0)


@contextmanager
def opened(
    device: str, clock: Callable[[], float], environ: Mapping[str, str] = os.environ
) -> Iterator[DaemonPlayer]:
    """Yield a player of the daemon that plays to a device, once it plays trials.

    If no daemon runs, one is started, which ends with the block. device: its address, "" for the
    daemon's or the config's. clock: returns seconds. UsageError: no device is named, or the daemon
    plays to another. LostError: the daemon plays no trials.
    """
    wanted = str(parse_device(device)) if device else ""
    command = [*own_command(), "run", *(["--device", wanted] if wanted else [])]
    with ExitStack() as stack:
        try:
            ask_status(ANSWER_S, clock, environ)
        except NotFoundError:
            if not wanted and not names_a_device():
                raise UsageError(
                    "no device is named: give one with --device, see `cushion devices`, or try "
                    "simulated people with --simulate"
                ) from None
            child = started(command)
            stack.callback(child.wait)
            stack.callback(child.terminate)
            stack.callback(threading.Event().wait, FADED_S)
        player = stack.enter_context(closing(DaemonPlayer(clock, environ)))
        if not player.wait(BEGINS_S):
            told = f"the daemon plays no trials: {player.why_not}"
            raise LostError(f"{told}; see what `{shlex.join(command)}` says")
        address = player.status().device.address
        if wanted and address != wanted:
            told = f"the daemon plays to {address}, not to {wanted}"
            raise UsageError(f"{told}; stop it, or leave --device out")
        yield player
