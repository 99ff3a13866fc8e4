"""From partials to vibration: oscillators at the low rate, low-pass, interpolation and limiter.

The sum of a hop's amplitudes is known before it is played, so the limiter needs no look-ahead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from audioflinger_hook.transform.arrays import FloatArray, strided_windows
from audioflinger_hook.transform.design.synthesis import LiveGrid, SynthesisDesign, glide_turns

GLIDE_COLUMNS = (
    "frame", "frames", "voice", "slot", "start_hz", "end_hz", "start_amplitude", "end_amplitude",
    "start_phase",
)  # fmt: skip
"""Columns of recorded glides: first frame and number of frames of a hop or, for partials of an
onset, of a tick; channel of vibration; slot; Hz of vibration, amplitudes in full scale, cycles."""


@dataclass(frozen=True)
class Glides:
    """What each slot of the oscillator bank does in each hop: arrays (hops, slots), float64.

    Frequencies in Hz of vibration, amplitudes in full scale, phase in cycles at the hop's start.
    A slot at amplitude 0 at both ends is idle.
    """

    start_hz: FloatArray
    end_hz: FloatArray
    start_amplitude: FloatArray
    end_amplitude: FloatArray
    start_phase: FloatArray

    @classmethod
    def silent(cls, hops: int, slots: int) -> Glides:
        """Return glides in which every slot is idle."""
        return cls(*np.zeros((5, hops, slots)))

    def row(self, hop: int, slot: int) -> tuple[float, ...]:
        """Return the numbers of one slot in one hop, in the order of the fields."""
        return tuple(
            float(values[hop, slot])
            for values in (
                self.start_hz,
                self.end_hz,
                self.start_amplitude,
                self.end_amplitude,
                self.start_phase,
            )
        )

    def hops(self, first: int, last: int) -> Glides:
        """Return the hops from first up to last as a view."""
        return Glides(
            self.start_hz[first:last],
            self.end_hz[first:last],
            self.start_amplitude[first:last],
            self.end_amplitude[first:last],
            self.start_phase[first:last],
        )


class OscillatorBank:
    """Samples of gliding partials; pure, holds only the shape of a glide.

    attack, glide: shapes of a rise and a fall over one hop of hop_s seconds, one entry a step.
    still: a sum of amplitudes rises from here on. Phase is the integral of frequency and therefore
    continuous.
    """

    def __init__(self, attack: FloatArray, glide: FloatArray, hop_s: float, still: float) -> None:
        self._attack, self._glide = attack, glide
        self._turn, self._turn_glide = glide_turns(glide.size, hop_s)
        self._still = still

    def render(self, glides: Glides) -> FloatArray:
        """Return (hops, steps) of the summed partials, full scale.

        Slots are added one after another, so a slot at amplitude 0 changes no byte and is left
        out where it is silent in the whole batch.
        """
        rise = glides.end_amplitude - glides.start_amplitude
        loudest = np.maximum(glides.start_amplitude, glides.end_amplitude).max(axis=0)
        slots = loudest.nonzero()[0]

        def of_slots(values: FloatArray) -> FloatArray:
            chosen: FloatArray = values.take(slots, axis=1).T[:, :, None]
            return chosen

        start_hz = of_slots(glides.start_hz)
        phase = start_hz * self._turn
        phase += (of_slots(glides.end_hz) - start_hz) * self._turn_glide
        phase += (2.0 * np.pi) * of_slots(glides.start_phase)
        partials = np.cos(phase, out=phase)
        # With one shape for all slots of a hop their sum never exceeds both its ends. That keeps
        # the wave under full scale.
        rising = np.add.reduce(rise, axis=1) > self._still
        shape = np.where(rising[:, None], self._attack, self._glide)
        level = of_slots(rise) * shape
        level += of_slots(glides.start_amplitude)
        partials *= level
        total: FloatArray = np.add.reduce(partials, axis=0)
        return total


class Smoother:
    """Vibration at the low rate made smooth and brought to the stream's samplerate.

    Births and deaths of partials spread energy over the band where a shaker is audible. An
    elliptic low-pass just above the top vibration frequency removes it with the least delay.
    Each partial's own amplitude undoes the ripple in the band (`compensation`). Use from one
    thread at a time.
    """

    def __init__(self, design: SynthesisDesign) -> None:
        self._b, self._a, self._phases = design.low_b, design.low_a, design.phases
        self._table_hz = design.gain_step_hz * np.arange(design.gain_table.size)
        self._table_gain = design.gain_table
        self.reset()

    def reset(self) -> None:
        """Return to rest."""
        self._state = np.zeros(self._a.size - 1)
        self._tail = np.zeros(len(self._phases) - 1)

    def compensation(self, hz: FloatArray) -> FloatArray:
        """Return the amplitude factors that undo the low-pass's ripple at vibration frequencies."""
        factors: FloatArray = np.interp(hz, self._table_hz, self._table_gain)
        return factors

    def render(self, low_rate: FloatArray) -> FloatArray:
        """Return (frames,) at the stream's samplerate from (hops, steps) at the low rate.

        Each hop is one matrix product of fixed shape: larger ones may round otherwise.
        """
        hops, steps = low_rate.shape
        smooth, self._state = lfilter(self._b, self._a, low_rate.reshape(-1), zi=self._state)
        taps = len(self._phases)
        joined = np.concatenate((self._tail, smooth))
        self._tail = joined[joined.size - (taps - 1) :]
        windows = strided_windows(joined, taps, 1).reshape(hops, steps, taps)
        frames: FloatArray = windows @ self._phases
        return frames.reshape(-1)


