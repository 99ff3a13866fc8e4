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
from scipy.signal import resample_poly

from audioflinger_hook.config.file import names_a_device
from audioflinger_hook.daemon.trial_sound import COLUMNS, RATE_HZ
from audioflinger_hook.service.install import own_command
from audioflinger_hook.service.runtime_folder import RuntimeFolder
from audioflinger_hook.service.status import Status
from audioflinger_hook.service.status_client import ask_control, ask_status
from audioflinger_hook.sources.file import FileTap
from device.address import parse_device
from device.errors import CushionError, LostError, NotFoundError, UsageError, WriteError
from device.process import started
from device.units import Float32Array

ANSWER_S = 5.0  # longest wait for an answer of the daemon
POLL_S, RENEW_S = 0.03, 0.2  # between two questions while a trial plays, and between trials
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
    or "". Errors of all methods: NotFoundError: no daemon runs. UsageError: another program plays
    trials. InternalError: the daemon does not answer. LostError: `close` was called.
    """

    def __init__(self, clock: Callable[[], float], environ: Mapping[str, str] = os.environ) -> None:
        self._clock, self._environ, self.why_not = clock, environ, ""
        self._who, self._closing = f"{os.getpid()}-{id(self):x}", threading.Event()
        self._ask()
        self._renewing = threading.Thread(target=self._renew, name="trial-lease", daemon=True)
        self._renewing.start()

    def status(self) -> Status:
        """Return the daemon's status."""
        return ask_status(ANSWER_S, self._clock, self._environ)

    def play(self, sound: Frames, vibration: Frames) -> Played:
        """Play both from their first frames on; return after the end.

        sound: file of 1 or 2 channels for the default output, or None. vibration: file of one
        channel, in shares of full scale before the config's gain; or None. Frames at RATE_HZ,
        (frames, channels), may replace a file. Both get raised-cosine ends of 50 ms. An asynchrony
        of a study is silence at the beginning of one of them; together they take at most 120 s.

        NotPlayedError: the device or the server was lost, or is not ready. The trial counts as not
        played: call `wait`, then offer it again. UsageError: a file is not usable.
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
        """Wait until the daemon can play a trial; return whether it can."""
        for _ in range(1 + round(timeout_s / ASK_S)):
            self._ask()
            if not self.why_not:
                return True
            self._closing.wait(ASK_S)
        return False

    def close(self) -> None:
        """End the trial that plays; tapped sound is felt again. May be repeated."""
        if not self._closing.is_set():
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
        address = player.status().device.address
        if wanted and address != wanted:
            told = f"the daemon plays to {address}, not to {wanted}"
            raise UsageError(f"{told}; stop it, or leave --device out")
        if not player.wait(BEGINS_S):
            raise LostError(f"the daemon plays no trials: {player.why_not}")
        yield player
