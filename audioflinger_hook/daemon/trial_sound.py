"""The frames of a trial, and the levels that the chain reports while it plays."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.daemon.native.chain import Chain
from device.drive.exposure import DoseSums, Exposure
from device.errors import UsageError
from device.units import Float32Array, FloatArray, amplitude_to_db

RATE_HZ = 48_000
COLUMNS = 3  # of a trial's file: left and right sound, vibration
CHANNELS = 4  # of the stream; the last one is silent
FADE_S, LONGEST_S = 0.05, 120.0
FADE = 0.5 - 0.5 * np.cos(np.pi * (np.arange(round(FADE_S * RATE_HZ)) + 0.5) / (FADE_S * RATE_HZ))

SILENT = 10.0**-7.5  # -150 dBFS
RMS_S = 0.3  # time constant of the core's mean square


class TrialSound:
    """A trial that the audio thread plays; another thread sets `stops`, which begins a fade.

    path: .npy file of float32 frames, (frames, COLUMNS) at RATE_HZ. lead_s: how much later the
    vibration begins than the sound. began_s: when the stream plays its first frame. played: number
    of frames until now. ends_s: when the last one has been played. UsageError: the file is not
    one, or of another form.
    """

    def __init__(self, path: Path, lead_s: float) -> None:
        try:
            frames = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise UsageError(f"{path.name} is not a trial that can be played ({error})") from None
        form, most = (frames.dtype, np.shape(frames)[1:]), round(LONGEST_S * RATE_HZ)
        is_right = form == (np.float32, (COLUMNS,)) and 1 <= len(frames) <= most
        if not is_right or not np.all(np.abs(frames) <= 1.0):
            raise UsageError(
                f"{path.name} is not a trial: float32 within ±1, 1 to {most} frames of {COLUMNS} "
                "columns"
            )
        ends = np.minimum(np.arange(len(frames)), np.arange(len(frames))[::-1])
        frames *= FADE[np.minimum(ends, len(FADE) - 1), None]
        shift = round(lead_s * RATE_HZ)
        self._frames = np.zeros((len(frames) + abs(shift), CHANNELS), np.float32)
        for columns, begin in ((slice(0, 2), max(0, -shift)), (slice(2, 3), max(0, shift))):
            self._frames[begin : begin + len(frames), columns] = frames[:, columns]
        self.began_s, self.ends_s = math.inf, math.inf
        self.played, self.stops, self._fades_out = 0, False, False

    def fill(self, out: Float32Array, plays_s: float) -> None:
        """Write the next frames. plays_s: when the first of them is played. Audio thread only."""
        self.began_s = min(self.began_s, plays_s)
        if self.stops and not self._fades_out:
            self._fades_out = True
            self._frames = self._frames[: self.played + len(FADE)]
            rest = self._frames[self.played :]
            rest *= FADE[::-1][: len(rest), None]
        part = self._frames[self.played : self.played + len(out)]
        out[: len(part)] = part
        self.played += len(part)
        if len(part) < len(out):
            self.ends_s = min(self.ends_s, plays_s + len(part) / RATE_HZ)


class TrialMeter:
    """Levels of the actuators' signals, protection and dose of one trial, from its beginning on."""

    def __init__(self, chain: Chain) -> None:
        self._chain, self._rigs = chain, [rig for rig in chain.design.rigs if rig]
        self._frames, self._before = chain.page.frames, self._mean_squares()
        self._energy_s = np.zeros(len(self._before))
        self._gain, self._doses = 1.0, self._dose_sums()

    def look(self) -> None:
        """Read the levels; call it often while the trial plays."""
        frames, now = self._chain.page.frames, self._mean_squares()
        seconds = (frames - self._frames) / self._chain.plan.samplerate
        if seconds > 0.0:
            kept = math.exp(-seconds / RMS_S)
            self._energy_s += seconds * (now - kept * self._before) / (1.0 - kept)
            self._gain = min([self._gain, *(rig.protection().gain for rig in self._rigs)])
            self._frames, self._before = frames, now

    def result(self, seconds: float) -> dict[str, Any]:
        """Return the r.m.s. level in dBFS, protection's attenuation, and exposure.

        seconds: duration of the trial.
        """
        self.look()
        energy_s = max(0.0, float(np.max(self._energy_s, initial=0.0)))
        rms = math.sqrt(energy_s / max(seconds, 1.0 / RATE_HZ))
        both = zip(self._dose_sums(), self._doses, strict=True)
        doses = [now.plus(then, -1.0) for now, then in both]
        exposure = Exposure.of(doses) if doses else None
        return {
            "seconds": seconds,
            "level_dbfs": amplitude_to_db(max(rms, SILENT)),
            "protection_db": abs(amplitude_to_db(max(self._gain, SILENT))),
            "a8_m_s2": exposure and exposure.a8_m_s2,
            "vdv_m_s175": exposure and exposure.vdv,
        }

    def _mean_squares(self) -> FloatArray:
        found = self._chain.page.readings.actuators[: len(self._chain.plan.actuators)]
        return np.array([one.level.mean_square for one in found])

    def _dose_sums(self) -> list[DoseSums]:
        return [one.dose for rig in self._rigs for one in rig.safety_states()]
