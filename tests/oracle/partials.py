"""Partials followed from hop to hop, merged and held: "Partials", "Merging" in docs/transform.md.

Frequencies are Hz of vibration, amplitudes full scale, phases cycles.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from audioflinger_hook.transform.design.synthesis import TrackingDesign


@dataclass
class Begun:
    """What is known of a partial from an onset. goal: its amplitude; base: of what sounded near.
    weight: the share of the onset's level that it was given. age: ticks since the onset. joins: it
    has the frequency of another partial. power, hops: when a hop takes it over, the power of its
    group, and the hops for which it is then held."""

    group: tuple[int, int]
    goal: float
    base: float
    weight: float
    age: int = 0
    joins: bool = False
    power: float = 0.0
    hops: int = 0


@dataclass
class Partial:
    """One oscillator; begun: its `Begun`, if it began at an onset and is held."""

    hz: float
    amplitude: float
    phase: float
    begun: Any = None

    def glide(self, glides, tick, slot, hz, amplitude, seconds):
        """Go on to another frequency and amplitude; add what it does to the glides: tick, slot, Hz
        at start and end, amplitude at both, phase at start."""
        if self.amplitude or amplitude:
            glides.append((tick, slot, self.hz, hz, self.amplitude, amplitude, self.phase))
        # The mean frequency of a symmetric glide is that of its ends.
        self.phase = (self.phase + 0.5 * seconds * (self.hz + hz)) % 1.0
        self.hz, self.amplitude = hz, amplitude


def near_hz(s, hz):
    """Return how far from a new partial its true frequency may be, in Hz of vibration."""
    ratio = max(s.match_ratio, s.match_audio_hz / s.mapping.audio_hz(hz))
    near = s.onset_reach * (s.scale_hz + s.scale_ratio * hz) * ratio
    return max(near, float(merging_hz(s, hz))) if s.merge_ratio else near


def merging_hz(tracking, hz):
    """Return how close a partial must be to one at these Hz of vibration to be part of it."""
    return np.maximum(tracking.merge_hz, tracking.merge_ratio * np.asarray(hz))


class Partials:
    """The partials of one voice that sound, by slot, ascending; their `glides` by hop.
    start_sum: of the amplitudes at the start of the latest glides."""

    def __init__(self, s: Any) -> None:
        self.s, self.most = s, s.partials_max + s.onset_partials_max
        self.sounding: dict[int, Partial] = {}
        self.glides: list[tuple[float, ...]] = []
        self.start_sum = 0.0

    def near(self, hz: float) -> list[Partial]:
        """Return the partials that a new one at this frequency may be."""
        reach = near_hz(self.s, hz)
        return [one for one in self.sounding.values() if abs(one.hz - hz) < reach]

    def strongest_near(self, hz: float) -> Partial | None:
        """Return the strongest of those, the first of equals; None where partials do not merge."""
        found, most = None, self.s.joined_from
        for one in self.near(hz) if self.s.merge_ratio else []:
            if one.amplitude > self.s.stronger * most:
                found, most = one, one.amplitude
        return found

    def adopt(self, one: Partial) -> None:
        """Take over and hold a partial from an onset, at the end of a hop, where there is room."""
        if len(self.sounding) < self.most:
            slot = min(set(range(self.most)) - set(self.sounding))
            self.sounding = dict(sorted({**self.sounding, slot: one}.items()))

    def follow(self, tick: int, hz, amplitude, room: float, left: float, recent_power) -> None:
        """Go on to the partials that the long window shows at the end of a hop, ascending. room:
        what held ones may add to the sum of amplitudes. left: what the amplitude mapping leaves of
        the level of what is shown. recent_power: of a group of bands."""
        s, dominance = self.s, np.ones(hz.size)
        if s.merge_ratio and hz.size:
            sounding_hz = [one.hz for one in self.sounding.values()]
            hz, amplitude, dominance = merge(s.tracking, hz, amplitude, sounding_hz)
        start = {slot: replace(one) for slot, one in self.sounding.items()}
        free = iter(sorted(set(range(2 * self.most)) - set(start)))
        end: dict[int, Partial] = {}
        for (slot, gap_hz, is_its_own), new_hz, new, share in zip(
            self._nearest(hz), hz.tolist(), amplitude.tolist(), dominance, strict=True
        ):
            if not is_its_own:  # what splits off a partial begins with its phase
                phase = start[slot].phase if gap_hz < s.split_hz else 0.0
                slot = next(free)
                start[slot] = Partial(new_hz, 0.0, phase)
            one = end[slot] = replace(start[slot])
            change_hz, change = new_hz - one.hz, new - one.amplitude
            one.hz += change_hz * self._followed(change_hz / s.steady_hz) * float(share)
            one.amplitude += change * self._followed(change / (s.steady_ratio * new))
        self._hold(end, room, left, recent_power)
        self._glide(tick, start)

    def fade(self, tick: int) -> None:
        """Let every partial end in one hop."""
        start, self.sounding = self.sounding, {}
        self._glide(tick, start)

    def _nearest(self, hz):
        """Return of each partial the nearest slot, how near it is, and whether it is its own: they
        are nearest to one another and within reach."""
        s, sounding = self.s, list(self.sounding.values())
        if not sounding or not hz.size:
            return [(-1, np.inf, False)] * hz.size
        distance = np.abs(hz[:, None] - np.array([one.hz for one in sounding]))
        distance += s.first_hz * np.arange(len(sounding))
        nearest, gap_hz = distance.argmin(axis=1), distance.min(axis=1)
        audio_hz = np.array([s.mapping.audio_hz(one) for one in hz])
        reach_hz = np.maximum(s.match_ratio, s.match_audio_hz / audio_hz)
        reach_hz *= s.scale_hz + s.scale_ratio * hz
        if s.merge_ratio:
            reach_hz = np.maximum(reach_hz, merging_hz(s, hz))
        reach_hz *= np.array([s.onset_reach if one.begun else 1.0 for one in sounding])[nearest]
        mutual = distance.argmin(axis=0)[nearest] == np.arange(hz.size)
        slots = np.array(list(self.sounding))[nearest]
        return zip(slots.tolist(), gap_hz, mutual & (gap_hz <= reach_hz), strict=True)

    def _followed(self, relative_change):
        """Return the share of a change that is followed: all of a clear one, little of a jitter."""
        return min(1.0, self.s.steady_gain + relative_change * relative_change)

    def _hold(self, end, room, left, recent_power):
        """Keep what is held at its amplitude, as far as there is room and the mapping leaves it."""
        held = {slot: one for slot, one in self.sounding.items() if one.begun}
        squares = sum(one.begun.weight**2 for one in held.values())
        known = 1.0 if squares <= left * left else left / squares**0.5
        wanted = {}
        for slot, one in held.items():
            begun, amplitude = one.begun, one.begun.goal + one.begun.base
            share = recent_power(begun.group) / begun.power if begun.power > 0.0 else 0.0
            now, full = amplitude * min(1.0, share) ** 0.5, len(end) >= self.most
            least = self.s.min_held_share * amplitude
            if begun.hops and now >= least and (slot in end or not full):
                begun.hops, wanted[slot] = begun.hops - 1, now * known
                end.setdefault(slot, replace(one, amplitude=0.0))
            elif slot in end:
                end[slot].begun = None
        self.sounding = dict(sorted(end.items()))
        sounds = {slot: sum(one.amplitude for one in self.near(end[slot].hz)) for slot in wanted}
        lacking = {slot: max(0.0, wanted[slot] - sounds[slot]) for slot in wanted}
        total = sum(lacking.values())
        for slot, lack in lacking.items():
            end[slot].amplitude += lack if total <= room else lack * room / total

    def _glide(self, tick, start):
        """Write the glides of the next hop, from its start to what sounds at its end."""
        self.start_sum = sum(one.amplitude for one in start.values())
        for slot, one in start.items():
            new = self.sounding.get(slot, Partial(one.hz, 0.0, 0.0))
            one.glide(self.glides, tick, slot, new.hz, new.amplitude, self.s.hop_s)
            new.phase = one.phase


def merge(design: TrackingDesign, hz, amplitude, sounding_hz: list[float]):
    """Return groups of partials: their frequencies, amplitudes and dominance, each (groups,).
    hz, amplitude: (partials,), ascending in frequency. sounding_hz: frequencies that sound; what is
    close to one belongs to it. A group has the energy of its partials and their mean frequency by
    energy. Its dominance is the share of its strongest partial, 0 to 1."""
    centres, members = list(sounding_hz), dict[int, list[int]]()
    for one, here in enumerate(hz.tolist()):
        gaps = [abs(here - centre) for centre in centres]
        nearest = int(np.argmin(gaps)) if gaps else -1
        if nearest < 0 or gaps[nearest] > merging_hz(design, centres[nearest]):
            nearest = len(centres)
            centres.append(here)
        members.setdefault(nearest, []).append(one)
    power = amplitude * amplitude
    some = [group for group in members.values() if power[group].any()]
    groups = [(power[one].sum(), (power * hz)[one].sum(), power[one].max()) for one in some]
    groups.sort(key=lambda group: group[1] / group[0])
    while len(groups) > 1:
        centre = np.array([weighted / total for total, weighted, _ in groups])
        gap = np.diff(centre) / merging_hz(design, centre[:-1])
        closest = int(gap.argmin())
        if gap[closest] >= design.merge_again:
            break
        low, high = groups[closest], groups.pop(closest + 1)
        groups[closest] = (low[0] + high[0], low[1] + high[1], max(low[2], high[2]))
    total, weighted, most = np.array(groups).reshape(-1, 3).T
    return weighted / total, np.sqrt(total), most / total
