"""Processing for the actuators of one device: vibration in, actuator signals out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.core.structures import ACTUATORS, LIMITED_BY, Controls, Readings
from device.drive.design import DriveDesign, drive_design
from device.drive.exposure import DoseSums, Exposure
from device.drive.protection.design import ProtectionStatus
from device.drive.safety import LONGEST_REST_S, SafetyState
from device.drive.settings import DELAY_MAX_MS, ActuatorSettings, sources_of
from device.errors import InternalError, UsageError
from device.units import Block, Float32Array, amplitude_to_db, check_channels

UNPLAYED_S = 3.0  # longest sound that delay line and device still play after the core has stopped
REST_STEP_S = 1.0  # shortest rest that is counted


class DrivenRig:
    """The core's actuators with the indexes `slots`, all with one rig. Any thread may use it."""

    def __init__(
        self, design: DriveDesign, controls: Controls, readings: Readings, slots: range
    ) -> None:
        self.design, self.rig, self.exposure_cap = design, design.rig, design.exposure_cap
        self.knows_seat, self.makeup_db = design.rig.seat is not None, design.makeup_db
        self.latency_frames = design.latency_frames
        self.channels = len(slots)
        self._core_controls, self._core_readings = controls, readings
        self._day_began_at = self._kept_frames = -1
        self._now_s = self._slept_s = self._rest_s = 0.0
        self._controls = controls.actuators[slots.start : slots.stop]
        self._readings = readings.actuators[slots.start : slots.stop]

    @property
    def has_run(self) -> bool:
        """Whether the core has processed any frame."""
        return bool(self._core_readings.frames)

    def protection(self) -> ProtectionStatus:
        """Return the worst values of all channels; infeasible_blocks and replaced_samples are sums.

        `limited_by` belongs to the channel with the lowest gain.
        """
        found = self._readings
        worst = min(found, key=lambda one: one.gain)
        coil_c = max(state.coil_c or 0.0 for state in self.safety_states())
        return ProtectionStatus(
            blocks=max(one.blocks for one in found),
            limited_blocks=max(one.limited_blocks for one in found),
            infeasible_blocks=sum(one.infeasible_blocks for one in found),
            replaced_samples=sum(one.replaced for one in found),
            gain=worst.gain if self.has_run else 1.0,
            least_gain=min(one.least_gain for one in found) if self.has_run else 1.0,
            limited_by=LIMITED_BY[min(worst.limited_by, len(LIMITED_BY) - 1)],
            excursion_m=max(one.excursion_m for one in found),
            coil_c=coil_c if self.rig.thermal else None,
            resistance_ohm=self.design.resistance_ohm(coil_c) if self.rig.thermal else None,
            latency_s=self.latency_frames / self.design.samplerate,
        )

    def exposure(self) -> Exposure:
        """Return today's exposure of all channels; see `Exposure`."""
        running_m_s2 = max(one.running_m_s2 for one in self._readings)
        return Exposure.of([state.dose for state in self.safety_states()], running_m_s2)

    @property
    def exposure_gain(self) -> float:
        """Smallest gain that the exposure cap sets in any channel, 0 to 1; 1 without a cap."""
        return min(one.exposure_gain for one in self._readings) if self.has_run else 1.0

    @property
    def strength_db(self) -> float | None:
        """Change of Wk-weighted acceleration by damping and protection in dB; None if unknown."""
        driven = max(one.squares for one in self._readings)
        undamped = max(one.undamped_squares for one in self._readings)
        return 0.5 * amplitude_to_db(driven / undamped) if driven and undamped else None

    def safety_states(self) -> tuple[SafetyState, ...]:
        """Return each channel's state, which the next run of the program restores."""
        return tuple(self._safety(channel) for channel in range(self.channels))

    def restore(self, states: Sequence[SafetyState], restores: int = 1) -> None:
        """Set the initial state of each channel, for the first block. restores: see core.h."""
        ambient_c = self.rig.thermal.ambient_c if self.rig.thermal else 0.0
        for controls, state in zip(self._controls, states, strict=False):
            safety, dose = controls.safety, state.dose
            safety.coil_c = ambient_c if state.coil_c is None else state.coil_c
            safety.magnet_c = ambient_c if state.magnet_c is None else state.magnet_c
            safety.time_s, safety.squares = dose.time_s, dose.squares
            safety.fourths, safety.above = dose.fourths, dose.high
            controls.restores = restores  # written last, since the core may run
        self._kept_frames = -1

    def keep(self, now_s: float, slept_s: float = 0.0) -> None:
        """Store the present state as the initial state, in case the core is opened again.

        While the core does not run, or the machine is suspended, the coils cool. The core's next
        block begins with the cooled temperatures, unless the core has run since this call.
        now_s, slept_s: time without suspends, and total time in suspend. One thread calls it.
        """
        frames, awake_s = self._core_readings.frames, now_s - self._now_s
        is_new, has_run = self._kept_frames < 0, frames != self._kept_frames
        passed_s = slept_s - self._slept_s + (0.0 if has_run else awake_s)
        if is_new or passed_s > LONGEST_REST_S:
            passed_s = 0.0
        self._rest_s = passed_s + (-UNPLAYED_S if has_run else self._rest_s)
        if frames != self._day_began_at:
            self._day_began_at = -1
        if self._rest_s >= REST_STEP_S:  # the states after that rest, and then any vibration
            bounds, cooled, played_s = self.design.bounds(), [], awake_s if has_run else 0.0
            for controls, now in zip(self._controls, self.safety_states(), strict=True):
                safety = controls.safety
                kept = replace(now, coil_c=safety.coil_c, magnet_c=safety.magnet_c)
                state = bounds.after_unrecorded(bounds.after_rest(kept, self._rest_s), played_s)
                cooled.append(replace(state, dose=now.dose))
            self.restore(cooled, frames + 1)
            self._rest_s = 0.0
        elif has_run:
            self.restore(self.safety_states())
        self._kept_frames, self._now_s, self._slept_s = frames, now_s, slept_s

    def begin_day(self) -> None:
        """Let the core reset the day's dose of all actuators before the next block."""
        self._core_controls.day += 1
        self._day_began_at = self._core_readings.frames
        for controls in self._controls:  # initial doses, for a core that has not run yet
            safety = controls.safety
            safety.time_s = safety.squares = safety.fourths = safety.above = 0.0

    def _safety(self, channel: int) -> SafetyState:
        controls, thermal = self._controls[channel], self.rig.thermal
        if not self.has_run and not controls.restores:
            ambient_c = thermal.ambient_c if thermal else None
            return SafetyState(ambient_c, ambient_c)
        found = self._readings[channel] if self.has_run else controls.safety
        dose = DoseSums(found.time_s, found.squares, found.fourths, found.above)
        if self._day_began_at == self._core_readings.frames:
            dose = DoseSums()  # the core has not run since the day began
        if thermal is None:
            return SafetyState(dose=dose)
        has_rested = controls.restores == self._core_readings.frames + 1
        warm = controls.safety if has_rested else found
        return SafetyState(warm.coil_c, warm.magnet_c, dose)