def limit_amplitudes(amplitude: FloatArray, ceiling: float) -> tuple[FloatArray, bool]:
    """Return one hop's amplitudes, scaled so that they sum to the ceiling at most, and whether."""
    total = float(amplitude.sum())
    if total <= ceiling:
        return amplitude, False
    return amplitude * (ceiling / total), True


def limit_samples(vibration: FloatArray, knee: float) -> tuple[FloatArray, int]:
    """Return the samples with those beyond the knee rounded off, and how many there were."""
    size = np.abs(vibration)
    if size.max(initial=0.0) <= knee:
        return vibration, 0
    room = 1.0 - knee
    over = size > knee
    rounded = knee + room * np.tanh((size - knee) / room) * (1.0 - 1e-6)
    return np.where(over, np.copysign(rounded, vibration), vibration), int(over.sum())


class Synthesizer:
    """Vibration of what the oscillators do: both banks, smoothed and limited. One thread at a time.

    smoother: brings the sum of the banks to the stream's samplerate.
    """

    def __init__(self, design: SynthesisDesign, grid: LiveGrid) -> None:
        self._grid = grid
        self._knee = design.knee
        self._bank = OscillatorBank(design.attack, design.glide, grid.hop_s, design.still)
        self._tick_bank = OscillatorBank(
            design.tick_glide, design.tick_glide, grid.tick_s, design.still
        )
        self.smoother = Smoother(design)
        self.reset()

    def reset(self) -> None:
        """Return to rest."""
        self._hop = np.zeros((self._grid.ticks, self._grid.tick_steps))
        self.smoother.reset()

    def play(
        self, hops: Glides, fresh: Glides, awake: list[bool], tick: int
    ) -> tuple[FloatArray, int]:
        """Return the vibration of the ticks in `awake`, and how many of its frames were limited.

        hops: of those that become full; fresh: of each tick. A tick that is not awake is exactly 0
        and forgets its ringing. tick: number of the first one within its hop.
        """
        grid = self._grid
        ticks = len(awake)
        low_rate = self._tick_bank.render(fresh)
        # The hop under way goes on until the first of these is full.
        rows = self._hop[tick + 1 :]
        if len(hops.start_hz):
            rendered = self._bank.render(hops).reshape(-1, grid.tick_steps)
            rows = np.concatenate((rows, rendered))
            self._hop = rendered[-grid.ticks :]
        low_rate += rows[:ticks]
        vibration = np.zeros(ticks * grid.tick_frames)
        limited_frames = 0
        first = 0
        while first < ticks:
            last = first + 1
            while last < ticks and awake[last] == awake[first]:
                last += 1
            if awake[first]:
                smooth = self.smoother.render(low_rate[first:last])
                played, limited = limit_samples(smooth, self._knee)
                vibration[first * grid.tick_frames : last * grid.tick_frames] = played
                limited_frames += limited
            else:
                self.smoother.reset()
            first = last
        return vibration, limited_frames
