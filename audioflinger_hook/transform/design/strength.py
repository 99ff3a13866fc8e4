"""Design of the strength by loudness: the programme's level, the gate, rises."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.synthesis import LiveGrid, SynthesisDesign
from audioflinger_hook.transform.parameters import TransformParameters

FELT_AT_HZ = 40.0
"""Vibration of this frequency has weight 1. Above 12.5 Hz, the sensitivity of a seated body to
vertical acceleration falls with the inverse of frequency: W_k of ISO 2631-1 without its limit at
100 Hz, and contours of equal comfort (Griffin, Whitham and Parsons, Ergonomics 25, 1982)."""

FELT_FROM_HZ = 30.0  # lower vibration counts as this frequency: few actuators reach lower
RIG_LEAST = 1.0 / 16.0
"""An actuator that moves less for a volt counts as if it moved so much: more would be excursion."""

PROGRAMME_TOP_DB = -10.0
"""Loudness of the loudest programmes; programmes down to `loudness_db` below it are lifted."""

PROGRAMME_START_DB = -20.0  # level of the programme before any sound
START_S, START_WEIGHT_S = 2.0, 0.5
"""In so much sound, the programme's level is found at the beginning of a stream: it moves towards
the mean, in which the level before counts as so much sound."""

RELEASE_DB_A_S = 10.0  # fall of what counts for the programme, which rises at once

PROGRAMME_DB_A_S, RISE_S, FALL_S = 0.1, 240.0, 120.0
"""The programme's level goes to the loudness at this rate, so that half of the time is over it, and
makes up for what is missing in so many seconds: a crescendo is felt as one."""

FLOOR_RISE_DB_A_S = 2.0
"""The noise floor is the least recent loudness: it falls at once and rises at this rate."""

JITTER_S, SLOW_S = 0.1, 0.03  # averages: jitter of loudness, what counts for the programme

ATTACK_S = 0.012
"""After a jump, all changes are followed for so long: until the windows are filled by the new
sound, whose strength would else be `jitter` too small for its first 0.1 s."""

GROUP_S, GROUP_UP_S, GROUP_DOWN_S, GROUP_DEVIATES_S = 0.006, 0.2, 0.4, 1.0
"""Times in which the level of a group of bands is averaged, what is usual follows a rise, or a
fall, and its mean deviation is found."""

GROUP_SONE = 0.02  # added to the sone of a group: below, a rise is none
BOOST_HOLD_S, BOOST_FALL_DB_A_S = 0.03, 80.0  # how long a boost stays, and how fast it goes


@dataclass(frozen=True, eq=False)
class StrengthDesign:
    """How strong vibration is by loudness; levels in dB, rates in dB per tick, times in ticks.

    A share is what a tick adds to an average. What a rise adds to the strength is a boost.
    """

    programme_start: float
    programme_min: float
    programme_step: float
    programme_rise: float  # share of what is missing, upwards
    programme_fall: float  # share of what is missing, downwards
    start_ticks: float
    start_weight: float  # ticks
    release: float
    slow_followed: float  # share
    floor_min: float  # loudness up to which there is no vibration
    floor_rise: float
    gate: float  # width of the soft gate over the noise floor
    jitter: float  # smaller changes of loudness are jitter, of which steady sounds consist
    jitter_followed: float  # share
    attack_ticks: float
    group_smooth: float  # share
    group_up: float  # share
    group_down: float  # share
    group_deviates: float  # share
    boost_hold_ticks: float
    boost_fall: float
    boost_max: float
    target: float  # vibration at the programme's level
    slope: float  # vibration for each dB of loudness
    gain_max: float  # largest factor on amplitudes
    felt_weights: FloatArray  # sensitivity by vibration frequency, in steps of `gain_step_hz`
    programme_top: float = PROGRAMME_TOP_DB
    # At the start the level goes down to so much over what is heard: a soft beginning is still one.
    start_near: float = 10.0
    far: float = 20.0  # more than this is not missing
    floor_under: float = 35.0  # least distance of noise floor and programme: steady is no noise
    # Share of the gate's width that is still silent. At the floor itself, where the quietest
    # recent tick stands exactly, rounding would decide.
    gate_margin: float = 0.01
    jump: float = 10.0  # a rise in one tick by more is a jump
    group_sone: float = GROUP_SONE
    silence_db: float = 10.0 * math.log2(GROUP_SONE)  # level of a group of bands in silence
    deviation_start: float = 3.0
    deviation_max: float = 10.0  # most that one tick counts for the mean deviation
    # A rise is so many mean deviations over the usual: noise, vibrato and beats raise their own.
    boost_deviations: float = 2.5
    boost_slope: float = 4.0  # dB of boost for each dB more
    # A group is boosted from this share of all loudness on, and fully with so much more.
    boost_share_from: float = 0.02
    boost_share_width: float = 0.05
    boost_natural: float = 0.5  # what all bands' loudness adds by itself, and so much, is deducted
    beat_hz: float = 50.0  # partials so far apart do not beat
    beat_width_hz: float = 25.0  # those closer by this do fully
    beat_least: float = 0.35  # least ratio by which beats are undone
    weakest_step: float = 0.2  # least step that is made up for, as a share of the tick's strength
    # What would be limited takes on the sensitivity of a seated body to this power at most.
    concentrated: float = 4.0
    nothing: float = 1e-9  # sone that count as none

    @classmethod
    def of(cls, parameters: TransformParameters, grid: LiveGrid) -> StrengthDesign:
        """Return the design for ticks of a grid."""
        steps = np.arange(1.01 * parameters.vibration_top_hz / SynthesisDesign.gain_step_hz)
        programme_min = PROGRAMME_TOP_DB - parameters.loudness_db
        tick_s = grid.tick_s
        return cls(
            programme_start=max(programme_min, PROGRAMME_START_DB),
            programme_min=programme_min,
            programme_step=PROGRAMME_DB_A_S * tick_s,
            programme_rise=tick_s / RISE_S,
            programme_fall=tick_s / FALL_S,
            start_ticks=float(round(START_S / tick_s)),
            start_weight=START_WEIGHT_S / tick_s,
            release=RELEASE_DB_A_S * tick_s,
            slow_followed=min(1.0, tick_s / SLOW_S),
            floor_min=parameters.loudness_floor_db,
            floor_rise=FLOOR_RISE_DB_A_S * tick_s,
            gate=parameters.loudness_gate_db,
            jitter=parameters.jitter_db,
            jitter_followed=min(1.0, tick_s / JITTER_S),
            attack_ticks=float(round(ATTACK_S / tick_s)),
            group_smooth=min(1.0, tick_s / GROUP_S),
            group_up=tick_s / GROUP_UP_S,
            group_down=tick_s / GROUP_DOWN_S,
            group_deviates=tick_s / GROUP_DEVIATES_S,
            boost_hold_ticks=float(round(BOOST_HOLD_S / tick_s)),
            boost_fall=BOOST_FALL_DB_A_S * tick_s,
            boost_max=parameters.rise_db,
            target=parameters.loudness_target_db,
            slope=parameters.dynamics,
            gain_max=math.pow(10.0, parameters.loudness_db / 20.0),
            felt_weights=felt_weight(parameters, SynthesisDesign.gain_step_hz * steps),
        )


def felt_weight(parameters: TransformParameters, vibration_hz: FloatArray) -> FloatArray:
    """Return how strongly a seated body feels a drive at frequencies in Hz.

    It is always 1 for strength "flat", and for "felt" the sensitivity to acceleration, 1 at 40 Hz.
    For "rig" it contains the acceleration for each volt of a resonant actuator, 1 far above its
    resonance, and the gain that damping adds.
    """
    if parameters.strength == "flat":
        return np.ones_like(vibration_hz)
    hz = np.maximum(vibration_hz, FELT_FROM_HZ)
    felt: FloatArray = FELT_AT_HZ / hz
    if parameters.strength == "rig" and parameters.resonance_hz > 0.0:
        ratio = parameters.resonance_hz / hz
        response = 1.0 / np.hypot(1.0 - ratio**2, ratio / parameters.resonance_q)
        gain = math.pow(10.0, parameters.resonance_gain_db / 20.0)
        felt *= np.maximum(gain * response, RIG_LEAST)
    return felt
