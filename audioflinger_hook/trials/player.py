"""Plays trials of sound and vibration, and measures them by reports of the daemon."""

import math
import shlex
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from scipy.integrate import trapezoid
from scipy.signal import resample_poly

from audioflinger_hook.config.file import names_a_device
from audioflinger_hook.service.install import own_command
from audioflinger_hook.service.meters import FLOOR_DBFS, RMS_TIME_S
from audioflinger_hook.service.status import ExposureFigures, Status
from audioflinger_hook.service.status_client import ask_control, ask_status
from audioflinger_hook.trials.stream import COLUMNS, RATE_HZ, Trial, TrialStream
from device.address import parse_device
from device.errors import LostError, NotFoundError, UsageError
from device.process import started
from device.stream.pcms import PcmConfig
from device.stream.portaudio import filter_stderr
from device.units import Float32Array, amplitude_to_db, db_to_amplitude

PCM = "cushion_trials"
ANSWER_S = 5.0  # longest wait for an answer of the daemon
POLL_S, ASK_S = 0.03, 0.1  # between two looks during a trial, and before one
BEGINS_S = 20.0  # longest time until a daemon plays trials
LATE_S = 3.0  # a trial whose end comes later than this was lost
FADES_S = 0.5  # from a stop to the end of the fade
AFTER_S = 0.1  # from the last frame at the device to the last look at the levels

Frames = Path | Float32Array | None  # a file, or (frames, channels) at RATE_HZ


class NotPlayedError(LostError):
    """The device or the server was lost, or is not ready; offer the trial again after `wait`."""


