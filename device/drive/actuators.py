"""All actuators as one processor: vibration of the sources in, what each actuator gets out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from device.drive.driving import driving_for
from device.drive.past import Past
from device.drive.path import FADE_S, Path, Tap
from device.drive.settings import DELAY_MAX_MS, ActuatorSettings, sources_of
from device.errors import InternalError
from device.units import Float32Array, FloatArray, check_channels

PART_FRAMES = 4_096
"""Longer blocks are treated in parts of this: memory stays what it is."""


class Actuators:
    """Routes, delays, scales and drives the actuators of one device.

    settings: one or more; samplerate: Hz. rig, damping, protection, exposure_cap: for those whose
    settings leave them open. Blocks come as (frames, sources), the columns in the order of
    `sources`, and leave as (frames, actuators): source, delay, level and polarity, then, where it
    is asked for, damping and protection of that actuator's own rig, which so see what it really
    gets.

    All of them leave equally late but for their `delay_ms`: whoever needs less time for its rig
    waits for the others. No byte depends on how the stream is cut into blocks.

    One thread calls `process`, `owed` and `reset`; any thread may call the rest. `change` takes
    effect with the next block, within `FADE_S`.

    drivings: what is done for each one's rig, None for nothing.

    Raises
    ------
    UsageError
        There is no such rig, or the samplerate is too low for what is to be done.
    """

    def __init__(
        self,
        settings: Sequence[ActuatorSettings],
        samplerate: int,
        *,
        rig: str = "paper",
        damping: str = "off",
        protection: str = "off",
        exposure_cap: str = "off",
    ) -> None:
        self.samplerate = samplerate
        self.sources = sources_of(settings)
        self.drivings = tuple(
            driving_for(
                actuator.rig or rig,
                samplerate,
                1,
                damping=actuator.damping or damping,
                protection=actuator.protection or protection,
                exposure_cap=actuator.exposure_cap or exposure_cap,
            )
            for actuator in settings
        )
        self._latencies = [driving.latency_frames if driving else 0 for driving in self.drivings]
        longest = round(1e-3 * DELAY_MAX_MS * samplerate)
        self._past = Past(len(self.sources), longest + self.latency_frames, PART_FRAMES)
        self._settings = self._taken = tuple(settings)
        fade_frames = max(1, round(FADE_S * samplerate))
        self._paths = [
            Path(self._tap(index, actuator), actuator.factor, fade_frames)
            for index, actuator in enumerate(settings)
        ]
        self._column, self._spare = np.zeros((PART_FRAMES, 1)), np.zeros(PART_FRAMES)

    @property
    def settings(self) -> tuple[ActuatorSettings, ...]:
        """What was asked for last."""
        return self._settings

    @property
    def latency_frames(self) -> int:
        """By how many frames each vibration comes later, beside the delay asked for."""
        return max(self._latencies)

    @property
    def delays_frames(self) -> tuple[int, ...]:
        """The delays asked for, frames."""
        return tuple(self._delay(actuator) for actuator in self._settings)

    def change(self, settings: Sequence[ActuatorSettings]) -> None:
        """Go over to other levels, polarities, delays, and sources among those there are."""
        if len(settings) != len(self._paths) or not {*sources_of(settings)} <= {*self.sources}:
            raise InternalError("other actuators, or sources that are not there, cannot follow")
        self._settings = tuple(settings)

    def process(self, vibration: Float32Array | FloatArray) -> Float32Array:
        """Take (frames, sources), any number of frames; return a new (frames, actuators)."""
        check_channels(vibration, len(self.sources))
        wanted = self._settings
        if wanted is not self._taken:
            self._taken = wanted
            for index, actuator in enumerate(wanted):
                self._paths[index].change(self._tap(index, actuator), actuator.factor)
        out = np.empty((len(vibration), len(self._paths)), np.float32)
        for start in range(0, len(vibration), PART_FRAMES):
            part = vibration[start : start + PART_FRAMES]
            self._past.add(part)
            column, spare = self._column[: len(part)], self._spare[: len(part)]
            for index, (path, driving) in enumerate(zip(self._paths, self.drivings, strict=True)):
                path.read(self._past, column[:, 0], spare)
                if driving is not None:
                    driving.process(column)
                out[start : start + len(part), index] = column[:, 0]
        return out

    def owed(self) -> Float32Array:
        """What is still on its way when the signal has ended, the longest delay included."""
        frames = self.latency_frames + max(self.delays_frames)
        return self.process(np.zeros((frames, len(self.sources)), np.float32))

    def flush(self) -> None:
        """Forget what is on its way; counts and doses go on. While nothing plays."""
        self._past.reset()
        for path in self._paths:
            path.settle()
        nothing = np.zeros((max(1, self.latency_frames), len(self.sources)), np.float32)
        self.process(nothing)

    def _tap(self, index: int, actuator: ActuatorSettings) -> Tap:
        waiting = self.latency_frames - self._latencies[index]
        return Tap(self.sources.index(actuator.source), waiting + self._delay(actuator))

    def _delay(self, actuator: ActuatorSettings) -> int:
        return round(1e-3 * actuator.delay_ms * self.samplerate)
