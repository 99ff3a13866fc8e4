"""Loudness, and how strong vibration is by it: "Loudness" in docs/transform.md.

After ISO 532-1, and Altinsoy and Merchel, "Cross-Modality Matching of Loudness and Perceived
Intensity of Whole-Body Vibrations" (HAID 2010). Levels are in dB; 0 dB is that of 94 phon.
"""

from typing import Any

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.loudness import FULL_SCALE_DB
from audioflinger_hook.transform.design.synthesis import SynthesisDesign


def at_hz(table: FloatArray, hz: Any) -> FloatArray:
    """Return a table's values at vibration frequencies: `felt_weights` or `gain_table`."""
    return np.asarray(np.interp(hz, SynthesisDesign.gain_step_hz * np.arange(table.size), table))


def loudness_db(s: Any, power: FloatArray, kind: str = "loudness") -> FloatArray:
    """Return the loudness of each row (rows,) from squared magnitudes (rows, bins). kind: whose
    tables count, "loudness" for long windows or "onset_loudness" for short ones."""
    tables = (getattr(s, f"{kind}_{name}") for name in ("weights", "edges", "scale", "widths"))
    weights, edges, scale, widths = tables
    bands = np.add.reduceat(weights * power[:, : weights.size], edges[:-1].astype(int), axis=1)
    root = (0.75 + 0.25 * bands) ** 0.25  # by the threshold factor of ISO 532-1, 0.25
    sone, above = np.zeros((2, len(power)))
    for core, width in zip(np.maximum(0.0, scale * (root - 1.0)).T, widths, strict=True):
        # The slope above a louder band hides softer ones.
        slope = s.slope_a_bark / np.maximum(above, 1e-300) ** 0.25
        left = np.where(above > core, above * np.exp(-slope * width), 0.0)
        tail = np.where(above > core, (above - left) / slope, 0.0)
        sone = sone + np.maximum(core * width, tail)
        above = np.maximum(core, left)
    loud = 40.0 + 10.0 * np.log2(np.maximum(sone, 1.0))
    return np.where(sone >= 1.0, loud, 40.0 * (sone + 5e-4) ** 0.35) - FULL_SCALE_DB


def concentrated(s: Any, amplitude: FloatArray, hz: FloatArray, ceiling: float) -> FloatArray:
    """Return amplitudes of the same strength, moved to where a body feels them best. They are moved
    only where their sum is over the ceiling, and the more, the more it is over."""
    over = max(0.0, float(amplitude.sum()) / ceiling - 1.0)
    felt = at_hz(s.felt_weights, hz)
    moved = amplitude * felt ** (s.concentrated * min(1.0, over))
    strength = np.linalg.norm(amplitude * felt), np.linalg.norm(moved * felt)
    return moved * float(strength[0] / strength[1]) if over else amplitude


class Follower:
    """What one voice remembers of loudness. programme_db, floor_db, loud_db: as in
    docs/transform.md; steady_db: loudness without jitter; far_hops: hops for which it was far over
    the programme, negative for far under it."""

    def __init__(self, s: Any) -> None:
        self.s, self.programme_db, self.far_hops = s, s.programme_start, 0.0
        self.rest()

    def rest(self) -> None:
        """Take a hop without any sound: nothing was loud, and there is no noise."""
        self.floor_db = self.loud_db = self.steady_db = self.s.floor_min

    def strength(self, measured_db: float) -> float:
        """Take a hop's loudness; return the root of the sum of the squares of its amplitudes."""
        s, before_db, change = self.s, self.programme_db, measured_db - self.steady_db
        small = np.clip(change, -s.jitter, s.jitter)
        self.steady_db = now_db = self.steady_db + (change - small) + s.jitter_followed * small
        self.floor_db = max(s.floor_min, min(self.floor_db + s.floor_rise, now_db))
        self.loud_db = max(s.floor_min, self.loud_db - s.release, now_db)
        gate = self._gate(now_db)
        if not gate:
            return 0.0
        above = self.loud_db - before_db
        missing = np.clip(above, -s.far, s.far)
        faster = missing * (s.programme_rise if missing > 0.0 else s.programme_fall)
        moved = before_db + gate * (np.clip(above, -1.0, 1.0) * s.programme_step + faster)
        moved += self._jump(above, now_db - before_db)
        self.programme_db = float(np.clip(moved, s.programme_min, s.programme_top))
        return float(gate * self._felt(above, now_db - self.loud_db))

    def onset_strength(self, power: FloatArray, level: float) -> float:
        """Return the strength of an onset of this level with these powers of the short bins."""
        s, share = self.s, power / max(1e-300, float(power.sum()))
        now_db = loudness_db(s, level * level * share[None], "onset_loudness")[0] - s.onset_under
        loud_db = max(self.loud_db, now_db)
        strength = self._gate(now_db) * self._felt(loud_db - self.programme_db, now_db - loud_db)
        felt = max(1e-300, float(share @ s.onset_felt_squares)) ** 0.5
        return float(min(s.gain_max * level, strength / felt))

    def _gate(self, now_db):
        under = min(self.floor_db, self.programme_db - self.s.floor_under)
        over = min(1.0, (now_db - max(self.s.floor_min, under)) / self.s.gate)
        return over * over * (3.0 - 2.0 * over) if over >= self.s.gate_margin else 0.0

    def _felt(self, above, lowered):
        return 10.0 ** ((self.s.target + self.s.slope * above + lowered) / 20.0)

    def _jump(self, above, now_above):
        """Return how far the programme jumps, once the level has been that of another volume."""
        s, far = self.s, self.far_hops
        self.far_hops = 0.0
        if above > (s.near if far > s.jump_up_hops else s.jump):
            # One bang is no other volume: only hops count that are themselves far above.
            self.far_hops = min(s.jump_up_hops, max(0.0, far)) + (now_above > s.near)
        elif above < -(s.near if -far > s.jump_down_hops else s.jump):
            self.far_hops = max(-s.jump_down_hops, min(0.0, far)) - 1.0
        up, down = self.far_hops > s.jump_up_hops, -self.far_hops > s.jump_down_hops
        return s.jump_up_step * up - s.jump_down_step * down
