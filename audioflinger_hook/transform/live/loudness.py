"""The loudness follower: how strong a hop vibrates by how loud it is in its programme.

After Altinsoy and Merchel, "Cross-Modality Matching of Loudness and Perceived Intensity of
Whole-Body Vibrations" (HAID 2010). Loudness is measured after ISO 532-1.
"""

from __future__ import annotations

import math

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.loudness import FULL_SCALE_DB, LoudnessDesign
from audioflinger_hook.transform.design.synthesis import SynthesisDesign
from audioflinger_hook.transform.spectrum import ComplexArray

TINY = float(np.finfo(np.float64).tiny)

THRESHOLD = 0.25
"""Threshold factor s of ISO 532-1: how much of the excitation at the threshold is noise within."""


class LoudnessMeter:
    """Loudness of one spectrum after ISO 532-1; pure. The arguments are tables of LoudnessDesign.

    Level and phon count alike: 0 dB is the loudness of a full-scale tone of 1 kHz, 94 phon.
    """

    def __init__(
        self,
        weights: FloatArray,
        edges: FloatArray,
        scale: FloatArray,
        widths: FloatArray,
        slope_a_bark: float,
    ) -> None:
        self._weights = weights
        self._edges = [int(edge) for edge in edges[:-1]]
        self._scale = scale
        self._widths = widths.tolist()
        self._slope_a_bark = slope_a_bark

    def loudness_db(self, power: FloatArray, factor: float) -> float:
        """Return the loudness in dB of the squared magnitudes of bins, times a factor."""
        excitation = np.add.reduceat(self._weights * power, self._edges) * factor
        root = (1.0 - THRESHOLD + THRESHOLD * excitation) ** 0.25
        specific = np.maximum(0.0, self._scale * (root - 1.0))
        sone = above = 0.0
        for core, width in zip(specific.tolist(), self._widths, strict=True):
            tail = left = 0.0
            if above > core:
                slope = self._slope_a_bark / above**0.25
                left = above * math.exp(-slope * width)
                tail = (above - left) / slope
            sone += max(core * width, tail)
            above = max(core, left)
        phon = 40.0 + 10.0 * math.log2(sone) if sone >= 1.0 else 40.0 * (sone + 5e-4) ** 0.35
        return phon - FULL_SCALE_DB


