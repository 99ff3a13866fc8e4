"""Protection in the live path: every block is delayed by two block lengths."""

import math

import numpy as np

from device.drive.protection.bounding_models import RESERVE, bounding_models
from device.drive.protection.drive_model import amplifier_sections
from device.drive.protection.governor import Governor
from device.drive.protection.limits import Limits, ProtectionStatus, limits_of
from device.drive.protection.prediction import Prediction, most_current_a
from device.drive.protection.thermal import CoilTemperature, gain_for_power
from device.errors import UsageError
from device.rig import Rig
from device.units import Block, FloatArray, check_channels, finite_or_zero

BLOCK_S = 0.002
BLOCKS_AHEAD = 2
"""A block leaves when the next block is known: two block lengths after its start."""

_ABSURD = 1e6
_RECOVERY_S = 0.02
"""Time in which the gain recovers from 0 to what the demand allows."""
_HOLD_S = 0.06
"""Demand is held at least this long: more than a period of 20 Hz, so that the gain is steady."""
_CAUTION = 1.03
"""Factor on the demand after each block in which the bound limited the gain. That limit makes the
actuator swing, and the bound would act again in every period."""
_RELEASE_S = 0.5
"""Time constant of the demand's decay after that."""
_WANTED_RISE_S, _WANTED_FALL_S = 0.03, 2.0
"""Time constants of the wanted power's rise, over a few periods of vibration, and decay."""


