"""Constants and tables of the time grid, the tracking of partials, and the synthesis."""

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.core.rounding import round_filter, round_sections
from audioflinger_hook.transform import filters
from audioflinger_hook.transform.arrays import ComplexArray, FloatArray
from audioflinger_hook.transform.parameters import TransformParameters

LOW_RATE_HZ = 3_000.0  # approximate samplerate of the oscillators (low rate)
HOPS_A_WINDOW = 2.55  # hops per window, for a hop of about 18 ms
TICK_S = 0.002  # interval of the search for onsets and of the computation of vibration

ATTACK_HOPS = 0.35
"""Duration of an amplitude glide, in hops, if the sum of all amplitudes rises. Other glides take 1
hop."""

# Duration of the low-pass's impulse response, down to 1e-8, in cycles of `vibration_top_hz`.
RING_OUT_CYCLES = 92.0

# The phase shift of a steeper high-pass would smear impacts.
LOW_PASS, HIGH_PASS = filters.ELLIPTIC_6, filters.BUTTERWORTH_1

HIGH_PASS_HZ = (42.0, 18.0)
"""Edges of two high-passes, which reduce excursion below the lowest vibration frequency.
`gain_table` compensates the gain down to `GAIN_FLOOR`. The second high-pass adds a delay of 0.7 ms
at 60 Hz."""

GAIN_FLOOR = 0.45  # `gain_table` compensates filter gains down to this value

FOLLOWED_CEILING = 0.93
"""Largest sum of amplitudes with loudness control. This value leaves 7 % of full scale for the
overshoot of the low-pass."""

BEGIN_S = 0.005  # fade-in at the start of a stream
EDGE_MARGIN = 1.01  # ratio of the pass band's end to the top vibration frequency
LEAST_EDGE_HZ = 220.0  # lowest end of the pass band, except for strength "flat" without control
TAPS = 4  # coefficients per interpolated frame; the delay is two steps, 0.7 ms
FITTED_AT = 200  # number of frequencies for the least-squares fit of the interpolation


@dataclass(frozen=True, eq=False)
class LiveGrid:
    """Time grid of the live form. A hop consists of ticks, and a tick of steps."""

    window_frames: int  # frames per analysis window
    decimation: int  # frames per step; a step is one sample at the low rate
    tick_steps: int  # steps per tick
    ticks: int  # ticks per hop
    steps: int  # steps per hop
    tick_frames: int  # frames per tick
    hop_frames: int  # frames per hop, the interval between two analyses
    hops_in_window: int  # smallest number of hops that cover a window
    hop_s: float
    tick_s: float

    @classmethod
    def at(cls, parameters: TransformParameters, samplerate: int) -> "LiveGrid":
        """Return the time grid for a samplerate in Hz."""
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
    """Constants for matching partials with those of the last hop, and averaging their values."""

    hold_hops: int  # hold time of an onset partial in hops
    match_audio_hz: float  # largest change of audio frequency per hop, Hz; see `match_ratio`
    steady_ratio: float  # smaller relative changes of amplitude are averaged
    merge_ratio: float  # partials with a smaller relative distance are merged; 0: off
    merge_hz: float = 12.0  # if merging is on, partials with a smaller distance are merged, too
    merge_again: float = 0.8  # groups closer than this share of the merge distance are merged
    match_ratio: float = 0.12  # largest change relative to the frequency; the larger limit applies
    split_hz: float = 2.0  # a new partial this close to an old partial starts with the same phase
    steady_hz: float = 0.05  # smaller changes of vibration frequency are averaged
    steady_gain: float = 0.15  # weight of the smallest changes in the average
    first_hz: float = 1e-9  # distance added per slot, so that the first of equal distances wins
    onset_reach: float = 2.0  # factor on both limits of change, for onset partials
    min_held_share: float = 0.05  # lowest amplitude in the hold time, as a share of the first one
    stronger: float = 1.0 + 1e-9  # amplitudes with a smaller ratio count as equal
    joined_from: float = 1e-4  # onset partials merge only with partials above this amplitude

    @classmethod
    def of(cls, parameters: TransformParameters, hop_s: float) -> "TrackingDesign":
        """Return the design for hops of `hop_s` seconds."""
        return cls(
            hold_hops=max(1, round(parameters.window_s / hop_s)),
            # The main lobe of the window is twice as wide.
            match_audio_hz=2.0 / parameters.window_s,
            merge_ratio=parameters.merge_ratio,
            # Merged partials fluctuate more, because a merged partial contains several tones.
            steady_ratio=0.12 if parameters.merge_ratio else 0.03,
        )


