"""Design of the playing parts: time grid, tracking of partials, oscillators and low-pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.core.rounding import round_filter, round_sections
from audioflinger_hook.transform.arrays import ComplexArray, FloatArray
from audioflinger_hook.transform.filters import (
    BUTTERWORTH_1,
    ELLIPTIC_6,
    high_pass,
    low_pass,
    response,
    response_of_sections,
)
from audioflinger_hook.transform.parameters import TransformParameters

# Rate of the oscillators, or a little more: over six times the highest vibration frequency.
LOW_RATE_HZ = 3_000.0
# The hop is about 18 ms. Onsets do not wait for it, and a shorter one costs more.
HOPS_A_WINDOW = 2.55
TICK_S = 0.002  # interval at which onsets are searched and vibration is computed

ATTACK_HOPS = 0.35
"""Share of a hop in which amplitudes glide where their sum rises: an onset is felt 5 ms earlier
than with a whole one. The low-pass still keeps what leaks above 250 Hz under -58 dB. Where the sum
falls, amplitudes take the whole hop."""

RING_OUT_CYCLES = 92.0
"""After the last partial the low-pass rings. After so many cycles of the top vibration frequency
(0.42 s at 220 Hz) it is under 1e-8 and is cut off."""

LOW_PASS, HIGH_PASS = ELLIPTIC_6, BUTTERWORTH_1
"""Of the samples at the low rate; the second one not in the paper's form. A steeper one turns
phases so far that impacts are blunt."""

HIGH_PASS_HZ = (42.0, 18.0)
"""Two high-passes lower swings of the envelope below the lowest vibration, where
an actuator moves far for a weak sensation. Amplitudes undo their gain. The second one lowers the
energy under 15 Hz of the worst sound by 4 dB and takes 0.7 ms."""

GAIN_FLOOR = 0.45
"""Amplitudes undo at most a fall to this: under the lowest vibration frequency none is played."""

FOLLOWED_CEILING = 0.93
"""Where loudness is followed, amplitudes rise within 2 ms, and the low-pass overshoots by 7 %.
With 0.98 the knee leaves -44 dB over 250 Hz of the hardest stroke instead of -64 dB."""

BEGIN_S = 0.005  # a stream fades in over this time
EDGE_MARGIN = 1.01  # the pass band ends at the top vibration frequency times this
# But in the paper's form, the pass band ends here or higher: a lower one would be later.
LEAST_EDGE_HZ = 220.0
# Interpolation by four samples adds less than -83 dB to any partial up to 220 Hz, for 0.7 ms.
TAPS = 4
FITTED_AT = 200  # frequencies at which the interpolation is fitted


@dataclass(frozen=True, eq=False)
class LiveGrid:
    """How the live form divides time at one samplerate.

    Everything is a whole number of frames, so that no split of the input can shift it.
    """

    window_frames: int  # frames in one analysis
    decimation: int  # frames in one step of the low rate
    tick_steps: int  # steps from one search for onsets to the next
    ticks: int  # ticks in one hop
    steps: int  # steps of the low rate in one hop
    tick_frames: int  # frames in one tick
    hop_frames: int  # frames from one analysis to the next
    hops_in_window: int  # hops that together cover one window
    hop_s: float
    tick_s: float

    @classmethod
    def at(cls, parameters: TransformParameters, samplerate: int) -> LiveGrid:
        """Return the grid for a samplerate in Hz."""
        window_frames = parameters.window_frames(samplerate)
        decimation = max(1, int(samplerate / LOW_RATE_HZ))
        tick_steps = max(2, round(TICK_S * samplerate / decimation))
        ticks = max(1, round(window_frames / (HOPS_A_WINDOW * decimation * tick_steps)))
        tick_frames = decimation * tick_steps
        hop_frames = tick_frames * ticks
        return cls(
            window_frames=window_frames,
            decimation=decimation,
            tick_steps=tick_steps,
            ticks=ticks,
            steps=tick_steps * ticks,
            tick_frames=tick_frames,
            hop_frames=hop_frames,
            hops_in_window=-(-window_frames // hop_frames),
            hop_s=hop_frames / samplerate,
            tick_s=tick_frames / samplerate,
        )


@dataclass(frozen=True, eq=False)
class TrackingDesign:
    """How partials are matched, averaged and held from hop to hop."""

    hold_hops: int  # hops for which a partial from an onset is held
    match_audio_hz: float  # a partial may move by this in one hop, in Hz of audio
    steady_ratio: float  # smaller changes of amplitude are averaged, as a ratio
    merge_ratio: float  # partials closer than this share of their frequency are one; 0: none are
    merge_hz: float = 12.0  # and those closer than this: their beats would be felt as a warble
    merge_again: float = 0.8  # share of the same distance below which two groups become one
    # A partial may also move by two semitones: a chirp of three octaves a second is followed.
    match_ratio: float = 0.12
    split_hz: float = 2.0  # a partial born this near to another, Hz of vibration, has split off it
    steady_hz: float = 0.05  # smaller changes of vibration frequency are averaged
    steady_gain: float = 0.15  # share of the smallest changes that is followed in one hop
    # Added to the distance of each further slot, in Hz of vibration, so that the first of equally
    # near slots wins: two onsets of the same sound give birth at the same frequency.
    first_hz: float = 1e-9
    onset_reach: float = 2.0  # factor on the reach of a held partial, of which little is known yet
    min_held_share: float = 0.05  # share of its amplitude below which a partial is no longer held
    stronger: float = 1.0 + 1e-9  # ratio from which on one amplitude is larger than another
    joined_from: float = 1e-4  # up to this amplitude no partial is joined: rounding may leave some

    @classmethod
    def of(cls, parameters: TransformParameters, hop_s: float) -> TrackingDesign:
        """Return the design for hops of this many seconds."""
        return cls(
            hold_hops=max(1, round(parameters.window_s / hop_s)),
            # Half the width of the window's main lobe.
            match_audio_hz=2.0 / parameters.window_s,
            merge_ratio=parameters.merge_ratio,
            # Merged partials waver more: they hold several tones, or noise.
            steady_ratio=0.12 if parameters.merge_ratio else 0.03,
        )


@dataclass(frozen=True, eq=False)
class SynthesisDesign:
    """How partials become samples: glides, low-pass, interpolation and limiter."""

    ring_hops: int  # hops that the low-pass rings after the last partial
    attack: FloatArray  # shape of a rise over one hop, 0 to 1, one entry a step
    glide: FloatArray  # shape of a fall: half a cosine period
    seconds: FloatArray  # time from the hop's start, one entry a step
    glide_s: FloatArray  # integral of a glide of frequency, in seconds
    tick_glide: FloatArray  # `glide` over one tick
    tick_glide_s: FloatArray  # `glide_s` over one tick
    low_b: FloatArray  # low-pass at the low rate: numerator; empty if there are `low_sections`
    low_a: FloatArray  # its denominator
    # Low-pass and high-pass as second-order sections (sections, 6), which round less; empty in the
    # paper's form, whose bits stay as they are.
    low_sections: FloatArray
    begin_fade: FloatArray  # on the first frames after `begin_frames`; empty in the paper's form
    phases: FloatArray  # interpolation to the samplerate, (taps, decimation): a column a new frame
    gain_table: FloatArray  # undoes the low-pass's ripple, by vibration frequency
    begin_frames: int = 0  # frames at the start of a stream that are silent: files do not have them
    gain_step_hz: float = 0.25  # between entries of `gain_table`
    # A sum of amplitudes rises from here on: rounding must not choose between the shapes.
    still: float = 1e-9
    # Largest sum of a hop's amplitudes; a full-scale tone keeps its level within 0.2 dB.
    ceiling: float = 0.98
    # Samples up to here pass unchanged. Above, they approach full scale and never reach it.
    knee: float = 0.985

    @classmethod
    def of(
        cls, parameters: TransformParameters, grid: LiveGrid, samplerate: int
    ) -> SynthesisDesign:
        """Return the design for one grid and samplerate."""
        top_hz = EDGE_MARGIN * parameters.vibration_top_hz
        low_rate_hz = samplerate / grid.decimation
        followed = parameters.loudness_db > 0.0
        plain = not followed and parameters.strength == "flat"
        edge_hz = top_hz if plain else max(top_hz, EDGE_MARGIN * LEAST_EDGE_HZ)
        zeros, poles, gain = low_pass(LOW_PASS, edge_hz, low_rate_hz)
        low_b = low_a = sections = np.zeros(0)
        if plain:
            low_b, low_a = round_filter(zeros, poles, gain)
        else:
            for hz in HIGH_PASS_HZ:
                high = high_pass(HIGH_PASS, hz, low_rate_hz)
                zeros = np.concatenate((zeros, high.zeros))
                poles = np.concatenate((poles, high.poles))
                gain *= high.gain
            sections = round_sections(zeros, poles, gain)
        played_hz = np.arange(0.0, top_hz, cls.gain_step_hz)
        passed = _passed(low_b, low_a, sections, played_hz, low_rate_hz)
        fade_frames = round(BEGIN_S * samplerate) if followed else 0
        time = np.arange(1, grid.steps + 1) / grid.steps
        turn, turn_glide = glide_turns(grid.steps, grid.hop_s)
        _, tick_turn_glide = glide_turns(grid.tick_steps, grid.tick_s)
        ring_s = RING_OUT_CYCLES / parameters.vibration_top_hz
        return cls(
            ring_hops=int(np.ceil(ring_s / grid.hop_s)),
            attack=0.5 - 0.5 * np.cos(np.pi * np.minimum(1.0, time / ATTACK_HOPS)),
            glide=glide_shape(grid.steps),
            seconds=turn / (2.0 * np.pi),
            glide_s=turn_glide / (2.0 * np.pi),
            tick_glide=glide_shape(grid.tick_steps),
            tick_glide_s=tick_turn_glide / (2.0 * np.pi),
            low_b=low_b,
            low_a=low_a,
            low_sections=sections,
            begin_fade=glide_shape(fade_frames),
            ceiling=FOLLOWED_CEILING if followed else cls.ceiling,
            phases=interpolation_phases(grid.decimation, top_hz, low_rate_hz),
            gain_table=1.0 / np.maximum(np.abs(passed), GAIN_FLOOR),
        )

    def delay_s(self, hz: float, samplerate: int) -> float:
        """Return how late the envelope of a steady partial leaves, in seconds."""
        step_hz = 0.01
        low_rate_hz = samplerate / self.phases.shape[1]
        either_side = np.array([hz - step_hz, hz + step_hz])
        passed = _passed(self.low_b, self.low_a, self.low_sections, either_side, low_rate_hz)
        turn = np.angle(passed[0] / passed[1])
        low_pass_s = turn / (2.0 * np.pi * 2.0 * step_hz)
        interpolation_s = (self.phases.size - 1) / 2 / samplerate
        return float(low_pass_s + interpolation_s)


def _passed(
    b: FloatArray, a: FloatArray, sections: FloatArray, hz: FloatArray, rate_hz: float
) -> ComplexArray:
    """Return the response at frequencies, of the sections or, if there are none, of b and a."""
    if sections.size:
        return response_of_sections(sections, hz, rate_hz)
    return response(b, a, hz, rate_hz)


def glide_shape(steps: int) -> FloatArray:
    """Return half a cosine period from 0 to 1, (steps,): it has no kink at either end."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * (np.arange(1, steps + 1) / steps)))


def glide_turns(steps: int, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return the phase in radians for each Hz at the start and each Hz of the glide, (steps,)."""
    time = np.arange(1, steps + 1) / steps
    turns = 2.0 * np.pi * seconds
    return turns * time, turns * (0.5 * time - np.sin(np.pi * time) / (2.0 * np.pi))


def interpolation_phases(decimation: int, top_hz: float, low_rate_hz: float) -> FloatArray:
    """Return the kernel (taps, decimation) nearest to a delay, by least squares up to `top_hz`.

    A cubic is better at the lowest frequencies, but 13 dB worse at the top.
    """
    if decimation == 1:
        return np.ones((1, 1))
    between = (np.arange(decimation) + 0.5) / decimation
    turn = 2.0 * np.pi * np.linspace(0.0, top_hz, FITTED_AT)[:, None] / low_rate_hz
    taps = turn * (np.arange(TAPS) - (TAPS // 2 - 1))
    wanted = turn * between
    # Cosines and sines of both: a fit in real numbers.
    phases, *_ = np.linalg.lstsq(
        np.concatenate((np.cos(taps), np.sin(taps))),
        np.concatenate((np.cos(wanted), np.sin(wanted))),
    )
    return np.asarray(phases)
