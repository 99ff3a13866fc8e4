"""How strong vibration is by loudness, and oscillators as strong as that: "Loudness" in
docs/transform.md. Levels are in dB. s: the numbers and tables of `LiveDesign`."""

from typing import Any

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from tests.oracle.loudness import at_hz


class Strength:
    """What one voice remembers of loudness; names as in docs/transform.md. heard: ticks of sound so
    far; speech_left: factor on what is speech."""

    def __init__(self, s: Any) -> None:
        self.s, self.programme_db, self.heard = s, s.programme_start, 0
        self.rest()

    def rest(self) -> None:
        """Return to what is so after a long silence; the programme stays."""
        s = self.s
        self.floor_db = self.loud_db = self.steady_db = self.slow_db = s.floor_min
        self.attack = 0.0
        self.usual_db, self.boost_db, self.held, self.speech_left = s.silence_db, 0.0, 0.0, 1.0
        groups = s.loudness_groups.size - 1
        self.smooth, self.usual = np.zeros(groups), np.full(groups, s.silence_db)
        self.deviation = np.full(groups, s.deviation_start)

    def follow(self, measured_db: float, sone: float, groups: FloatArray) -> float:
        """Take a tick's loudness; return the root of the sum of squares of what is to be felt."""
        s, change = self.s, measured_db - self.steady_db
        self.attack = s.attack_ticks if change > s.jump else max(0.0, self.attack - 1.0)
        jitter = 0.0 if self.attack else s.jitter
        small = np.clip(change, -jitter, jitter)
        self.steady_db += (change - small) + s.jitter_followed * small
        self.slow_db += s.slow_followed * (self.steady_db - self.slow_db)
        self.floor_db = max(s.floor_min, min(self.floor_db + s.floor_rise, self.steady_db))
        self.loud_db = max(s.floor_min, self.loud_db - s.release, self.slow_db)
        under = min(self.floor_db, self.programme_db - s.floor_under)
        over = min(1.0, (self.steady_db - max(s.floor_min, under)) / s.gate)
        gate = over * over * (3.0 - 2.0 * over) if over >= s.gate_margin else 0.0
        if gate:
            self._move(gate)
        self._boost(self._wanted(sone, groups))
        level = s.target + s.slope * (self.steady_db - self.programme_db)
        boost_db = self.boost_db * self.speech_left
        return float(gate * self.speech_left * 10.0 ** ((level + boost_db) / 20.0))

    def _move(self, gate):
        """Let the programme go towards the loudness, fast at the beginning of a stream."""
        s, above = self.s, self.loud_db - self.programme_db
        missing = np.clip(above, -s.far, s.far)
        move = np.clip(above, -1.0, 1.0) * s.programme_step
        move += missing * (s.programme_rise if missing > 0.0 else s.programme_fall)
        if self.heard < s.start_ticks:
            self.heard += 1
            move += np.clip(above + s.start_near, -s.far, 0.0) / (s.start_weight + self.heard)
        moved = self.programme_db + gate * move
        self.programme_db = float(np.clip(moved, s.programme_min, s.programme_top))

    def _wanted(self, sone, groups):
        """Return what is wanted for the group of bands that rose most, in dB."""
        s = self.s
        self.smooth += s.group_smooth * (groups - self.smooth)
        rise = 10.0 * np.log2(10.0) * np.log10(self.smooth + s.group_sone) - self.usual
        over = rise - s.boost_deviations * self.deviation
        share = (groups / (sone + s.nothing) - s.boost_share_from) / s.boost_share_width
        wanted = np.minimum(s.boost_max, s.boost_slope * np.clip(share, 0.0, 1.0) * over)
        deviates = np.minimum(s.deviation_max, np.abs(rise)) - self.deviation
        self.deviation += s.group_deviates * deviates
        self.usual += np.where(rise > 0.0, s.group_up, s.group_down) * rise
        return max(0.0, float(wanted.max()))

    def _boost(self, wanted):
        """Let what is wanted be felt at once, as far as the loudness of all does not show it."""
        s, above = self.s, self.steady_db - self.usual_db
        extra = max(0.0, wanted - max(0.0, s.slope * above) - s.boost_natural)
        self.usual_db += above * (s.group_up if above > 0.0 else s.group_down)
        self.held = max(0.0, self.held - 1.0)
        if extra >= self.boost_db:
            self.boost_db, self.held = extra, s.boost_hold_ticks
        elif not self.held:
            self.boost_db = max(extra, self.boost_db - s.boost_fall)