def driven_rigs(
    designs: Sequence[DriveDesign | None], controls: Controls, readings: Readings, columns: int
) -> tuple[DrivenRig | None, ...]:
    """Return a `DrivenRig` of `columns` actuators for each design, and None for None."""
    return tuple(
        DrivenRig(design, controls, readings, range(first, first + columns)) if design else None
        for first, design in zip(range(0, columns * len(designs), columns), designs, strict=True)
    )


WHOLE_DEVICE = (ActuatorSettings((0,)),)  # represents all channels if no actuator is named


class Drive:
    """Routes, delays, scales and protects the signals of one device's actuators.

    All actuators have the latency `latency_frames`, and each adds its own `delay_ms`. One thread
    calls `process`, `drain` and `flush`. Any thread may use the rest.

    actuators: settings of each actuator; if empty, each channel of the vibration is an actuator.
    samplerate: Hz. channels: number of channels of the vibration if `actuators` is empty.
    rig, damping, protection, exposure_cap: defaults for actuators without these settings.
    sources: names of the input columns. inputs, outputs: number of columns.
    processors: a `DrivenRig` for each of `actuators`, or one for all; None without processing.
    UsageError: the rig is unknown, the sample rate is too low, or there are more than 64 actuators.
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
        """Delay of each of `actuators`, in frames."""
        return tuple(self._delay(actuator) for actuator in self._settings)

    @property
    def strength_db(self) -> float | None:
        """Smallest `DrivenRig.strength_db` of all rigs; None if no rig has a value."""
        found = [one.strength_db for one in self.processors if one]
        return min((one for one in found if one is not None), default=None)

    def change(self, settings: Sequence[ActuatorSettings]) -> None:
        """From the next block on, fade to other levels, polarities, delays or sources.

        InternalError: the number of actuators differs, or a source is not in `sources`.
        """
        if len(settings) != len(self._settings) or not {*sources_of(settings)} <= {*self.sources}:
            raise InternalError("the number of actuators, or their sources, cannot change")
        self._settings = tuple(settings)

    def process(self, vibration: Block) -> Block | Float32Array:
        """Return actuator signals (frames, outputs), float32, for vibration (frames, inputs).

        If `actuators` is empty and there is no processing, return the given array.
        """
        check_channels(vibration, self.inputs)
        if self._core is None:
            return vibration
        if self._settings is not self._taken:
            self._taken = self._settings
            self._set_controls()
        return self._core.process(vibration)

    def drain(self) -> Float32Array:
        """Return the delayed frames at the end of the signal, (frames, outputs)."""
        frames = self.latency_frames + max(self.delays_frames, default=0)
        return self.process(np.zeros((frames, self.inputs))).astype(np.float32, copy=False)

    def flush(self) -> None:
        """Drop delayed frames; keep temperatures and doses. Do not call it during playback."""
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
