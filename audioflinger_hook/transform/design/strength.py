"""Constants of loudness control, by which the vibration's strength follows the sound's loudness.

The programme level is a slow average of the peak loudness. The strength depends on the difference
between the loudness and the programme level.
"""

import math
from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.synthesis import LiveGrid, SynthesisDesign
from audioflinger_hook.transform.parameters import TransformParameters

FELT_AT_HZ = 40.0
"""Vibration of this frequency has weight 1. Above 12.5 Hz, the sensitivity of a seated body to
vertical acceleration is proportional to 1/f. Sources: W_k of ISO 2631-1, up to 100 Hz; Griffin,
Whitham and Parsons, Ergonomics 25, 1982."""

FELT_FROM_HZ = 30.0  # lower vibration has the weight of this frequency
FIT_BOOST_DB = 12.0  # largest gain of strength "fit" relative to 70 Hz
RIG_LEAST = 1.0 / 16.0  # smallest product of the gains of damping and of the actuator

PROGRAMME_TOP_DB = -10.0  # highest programme level; the lowest is lower by `loudness_db`
PROGRAMME_START_DB = -20.0  # programme level before any sound, but at least `programme_min`
START_S, START_WEIGHT_S = 2.0, 0.5
"""Duration of the programme level's fast adaptation, and weight of the initial level, both in s."""

RELEASE_DB_A_S = 10.0  # decay rate of the peak loudness, the input of the programme level

PROGRAMME_DB_A_S, RISE_S, FALL_S = 0.1, 240.0, 120.0
"""Adaptation of the programme level: constant rate, and time constants of rise and fall. The
constant rate makes the level approach the median. Slow adaptation preserves a crescendo."""

FLOOR_RISE_DB_A_S = 2.0  # rate of rise of the noise floor, the recent minimum of the loudness
JITTER_S, SLOW_S = 0.1, 0.03  # time constants for small changes of loudness, and for peak loudness

ATTACK_S = 0.012
"""Time after a jump in which small changes of loudness are not averaged. Within this time the new
sound fills the windows. With averaging, the strength would be up to `jitter` too low for 0.1 s."""

GROUP_S, GROUP_UP_S, GROUP_DOWN_S, GROUP_DEVIATES_S = 0.006, 0.2, 0.4, 1.0
"""Time constants of a group's level, of a rise and a fall of its mean level, and of its deviation.
The deviation is the mean absolute difference between level and mean level."""

GROUP_SONE = 0.02  # added to the loudness of a group, to reduce level changes of faint sound
BOOST_HOLD_S, BOOST_FALL_DB_A_S = 0.03, 80.0  # hold time and decay rate of a boost