class LoudnessFollower:
    """The follower of one channel: a loudness each hop in, the strength of its vibration out.

    Time is counted in hops. Silence leaves the programme's level as it is. `gain` is the factor
    on the amplitudes of the last hop. Use from one thread at a time.
    """

    def __init__(self, design: LoudnessDesign) -> None:
        self._design = design
        self._bins = design.loudness_weights.size
        self._felt_hz = SynthesisDesign.gain_step_hz * np.arange(design.felt_weights.size)
        self._meter = LoudnessMeter(
            design.loudness_weights,
            design.loudness_edges,
            design.loudness_scale,
            design.loudness_widths,
            design.slope_a_bark,
        )
        self._onset_meter = LoudnessMeter(
            design.onset_loudness_weights,
            design.onset_loudness_edges,
            design.onset_loudness_scale,
            design.onset_loudness_widths,
            design.slope_a_bark,
        )
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        self.programme_db = self._design.programme_start
        self.gain = 1.0
        self._far_hops = 0.0
        self.rest()

    def rest(self) -> None:
        """Take a hop without any sound: there is no noise, and nothing was loud."""
        self.floor_db = self._design.floor_min
        self.loud_db = self._design.floor_min
        self._steady_db = self._design.floor_min

    def loudness_db(self, spectra: ComplexArray) -> list[float]:
        """Return the loudness of each row of (rows, columns), see `LoudnessMeter`."""
        return [self._meter.loudness_db(_power(row[: self._bins]), 1.0) for row in spectra]

    def onset_loudness_db(self, power: FloatArray, level: float) -> float:
        """Return the loudness of an onset of this level from the powers of the short bins."""
        factor = level * level / max(TINY, float(power.sum()))
        return self._onset_meter.loudness_db(power, factor) - self._design.onset_under

    def strength(self, loudness_db: float) -> float:
        """Return how strong the next hop vibrates, the root of its partials' sum of squares.

        It is 0 where the soft gate is closed. The floor and the programme's level follow.
        """
        design = self._design
        loudness_db = self._steadied(loudness_db)
        floor_db = min(self.floor_db + design.floor_rise, loudness_db)
        self.floor_db = max(design.floor_min, floor_db)
        self.loud_db = max(design.floor_min, self.loud_db - design.release, loudness_db)
        gate = self._gate(loudness_db)
        if not gate:
            return 0.0
        above_db = self.loud_db - self.programme_db
        missing_db = max(-design.far, min(design.far, above_db))
        rate = design.programme_rise if missing_db > 0.0 else design.programme_fall
        faster = missing_db * rate
        # Continuous where the loudness is the programme's, as it is of a steady sound.
        towards = max(-1.0, min(1.0, above_db))
        moved_db = self.programme_db + gate * (towards * design.programme_step + faster)
        moved_db += self._jump(above_db, loudness_db - self.programme_db)
        self.programme_db = max(design.programme_min, min(design.programme_top, moved_db))
        return gate * self._strength_above(above_db, loudness_db - self.loud_db)

    def _steadied(self, loudness_db: float) -> float:
        """Return loudness that follows clear changes at once and jitter hardly.

        The windows of a low tone, and of noise, differ by a dB although the sound is steady.
        """
        jitter, change = self._design.jitter, loudness_db - self._steady_db
        small = max(-jitter, min(jitter, change))
        self._steady_db += (change - small) + self._design.jitter_followed * small
        return self._steady_db

    def _jump(self, above_db: float, now_above_db: float) -> float:
        """Return how far the programme's level goes after a jump that only a volume control makes.

        Such a level is far away for long. The programme then goes on until it is near. Above, only
        hops count that are far above themselves: one bang is no other volume.
        """
        design = self._design
        up, down = self._far_hops > design.jump_up_hops, -self._far_hops > design.jump_down_hops
        if above_db > (design.near if up else design.jump):
            counted = 1.0 if now_above_db > design.near else 0.0
            self._far_hops = min(design.jump_up_hops, max(0.0, self._far_hops)) + counted
        elif above_db < -(design.near if down else design.jump):
            self._far_hops = max(-design.jump_down_hops, min(0.0, self._far_hops)) - 1.0
        else:
            self._far_hops = 0.0
        if self._far_hops > design.jump_up_hops:
            return design.jump_up_step
        if -self._far_hops > design.jump_down_hops:
            return -design.jump_down_step
        return 0.0

    def onset_strength(self, power: FloatArray, level: float) -> float:
        """Return the strength of an onset of this level from the powers of the short bins.

        It changes no state: the next hop measures the loudness.
        """
        if level <= 0.0:
            return 0.0
        loudness_db = self.onset_loudness_db(power, level)
        felt = float((power * self._design.onset_felt_squares).sum() / max(TINY, power.sum()))
        loud_db = max(self.loud_db, loudness_db)
        strength = self._strength_above(loud_db - self.programme_db, loudness_db - loud_db)
        wanted = self._gate(loudness_db) * strength / math.sqrt(felt)
        return min(self._design.gain_max * level, wanted)

    def felt_weight(self, hz: FloatArray) -> FloatArray:
        """Return how strongly vibration frequencies in Hz are felt."""
        weights: FloatArray = np.interp(hz, self._felt_hz, self._design.felt_weights)
        return weights

    def gain_for(self, strength: float, power: float) -> float:
        """Return, and keep, the factor that gives amplitudes their strength.

        power: the sum of their squares, above 0.
        """
        self.gain = min(self._design.gain_max, strength / power**0.5)
        return self.gain

    def concentrated(self, amplitude: FloatArray, hz: FloatArray, ceiling: float) -> FloatArray:
        """Return amplitudes of the same strength, moved to where a body feels them best.

        They are moved only where their sum is over the ceiling, and the more, the more it is over.
        """
        over = float(amplitude.sum()) / ceiling - 1.0
        if over <= 0.0:
            return amplitude
        felt = self.felt_weight(hz)
        most = self._design.concentrated
        moved = amplitude * felt ** min(most, most * over)
        before, after = amplitude * felt, moved * felt
        return moved * float(np.sqrt((before * before).sum() / (after * after).sum()))

    def _gate(self, loudness_db: float) -> float:
        """Return how far the soft gate is open, 0 to 1."""
        design = self._design
        under_programme_db = self.programme_db - design.floor_under
        gate_from_db = max(design.floor_min, min(self.floor_db, under_programme_db))
        over = min(1.0, (loudness_db - gate_from_db) / design.gate)
        return over * over * (3.0 - 2.0 * over) if over >= design.gate_margin else 0.0

    def _strength_above(self, above_db: float, lowered_db: float) -> float:
        """Return the strength of a level above the programme's, lowered by what fell since."""
        level_db = self._design.target + self._design.slope * above_db + lowered_db
        return math.pow(10.0, level_db / 20.0)


def _power(spectrum: ComplexArray) -> FloatArray:
    power: FloatArray = spectrum.real**2 + spectrum.imag**2
    return power