@dataclass(frozen=True)
class Played:
    """What was played. Times are in seconds of the audio clock (CLOCK_MONOTONIC).

    sound_began_s, vibration_began_s: when the first frame is heard and felt; None without it.
    stopped: whether `stop` ended it early. level_dbfs: r.m.s. of the strongest actuator's signal
    after gain, damping and protection. protection_db: largest attenuation by protection.
    a8_m_s2, vdv_m_s175: exposure by this trial alone; None without a rig. Of several trials,
    squares of A(8) and fourth powers of VDV add up.
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

    clock: returns time.monotonic(). why_not: why no trial could be played at the last look, or "".
    Errors of `status`, `play` and `wait`: NotFoundError: no daemon runs. UsageError: another
    program plays trials. InternalError: the daemon does not answer. LostError: `close` was called.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self.why_not = clock, ""
        self._pcms = PcmConfig(PCM)
        self._stream: TrialStream | None = None
        self._trial: Trial | None = None
        self._playing, self._closed = threading.Lock(), threading.Event()
        self._stops = threading.Event()

    def status(self) -> Status:
        """Return the daemon's status."""
        return ask_status(ANSWER_S, self._clock)

    def play(self, sound: Frames, vibration: Frames) -> Played:
        """Play both from their first frames on; return after the end.

        sound: for the default output, 1 or 2 channels. vibration: 1 channel, in shares of full
        scale before the config's gain. Both get raised-cosine ends of 50 ms. NotPlayedError: the
        device or the server was lost, or is not ready: the trial counts as not played. UsageError:
        a file cannot be played.
        """
        frames = mixed(sound, vibration)
        with self._playing:
            readings, before, lost = [self._look()], self.status().exposure, self.why_not
            lead_s, later_s = (readings[0].get(name, 0.0) for name in ("lead_s", "felt_s"))
            trial = self._trial = Trial(frames, lead_s)
            if self._stops.is_set():
                trial.stops = True
            late_s = self._clock() + len(frames) / RATE_HZ + abs(lead_s) + LATE_S
            if self._stream is not None and sound is not None:
                lost = lost or self._stream.why_silent
            if self._stream is not None and not lost:
                self._stream.play(trial)
            try:
                while not lost and self._clock() < trial.ends_s + later_s + AFTER_S:
                    self._closed.wait(POLL_S)
                    readings.append(self._look())
                    is_late = math.isinf(trial.ends_s) and self._clock() > late_s
                    lost = self.why_not or "the stream of trials stands still" * is_late
                stopped = trial.stops
            finally:
                trial.stops = True
            if lost:
                self._closed.wait(FADES_S)
                raise NotPlayedError(f"the trial was not played: {lost}")
            seconds = trial.played / RATE_HZ - abs(lead_s)
            began_s = trial.began_s + max(0.0, lead_s) + later_s
            heard_s, felt_s = (None if one is None else began_s for one in (sound, vibration))
            levels, exposure = measured(readings, seconds), exposed(before, self.status().exposure)
            return Played(heard_s, felt_s, seconds, stopped, *levels, *exposure)

    def stop(self) -> None:
        """End this trial with a fade of 50 ms, and each one before `may_play`. Any thread."""
        self._stops.set()
        if self._trial is not None:
            self._trial.stops = True

    def may_play(self) -> None:
        """Forget earlier stops."""
        self._stops.clear()

    def wait(self, timeout_s: float) -> bool:
        """Wait until a trial can be played; return whether it can. `why_not` says why not."""
        for _ in range(1 + round(timeout_s / ASK_S)):
            try:
                self._look()
            except NotFoundError as error:
                self.why_not = str(error)
            if not self.why_not:
                return True
            self._closed.wait(ASK_S)
        return False

    def close(self) -> None:
        """End the trial that plays with a fade; tapped sound is felt again. May be repeated."""
        self._closed.set()
        self.stop()
        with self._playing:
            if self._trial is not None and self._clock() < self._trial.ends_s:
                threading.Event().wait(FADES_S)
            self._end_stream()
        self._pcms.close()

    def _look(self) -> dict[str, Any]:
        """Return what the daemon says of trials; find `why_not`. Open or renew the stream."""
        if self._closed.is_set():
            raise LostError("the session of trials has ended")
        found: dict[str, Any] = ask_control({"trial": True}, ANSWER_S, self._clock)
        self.why_not = found["why"]
        try:
            if self._stream is None and not self.why_not:
                self._stream = TrialStream(self._pcms.pcms[PCM], self.status().device.name)
            if self._stream is not None:
                self.why_not = self.why_not or self._stream.why_not(self._clock())
            if not found["ready"]:
                self.why_not = self.why_not or "the daemon prepares trials"
        except (LostError, NotFoundError) as error:
            self._end_stream()
            self.why_not = str(error)
        return found

    def _end_stream(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()


def measured(readings: Sequence[Mapping[str, Any]], seconds: float) -> tuple[float, float]:
    """Return the level of a trial in dBFS, and the attenuation by protection in dB.

    readings: what the daemon said from the beginning to the end. seconds: duration of the trial.
    """
    times_s, squares, gains = (
        np.array([one[name] for one in readings]) for name in ("seconds", "mean_squares", "gain")
    )
    # the mean square of the input, as the readings follow it with a time constant
    energies_s = trapezoid(squares, times_s, axis=0) + RMS_TIME_S * (squares[-1] - squares[0])
    level = np.sqrt(max(0.0, energies_s.max()) / max(seconds, 1.0 / RATE_HZ))
    least = db_to_amplitude(FLOOR_DBFS)
    return amplitude_to_db(max(level, least)), abs(amplitude_to_db(max(gains.min(), least)))


def exposed(before: ExposureFigures | None, now: ExposureFigures | None) -> list[float | None]:
    """Return A(8) and VDV between two readings of the day's exposure; None without a rig."""
    if before is None or now is None:
        return [None, None]
    both = (before.a8_m_s2, now.a8_m_s2, 2), (before.vdv, now.vdv, 4)
    return [max(0.0, after**power - then**power) ** (1.0 / power) for then, after, power in both]


def mixed(sound: Frames, vibration: Frames) -> Float32Array:
    """Return (frames, COLUMNS) of a trial at RATE_HZ. UsageError: a file cannot be played."""
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
def opened(device: str, clock: Callable[[], float]) -> Iterator[DaemonPlayer]:
    """Yield a player once it plays trials to a device, "" for the daemon's or the config's.

    If no daemon runs, one is started, which ends with the block. UsageError: no device is named, or
    the daemon plays to another. LostError: the daemon plays no trials.
    """
    wanted = str(parse_device(device)) if device else ""
    command = [*own_command(), "run", *(["--device", wanted] if wanted else [])]
    with ExitStack() as stack:
        child = None
        try:
            ask_status(ANSWER_S, clock)
        except NotFoundError:
            if not wanted and not names_a_device():
                raise UsageError(
                    "no device is named: give one with --device, see `cushion devices`, or try "
                    "simulated people with --simulate"
                ) from None
            child = started(command)
            stack.callback(child.wait)
            stack.callback(child.terminate)
        filter_stderr()
        player = stack.enter_context(closing(DaemonPlayer(clock)))
        late_s = clock() + BEGINS_S
        while not player.wait(POLL_S):
            if clock() > late_s or (child and child.poll() is not None):
                told = f"the daemon plays no trials: {player.why_not}"
                raise LostError(f"{told}; see what `{shlex.join(command)}` says")
        address = player.status().device.address
        if wanted and address != wanted:
            told = f"the daemon plays to {address}, not to {wanted}"
            raise UsageError(f"{told}; stop it, or leave --device out")
        yield player