@dataclass(frozen=True, eq=False)
class StrengthDesign:
    """Constants of loudness control. Rates are in dB per tick, times in ticks.

    Levels are in dB relative to a full-scale tone. The level of a group of bands is 10 log2 of its
    loudness in sone. A weight is the factor on a new value in an exponential average. A boost is an
    extra gain, in dB, while a group of bands becomes louder.
    """

    programme_start: float
    programme_min: float
    programme_step: float  # constant rate of the programme level
    programme_rise: float  # weight during a rise of the programme level
    programme_fall: float  # weight during a fall of the programme level
    start_ticks: float
    start_weight: float  # weight of the initial programme level, in ticks
    release: float
    slow_followed: float  # weight in the average of the loudness for the programme level
    floor_min: float  # lowest loudness with vibration
    floor_rise: float
    gate: float  # width of the soft gate above the noise floor
    jitter: float  # smaller changes of loudness are averaged
    jitter_followed: float  # weight of small changes
    attack_ticks: float
    group_smooth: float  # weight in the level of a group of bands
    group_up: float  # weight in the mean level of a group during a rise
    group_down: float  # weight in the mean level of a group during a fall
    group_deviates: float  # weight in the mean deviation of a group
    boost_hold_ticks: float
    boost_fall: float
    boost_max: float
    target: float  # level of the vibration if the loudness equals the programme level
    slope: float  # change of the vibration in dB per dB of loudness
    gain_max: float  # largest factor on amplitudes
    felt_weights: FloatArray  # sensitivity by vibration frequency, in steps of `gain_step_hz`
    programme_top: float = PROGRAMME_TOP_DB
    # The fast adaptation at the start lowers the programme level only to this many dB above the
    # peak loudness, so that a soft start stays soft.
    start_near: float = 10.0
    far: float = 20.0  # larger differences of peak loudness and programme level count as this
    floor_under: float = 35.0  # the gate's noise floor is at least this below the programme level
    gate_margin: float = 0.01  # the gate is closed up to this share of its width above the floor
    jump: float = 10.0  # a larger rise in one tick is a jump
    group_sone: float = GROUP_SONE
    silence_db: float = 10.0 * math.log2(GROUP_SONE)  # level of a group of bands in silence
    deviation_start: float = 3.0
    deviation_max: float = 10.0  # largest deviation of one tick
    # Smallest rise that causes a boost, in mean deviations. Noise, vibrato and beats have large
    # deviations, and therefore cause no boost.
    boost_deviations: float = 2.5
    boost_slope: float = 4.0  # dB of boost per dB of rise above `boost_deviations`
    boost_share_from: float = 0.02  # smallest share of the total loudness for a boost
    boost_share_width: float = 0.05  # for the full boost the share must be larger by this
    boost_natural: float = 0.5  # dB subtracted from a boost, besides the rise by total loudness
    beat_hz: float = 50.0  # largest distance of partials whose beats are compensated
    beat_width_hz: float = 25.0  # beats below beat_hz - beat_width_hz are fully compensated
    beat_least: float = 0.35  # beats are compensated down to this share of the steady amplitude
    weakest_step: float = 0.2  # least amplitude of a step, as a share of the largest in its tick
    concentrated: float = 4.0  # largest exponent of the weights of amplitudes above `ceiling`
    nothing: float = 1e-9  # sone; avoids a division by 0

    @classmethod
    def of(cls, parameters: TransformParameters, grid: LiveGrid) -> "StrengthDesign":
        """Return the design for a time grid."""
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
    """Return the sensitivity of a seated body to vibration at frequencies in Hz.

    With strength "flat", the sensitivity is 1. With "felt", it is the sensitivity to acceleration,
    relative to that at 40 Hz. With "rig" and a resonance_hz above 0, it is also multiplied by the
    gain of damping and the actuator's relative acceleration per volt, 1 far above resonance. With
    "fit", it is the curve `fit`, but at least -FIT_BOOST_DB.
    """
    if parameters.strength == "flat":
        return np.ones_like(vibration_hz)
    if parameters.strength == "fit":
        level_db = np.maximum(interpolated_db(parameters.fit, vibration_hz), -FIT_BOOST_DB)
        return np.asarray(10.0 ** (level_db / 20.0))
    hz = np.maximum(vibration_hz, FELT_FROM_HZ)
    felt: FloatArray = FELT_AT_HZ / hz
    if parameters.strength == "rig" and parameters.resonance_hz > 0.0:
        ratio = parameters.resonance_hz / hz
        response = 1.0 / np.hypot(1.0 - ratio**2, ratio / parameters.resonance_q)
        gain = math.pow(10.0, parameters.resonance_gain_db / 20.0)
        felt *= np.maximum(gain * response, RIG_LEAST)
    return felt


def interpolated_db(curve: str, vibration_hz: FloatArray) -> FloatArray:
    """Return a curve HZ:DB,... in dB at frequencies in Hz, interpolated over their logarithm."""
    points = sorted(tuple(map(float, point.split(":"))) for point in curve.split(","))
    hz, level_db = np.array(points).T
    return np.asarray(np.interp(np.log2(np.maximum(vibration_hz, hz[0])), np.log2(hz), level_db))