@dataclass(frozen=True, eq=False)
class SynthesisDesign:
    """Constants and tables of the synthesis: changes of amplitude, filters, and limiter."""

    ring_hops: int  # duration of the low-pass's impulse response in hops
    attack: FloatArray  # shape of an amplitude rise over one hop, from 0 to 1, (steps,)
    glide: FloatArray  # shape of an amplitude fall, half a cosine period, (steps,)
    seconds: FloatArray  # time since the start of the hop, (steps,)
    glide_s: FloatArray  # integral of `glide` in seconds, (steps,)
    tick_glide: FloatArray  # `glide` over one tick
    tick_glide_s: FloatArray  # `glide_s` over one tick
    low_b: FloatArray  # numerator of the low-pass at the low rate; empty with `low_sections`
    low_a: FloatArray  # denominator
    low_sections: FloatArray  # low-pass and high-passes as second-order sections, or empty
    begin_fade: FloatArray  # fade-in after `begin_frames`; empty without loudness control
    phases: FloatArray  # interpolation to the samplerate, (taps, decimation)
    gain_table: FloatArray  # factor per vibration frequency that compensates the filters' gain
    begin_frames: int = 0  # silent frames at the start of a stream
    gain_step_hz: float = 0.25  # interval of entries of `gain_table`
    still: float = 1e-9  # smallest rise of the sum of amplitudes that selects `attack`
    ceiling: float = 0.98  # largest sum of amplitudes, only 0.2 dB below full scale
    knee: float = 0.985  # larger samples are compressed to less than full scale

    @classmethod
    def of(
        cls, parameters: TransformParameters, grid: LiveGrid, samplerate: int
    ) -> "SynthesisDesign":
        """Return the design for a time grid and a samplerate in Hz."""
        top_hz = EDGE_MARGIN * parameters.vibration_top_hz
        low_rate_hz = samplerate / grid.decimation
        followed = parameters.loudness_db > 0.0
        plain = not followed and parameters.strength in ("flat", "fit")
        edge_hz = top_hz if plain else max(top_hz, EDGE_MARGIN * LEAST_EDGE_HZ)
        zeros, poles, gain = filters.low_pass(LOW_PASS, edge_hz, low_rate_hz)
        low_b = low_a = sections = np.zeros(0)
        if plain:
            low_b, low_a = round_filter(zeros, poles, gain)
        else:
            for hz in HIGH_PASS_HZ:
                high = filters.high_pass(HIGH_PASS, hz, low_rate_hz)
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
        return cls(
            ring_hops=int(np.ceil(RING_OUT_CYCLES / parameters.vibration_top_hz / grid.hop_s)),
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
        """Return the total group delay, in seconds, of filters and interpolation at `hz`."""
        step_hz = 0.01
        low_rate_hz = samplerate / self.phases.shape[1]
        either_side = np.array([hz - step_hz, hz + step_hz])
        passed = _passed(self.low_b, self.low_a, self.low_sections, either_side, low_rate_hz)
        low_pass_s = np.angle(passed[0] / passed[1]) / (2.0 * np.pi * 2.0 * step_hz)
        return float(low_pass_s + (self.phases.size - 1) / 2 / samplerate)


def _passed(
    b: FloatArray, a: FloatArray, sections: FloatArray, hz: FloatArray, rate_hz: float
) -> ComplexArray:
    """Return the frequency response of `sections`; if they are empty, that of the filter b, a."""
    if sections.size:
        return filters.response_of_sections(sections, hz, rate_hz)
    return filters.response(b, a, hz, rate_hz)


def glide_shape(steps: int) -> FloatArray:
    """Return a rise from 0 to 1 in the shape of half a cosine period, (steps,)."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * (np.arange(1, steps + 1) / steps)))


def glide_turns(steps: int, seconds: float) -> tuple[FloatArray, FloatArray]:
    """Return phases in radians, (steps,), of a sine at 1 Hz and of one rising from 0 to 1 Hz."""
    time = np.arange(1, steps + 1) / steps
    turns = 2.0 * np.pi * seconds
    return turns * time, turns * (0.5 * time - np.sin(np.pi * time) / (2.0 * np.pi))


def interpolation_phases(decimation: int, top_hz: float, low_rate_hz: float) -> FloatArray:
    """Return interpolation coefficients, (taps, decimation): a least-squares fit up to `top_hz`."""
    if decimation == 1:
        return np.ones((1, 1))
    between = (np.arange(decimation) + 0.5) / decimation
    turn = 2.0 * np.pi * np.linspace(0.0, top_hz, FITTED_AT)[:, None] / low_rate_hz
    taps = turn * (np.arange(TAPS) - (TAPS // 2 - 1))
    wanted = turn * between
    phases, *_ = np.linalg.lstsq(
        np.concatenate((np.cos(taps), np.sin(taps))),
        np.concatenate((np.cos(wanted), np.sin(wanted))),
    )
    return np.asarray(phases)