class Protector:
    """Keeps a rig inside its limits by gain alone, ahead of time; never clips.

    While no limit is near, every sample leaves unchanged, `latency_frames` later. Gains change
    linearly over a block and recover slowly. One thread calls `process`; any thread may set `most`
    and call `status`.

    Parameters
    ----------
    rig : Rig
        What is driven, one actuator a channel.
    samplerate : int
        Rate in Hz, 1000 or more.
    channels : int
        Number of channels, 1 or more; each has its gain.
    limits : Limits | None
        None for the limits of the rig.

    Attributes
    ----------
    most : float
        Upper limit of the gain, 0 to 1, set from outside, such as by an exposure cap.

    Raises
    ------
    UsageError
        The rate is too low, or the coil's temperature is limited and the rig does not describe how
        the coil warms up.
    """

    def __init__(
        self,
        rig: Rig,
        samplerate: int,
        channels: int,
        *,
        limits: Limits | None = None,
    ) -> None:
        if samplerate < 1_000:
            raise UsageError(f"samplerate={samplerate} Hz is too low; choose 1000 Hz or more")
        self.rig = rig
        self.limits = limits or limits_of(rig)
        if self.limits.coil_temperature_c is not None and rig.thermal is None:
            raise UsageError(
                f"coil_temperature_c={self.limits.coil_temperature_c!r} cannot be kept: the rig "
                f"{rig.name!r} describes no [thermal]; add it, or set no limit"
            )
        self.samplerate = samplerate
        self.channels = channels
        self.most = 1.0
        self._frames = round(BLOCK_S * samplerate)
        self._period_s = self._frames / samplerate
        volts = rig.dac.full_scale_v * rig.amplifier.gain
        source = rig.amplifier.source_impedance_ohm
        models = bounding_models(rig.actuator, self.limits, source)
        sections = amplifier_sections(rig.amplifier, models, samplerate)
        current_a = self.limits.current_a
        if current_a is not None:
            most_a = most_current_a(models, samplerate, source, sections)
            most_a *= self.limits.level * volts
            current_a *= 1.0 - RESERVE
            # A limit that no drive can reach is left out, to save time.
            current_a = current_a if most_a > current_a else None
        prediction = Prediction(
            models,
            samplerate,
            self._frames,
            volts=volts,
            source_impedance_ohm=source,
            sections=sections,
            excursion_m=(1.0 - RESERVE) * self.limits.excursion_m,
            # The coil's temperature needs only the current of the identified model.
            current_models=1 if current_a is None else len(models),
        )
        self._governor = Governor(
            prediction, channels, level=self.limits.level, current_a=current_a
        )
        self._coils = [
            CoilTemperature(rig.thermal, rig.actuator.resistance_ohm, self._period_s)
            for _ in range(channels)
            if rig.thermal
        ]
        self._rise = self._period_s / _RECOVERY_S
        self._hold_blocks = math.ceil(_HOLD_S / self._period_s)
        self._release = math.exp(-self._period_s / _RELEASE_S)
        self._notice = 1.0 - math.exp(-self._period_s / _WANTED_RISE_S)
        self._forget = math.exp(-self._period_s / _WANTED_FALL_S)
        self.reset()

    @property
    def latency_frames(self) -> int:
        """Delay of the vibration in frames: two blocks."""
        return BLOCKS_AHEAD * self._frames

    def reset(self) -> None:
        """Return to rest and cool down; counts become 0 and held frames are dropped."""
        shape = (self._frames, self.channels)
        self._coming, self._leaving = np.zeros(shape), np.zeros(shape)
        self._filled = 0
        self._silent = True
        self._governor.reset()
        for coil in self._coils:
            coil.reset()
        # Of the present hold time, and of the previous hold time.
        self._demands = [np.zeros(self.channels), np.zeros(self.channels)]
        self._demand, self._caution = np.zeros(self.channels), np.ones(self.channels)
        self._lately_w, self._wanted_w = [0.0] * self.channels, [0.0] * self.channels
        self._at_ease = True
        self._blocks = self._limited_blocks = self._infeasible_blocks = 0
        self._replaced_samples = 0
        self._gain = self._least_gain = 1.0
        self._limited_by = ""

    def process(self, block: Block) -> Block:
        """Replace a block, (frames, channels), by the frames that leave now; return it.

        The output is finite and does not depend on the lengths of blocks. Samples that are not
        finite, or beyond a million times full scale, count as 0.
        """
        check_channels(block, self.channels)
        start = 0
        while start < len(block):
            count = min(self._frames - self._filled, len(block) - start)
            place = slice(self._filled, self._filled + count)
            samples, replaced = finite_or_zero(
                block[start : start + count].astype(np.float64), _ABSURD
            )
            self._replaced_samples += replaced
            self._coming[place] = samples
            block[start : start + count] = self._leaving[place]
            self._filled += count
            start += count
            if self._filled == self._frames:
                self._govern()
        return block

    def status(self) -> ProtectionStatus:
        """Return counts and readings, which may be from slightly different times. Any thread."""
        warmest = max(self._coils, key=lambda coil: coil.coil_c, default=None)
        return ProtectionStatus(
            blocks=self._blocks,
            limited_blocks=self._limited_blocks,
            infeasible_blocks=self._infeasible_blocks,
            replaced_samples=self._replaced_samples,
            gain=self._gain,
            least_gain=self._least_gain,
            limited_by=self._limited_by,
            excursion_m=float(self._governor.swing_m.max()),
            coil_c=warmest.coil_c if warmest else None,
            resistance_ohm=warmest.resistance_ohm if warmest else None,
            latency_s=self.latency_frames / self.samplerate,
        )

    def _govern(self) -> None:
        """Decide on the known block once the next one has come."""
        self._blocks += 1
        self._filled = 0
        if self._silent and not self._coming.any() and self._governor.settle():
            self._sleep()
            return
        # The governor uses this array until its frames have left.
        ahead, self._coming = self._coming, np.empty_like(self._coming)
        governor = self._governor
        governor.take(ahead)
        if self._at_ease and self.most >= 1.0:
            passed = governor.pass_on()
            if passed is not None:
                self._leaving, mean_a2 = passed
                self._silent = not ahead.any()
                self._heat(mean_a2.tolist())
                return
        thermal = self._thermal_gain()
        recovered = np.minimum(1.0, governor.gain + self._rise)
        outside = min(max(float(self.most), 0.0), 1.0) if self.most == self.most else 0.0
        demanded = 1.0 / np.maximum(1.0, self._caution * self._demand)
        asked = np.minimum(np.minimum(recovered, demanded), np.minimum(outside, thermal))
        verdict = governor.decide(asked)
        self._remember(verdict.demand)
        bounded = verdict.gain < asked
        self._caution = 1.0 + self._release * (self._caution - 1.0)
        self._caution = np.where(bounded, np.minimum(2.0, _CAUTION * self._caution), self._caution)
        allowed = np.minimum(verdict.gain, 1.0 / np.maximum(1.0, self._demand))
        gain, hot = self._within_heat(allowed, verdict.power_a2)
        self._leaving = governor.advance(gain)
        self._silent = not ahead.any()
        self._infeasible_blocks += verdict.infeasible
        self._note(gain, outside, thermal, hot)
        demanding = self._caution * self._demand
        if self._gain >= 1.0 and demanding.max() <= 1.0 and thermal.min() >= 1.0:
            # Nothing that is remembered limits the gain.
            self._at_ease, self._caution[:] = True, 1.0
        else:
            self._at_ease = False

    def _heat(self, mean_a2: list[float]) -> None:
        """Step the coils by a block that leaves unchanged."""
        limit_c = self.limits.coil_temperature_c
        # There are no coils if the rig does not say how they warm up.
        for channel, (coil, square) in enumerate(zip(self._coils, mean_a2, strict=False)):
            power_w = coil.resistance_ohm * square
            coil.step(power_w)
            self._want(channel, power_w)
            if limit_c is not None and self._wanted_w[channel] > coil.power_allowed(limit_c):
                self._at_ease = False

    def _want(self, channel: int, power_w: float) -> None:
        """Note the power that flows, or would flow without any gain."""
        lately_w, wanted_w = self._lately_w[channel], self._wanted_w[channel]
        lately_w += self._notice * (power_w - lately_w)
        self._lately_w[channel] = lately_w
        self._wanted_w[channel] = max(lately_w, self._forget * wanted_w)

    def _sleep(self) -> None:
        """Pass a silent block at rest: only the coils cool."""
        self._leaving = np.zeros_like(self._leaving)
        self._remember(np.zeros(self.channels))
        self._caution = 1.0 + self._release * (self._caution - 1.0)
        self._heat([0.0] * self.channels)
        self._gain, self._limited_by = 1.0, ""

    def _note(self, gain: FloatArray, outside: float, thermal: FloatArray, hot: bool) -> None:
        """Count the block, and note what limited the channel with the smallest gain."""
        self._gain = float(gain.min())
        self._least_gain = min(self._least_gain, self._gain)
        self._limited_by = ""
        if self._gain >= 1.0:
            return
        self._limited_blocks += 1
        worst = int(gain.argmin())
        if hot or thermal[worst] <= self._gain:
            self._limited_by = "temperature"
        elif outside <= self._gain:
            self._limited_by = "outside"
        else:
            self._limited_by = "excursion, current or level"

    def _remember(self, demand: FloatArray) -> None:
        """Hold the largest demand for one to two times `_HOLD_S`, then let it decay."""
        if self._blocks % self._hold_blocks == 0:
            self._demands = [np.zeros(self.channels), self._demands[0]]
        self._demands[0] = np.maximum(self._demands[0], demand)
        held = np.maximum(self._demands[0], self._demands[1])
        self._demand = np.maximum(self._release * self._demand, held)

    def _thermal_gain(self) -> FloatArray:
        """Return the gain that reduces the wanted power to the allowed one, (channels,)."""
        limit_c = self.limits.coil_temperature_c
        if limit_c is None:
            return np.ones(self.channels)
        return np.array(
            [
                gain_for_power(coil.power_allowed(limit_c), wanted_w)
                for coil, wanted_w in zip(self._coils, self._wanted_w, strict=True)
            ]
        )

    def _within_heat(self, gain: FloatArray, power_a2: FloatArray) -> tuple[FloatArray, bool]:
        """Return the gain, lowered where this block would overheat a coil; step the coils.

        The current is that of the cold coil. A warm coil has less, so that this overestimates the
        power.
        """
        limit_c, lowered = self.limits.coil_temperature_c, False
        for channel, coil in enumerate(self._coils):
            fixed, cross, square, alone = power_a2[:, channel].tolist()
            g, ohm = float(gain[channel]), coil.resistance_ohm
            mean_a2 = fixed + g * (cross + g * square)
            if limit_c is not None and ohm * mean_a2 > coil.power_that_reaches(limit_c):
                gain = gain.copy()
                g = gain[channel] = g / 2.0
                mean_a2 = fixed + g * (cross + g * square)
                lowered = True
            power_w = max(0.0, ohm * mean_a2)
            coil.step(power_w)
            self._want(channel, ohm * alone)
        return gain, lowered