def driven(s: Any, rows: Any, wanted: list[float]) -> tuple[FloatArray, int, list[Any]]:
    """Return oscillators at the low rate, (ticks x tick_steps,), as strong as is wanted at the end
    of each tick; the number of their steps that were limited; and the glides of each tick. rows:
    (tick, slot, numbers), numbers (4, tick_steps + 1): Hz, amplitude, turns, from the tick's start
    on."""
    low_rate, limited = np.zeros((len(wanted), s.tick_steps)), 0
    glides: list[Any] = []
    part = np.arange(s.tick_steps + 1) / s.tick_steps
    before, beat_before, moved_before, gain_before = 0.0, 1.0, 0.0, 0.0
    of_tick: list[list[Any]] = [[] for _ in wanted]
    for tick, slot, numbers in rows:
        if tick < len(wanted):
            of_tick[tick].append((slot, numbers))
    for tick, (now, sounding) in enumerate(zip(wanted, of_tick, strict=True)):
        if not sounding or not (before or now):
            before, beat_before, moved_before, gain_before = now, 1.0, 0.0, 0.0
            continue
        hz, amplitude, turns = np.stack([numbers for _, numbers in sounding], axis=1)
        felt = at_hz(s, s.felt_weights, hz)
        share = (felt / at_hz(s, s.gain_table, hz))[:, -1:]
        end = np.linalg.norm((amplitude * share)[:, -1])
        over = now / end * amplitude[:, -1].sum() / s.ceiling - 1.0 if end else 0.0
        moved = s.concentrated * np.clip(over, 0.0, 1.0)
        logged = amplitude * felt ** (moved_before + (moved - moved_before) * part)
        amplitude = amplitude * felt[:, -1:] ** (moved_before + (moved - moved_before) * part)
        strength = np.linalg.norm(amplitude * share, axis=0)[1:]
        beat = 1.0
        if strength[-1] ** 2 > 1e-20:  # the sum of what is too close to be told apart
            apart_hz = np.abs(hz[:, -1] - hz[:, -1:])
            counts = np.clip((s.beat_hz - apart_hz) / s.beat_width_hz, 0.0, 1.0)
            waves = (amplitude * share * np.exp(2j * np.pi * turns))[:, -1]
            beat = max(s.beat_least**2, (waves.conj() @ counts @ waves).real / strength[-1] ** 2)
        line, gain = part[1:], np.full(s.tick_steps, gain_before)
        if strength.max() > 1e-9:
            strength = np.maximum(strength, s.weakest_step * strength.max())
            beats = np.sqrt(beat_before + (beat - beat_before) * line)
            gain = np.minimum(s.gain_max, (before + (now - before) * line) / (strength * beats))
            room = s.ceiling / np.maximum(amplitude.sum(axis=0)[1:], 1e-300)
            limited += int((gain > room).sum())
            gain = np.minimum(gain, room)
            waves = amplitude * np.cos(2.0 * np.pi * turns)
            low_rate[tick] = gain * waves.sum(axis=0)[1:]
        ends = hz[:, 0], hz[:, -1], gain_before * logged[:, 0], gain[-1] * logged[:, -1]
        slots = [slot for slot, _ in sounding]
        glides += zip([tick] * len(slots), slots, *ends, turns[:, 0] % 1.0, strict=True)
        before, beat_before, moved_before, gain_before = now, beat, moved, gain[-1]
    return low_rate.reshape(-1), limited, glides
