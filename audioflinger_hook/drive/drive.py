"""The drives of one device's actuators: vibration in, what each actuator plays out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.core.structures import ACTUATORS
from audioflinger_hook.drive.driven_rig import DrivenRig, driven_rigs
from device.drive.design import drive_design
from device.drive.settings import DELAY_MAX_MS, ActuatorSettings, sources_of
from device.errors import InternalError, UsageError
from device.units import Block, Float32Array, check_channels

WHOLE_DEVICE = (ActuatorSettings((0,)),)  # all channels, if no actuator is named


class Drive:
    """Routes, delays, scales and protects the signals of one device's actuators.

    Apart from `delay_ms`, all actuators have the same latency, `latency_frames`: one whose rig
    needs less waits for the others. One thread calls `process`, `drain` and `flush`; any thread may
    call the rest.

    actuators: what each actuator plays; empty for one on each channel of the vibration. samplerate:
    Hz. channels: of the vibration; used only if no actuators are named.
    rig, damping, protection, exposure_cap: values for actuators that do not set their own.
    sources: names of the input columns; empty if no actuators are named. inputs, outputs: columns
    of the blocks that come and leave. processors: readings of each actuator's rig, None if its
    settings are all "off"; one for all channels, if no actuators are named.
    UsageError: there is no such rig, the sample rate is too low for its processing, or there are
        more than 64 actuators.
    """

    def __init__(
        self,
        actuators: Sequence[ActuatorSettings],
        samplerate: int,
        channels: int = 1,
        *,
        rig: str = "paper",
        damping: str = "off",
        protection: str = "off",
        exposure_cap: str = "off",
    ) -> None:
        self.samplerate = samplerate
        self.sources = sources_of(actuators)
        self.inputs = len(self.sources) or channels
        self.outputs = len(actuators) or channels
        self._settings = self._taken = tuple(actuators)
        designs = [
            drive_design(
                actuator.rig or rig,
                samplerate,
                damping=actuator.damping or damping,
                protection=actuator.protection or protection,
                exposure_cap=actuator.exposure_cap or exposure_cap,
            )
            for actuator in actuators or WHOLE_DEVICE
        ]
        self.latency_frames = max(design.latency_frames if design else 0 for design in designs)
        self._core: Core | None = None
        self.processors: tuple[DrivenRig | None, ...] = (None,)
        if not actuators and designs[0] is None:
            return
        if self.outputs > ACTUATORS:
            raise UsageError(f"{self.outputs} actuators are too many; at most {ACTUATORS} play")
        delay_frames_max = round(1e-3 * DELAY_MAX_MS * samplerate) if actuators else 0
        columns = 1 if actuators else channels
        drives = designs * columns
        self._core = core = Core(
            core_design(samplerate, self.inputs, drives=drives, delay_frames_max=delay_frames_max)
        )
        self.processors = driven_rigs(designs, core.controls, core.readings, columns)
        for index in range(self.outputs):
            core.controls.actuators[index].source = index
        self._set_controls()

    @property
    def delays_frames(self) -> tuple[int, ...]:
        """Delay set for each named actuator, in frames."""
        return tuple(self._delay(actuator) for actuator in self._settings)

    @property
    def strength_db(self) -> float | None:
        """Least perceived strength of damped actuators, see `DrivenRig`; None without any."""
        found = [one.strength_db for one in self.processors if one]
        return min((one for one in found if one is not None), default=None)

    def change(self, settings: Sequence[ActuatorSettings]) -> None:
        """Fade to other levels, polarities, delays and known sources from the next block on."""
        named = len(self._settings)
        if len(settings) != named or not {*sources_of(settings)} <= {*self.sources}:
            raise InternalError("the number of actuators, or their sources, cannot change")
        self._settings = tuple(settings)

    def process(self, vibration: Block) -> Block | Float32Array:
        """Return the actuators' signals, (frames, outputs) in float32, for (frames, inputs).

        The block does not change. Without named actuators and processing, it is returned itself.
        """
        check_channels(vibration, self.inputs)
        if self._core is None:
            return vibration
        if self._settings is not self._taken:
            self._taken = self._settings
            self._set_controls()
        return self._core.process(vibration)

    def drain(self) -> Float32Array:
        """Return the frames still held back at the signal's end, including the longest delay."""
        frames = self.latency_frames + max(self.delays_frames, default=0)
        return self.process(np.zeros((frames, self.inputs))).astype(np.float32, copy=False)

    def flush(self) -> None:
        """Drop the frames held back; temperatures and doses stay. Only while nothing plays."""
        if self._core is not None:
            self._core.reset()

    def _set_controls(self) -> None:
        assert self._core is not None
        for controls, actuator in zip(self._core.controls.actuators, self._settings, strict=False):
            controls.gain = actuator.factor
            controls.delay_frames = self._delay(actuator)
            controls.source = self.sources.index(actuator.source)

    def _delay(self, actuator: ActuatorSettings) -> int:
        return round(1e-3 * actuator.delay_ms * self.samplerate)
