"""Exposure: the vibration dose of a seated person on one day, after ISO 2631-1 and 2002/44/EC.

    drive -> decimation -> actuator, or seat -> Wk -> r.m.s., A(8), VDV
             6 kHz         acceleration

The core (audioflinger_hook/core/drive/actuator.c) computes the exposure with the numbers of
`exposure_records`. The core also finds the gain that keeps a day's dose under a limit.

The result is an estimate, not a measurement on the seat: the acceleration is that of the linear
model. Above 80 Hz, where the standard ends, the weighting is extrapolated.
"""

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import scipy

from device.errors import UsageError
from device.rig import Rig
from device.rig.actuator import motion_filters
from device.rig.equations import seat_sections
from device.units import FloatArray, Records

HIGHEST_HZ = 80.0  # end of the standard's weighting; above it the same formula is extrapolated


def _second(frequency_hz: float, q: float) -> FloatArray:
    """Return the coefficients of 1 + s / (Q w) + s^2 / w^2, highest power of s first."""
    w = math.tau * frequency_hz
    return np.array([1.0 / w**2, 1.0 / (q * w), 1.0])


_BAND_Q = math.sqrt(0.5)
PARTS: tuple[tuple[FloatArray, FloatArray, float], ...] = (
    (_second(0.4, _BAND_Q) * [1.0, 0.0, 0.0], _second(0.4, _BAND_Q), 0.4),
    (np.array([0.0, 0.0, 1.0]), _second(100.0, _BAND_Q), 100.0),
    (_second(12.5, 1.0) * [0.0, 1.0, 1.0], _second(12.5, 0.63), 12.5),
    (_second(2.37, 0.91) * (2.37 / 3.35) ** 2, _second(3.35, 0.91), math.sqrt(2.37 * 3.35)),
)
"""Numerator, denominator (powers of s, highest first), and frequency of exact response in Hz."""


def wk_sections(samplerate: float) -> FloatArray:
    """Return the frequency weighting Wk as sections for `scipy.signal.sosfilt`, (4, 6).

    samplerate: Hz, 2000 or more. A single polynomial would lose the precision of the poles at
    0.4 Hz, which are close to z = 1.
    """
    sections = []
    for numerator, denominator, exact_hz in PARTS:
        # The bilinear transform is pre-warped, so that it is exact at exact_hz.
        rate = math.pi * exact_hz / math.tan(math.pi * exact_hz / samplerate)
        b, a = scipy.signal.bilinear(numerator, denominator, fs=rate)
        sections.append(np.concatenate([np.pad(b, (0, 3 - len(b))), a]))
    return np.array(sections)


ACTION_A8_M_S2, LIMIT_A8_M_S2 = 0.5, 1.15
ACTION_VDV, LIMIT_VDV = 9.1, 21.0
"""Directive 2002/44/EC, article 3: A(8) in m/s² over eight hours, VDV in m/s^1.75."""
DAY_S = 8 * 3600.0
RUNNING_S = 1.0  # time constant of the running r.m.s. (ISO 2631-1, equation 3)

CAPS: dict[str, tuple[float, float] | None] = {
    "off": None,
    "action": (ACTION_A8_M_S2, ACTION_VDV),
    "limit": (LIMIT_A8_M_S2, LIMIT_VDV),
}
"""A(8) and VDV of each cap. A cap begins to act at half of its dose: 71 % of its A(8)."""


@dataclass(frozen=True)
class Exposure:
    """Values of the weighted acceleration, each from the channel with the largest value.

    time_s: duration. running_m_s2, rms_m_s2: r.m.s. of about the last second, and of the whole
    time. a8_m_s2: A(8), the same energy spread over eight hours. vdv: vibration dose value in
    m/s^1.75. extrapolated: share of energy above 80 Hz in the channel with the largest A(8).
    """

    time_s: float
    running_m_s2: float
    rms_m_s2: float
    a8_m_s2: float
    vdv: float
    extrapolated: float

    @classmethod
    def of(cls, sums: Sequence["DoseSums"], running_m_s2: float = 0.0) -> "Exposure":
        """Return the values for all channels. running_m_s2: largest of all channels."""
        worst = max(sums, key=lambda one: one.squares)
        return cls(
            time_s=worst.time_s,
            running_m_s2=running_m_s2,
            rms_m_s2=math.sqrt(worst.squares / worst.time_s) if worst.time_s else 0.0,
            a8_m_s2=math.sqrt(worst.squares / DAY_S),
            # after a single shock, another channel may have the largest VDV
            vdv=max(one.fourths for one in sums) ** 0.25,
            extrapolated=min(1.0, worst.high / worst.squares) if worst.squares else 0.0,
        )

    @property
    def above_action(self) -> bool:
        """Whether an action value of 2002/44/EC is reached: A(8) 0.5 m/s², or VDV 9.1 m/s^1.75."""
        return self.a8_m_s2 >= ACTION_A8_M_S2 or self.vdv >= ACTION_VDV

    @property
    def above_limit(self) -> bool:
        """Whether a limit value of 2002/44/EC is reached: A(8) 1.15 m/s², or VDV 21 m/s^1.75."""
        return self.a8_m_s2 >= LIMIT_A8_M_S2 or self.vdv >= LIMIT_VDV

    def __str__(self) -> str:
        return (
            f"A(8) {self.a8_m_s2:.3g} m/s² (action {ACTION_A8_M_S2:g}, limit {LIMIT_A8_M_S2:g}), "
            f"VDV {self.vdv:.3g} m/s^1.75 (action {ACTION_VDV:g}, limit {LIMIT_VDV:g}); "
            f"{100.0 * self.extrapolated:.0f} % of it above {HIGHEST_HZ:g} Hz, extrapolated"
        )


@dataclass(frozen=True)
class DoseSums:
    """Duration of one day's exposure, and time integrals of powers of its weighted acceleration."""

    time_s: float = 0.0
    squares: float = 0.0  # m²/s³
    fourths: float = 0.0  # m⁴/s⁷
    high: float = 0.0  # part of the squares above 80 Hz

    def plus(self, other: "DoseSums", times: float = 1.0) -> "DoseSums":
        """Return the sum of this dose and a multiple of another."""
        pairs = zip(astuple(self), astuple(other), strict=True)
        return DoseSums(*(mine + times * theirs for mine, theirs in pairs))

    def at_least(self, other: "DoseSums") -> "DoseSums":
        """Return the larger of both values for each field."""
        return DoseSums(*map(max, astuple(self), astuple(other)))


_LOWEST_HZ = 6_000  # least rate of the actuator model and Wk: interpolation loses 0.06 % at 80 Hz
_READING_S = 0.01  # time between two updates of the cap's gain
_ON_ITS_WAY = 1e-5  # share of a cap that is reserved for the dose until the next update
_RINGS_S = 5.0  # computed length of an impulse response
_LENGTHS = 6
_KAISER_BETA = 8.0  # 80 dB of attenuation at frequencies that alias into the vibration


def exposure_records(rig: Rig, samplerate: int, cap: str = "off") -> Records:
    """Return numbers and tables of the exposure meter, named as in `ExposureDesign` of the core.

    If the rig does not describe its seat, the seat is assumed to move like the moving mass.
    samplerate: Hz, 6000 or more. cap: one of `CAPS`. UsageError: the rate is too low.
    """
    if samplerate < _LOWEST_HZ:
        raise UsageError(f"samplerate={samplerate} Hz is too low; choose {_LOWEST_HZ} Hz or more")
    factor = samplerate // _LOWEST_HZ
    rate = samplerate / factor
    decimation = decimation_taps(factor)
    motion, motion_fir = _motion(rig, rate)
    weighting = wk_sections(rate)
    above = scipy.signal.butter(4, HIGHEST_HZ, "highpass", fs=rate, output="sos")
    a8_m_s2, vdv = ((1.0 - _ON_ITS_WAY) * limit for limit in CAPS[cap] or (0.0, 0.0))
    return {
        "factor": factor,
        "decimation_taps": len(decimation),
        "motion_taps": len(motion_fir),
        "motion.count": len(motion),
        "weighting.count": len(weighting),
        "above.count": len(above),
        "reading_frames": factor * round(_READING_S * rate),
        # symmetric, so the order of the taps does not matter
        "decimation": decimation,
        "motion.sections": motion,
        "motion_fir": motion_fir,
        "weighting.sections": weighting,
        "above.sections": np.asarray(above),
        "volts_per_full_scale": rig.dac.full_scale_v * rig.amplifier.gain,
        "period_s": 1.0 / rate,
        "running_share": -math.expm1(-1.0 / rate / RUNNING_S),
        "cap_a8_m_s2": a8_m_s2,
        "cap_vdv": vdv,
    }


def worst_second(rig: Rig, samplerate: int) -> DoseSums:
    """Return an upper bound on the dose of one second of any signal within full scale.

    The mean square of the weighted acceleration is at most the squared maximum of the magnitude
    response. The peak is at most the sum of the impulse response's magnitudes. The mean fourth
    power is at most the mean square times the squared peak. `high` is unknown and set to 0.
    """
    rate = samplerate / (samplerate // _LOWEST_HZ)
    motion, motion_fir = _motion(rig, rate)
    impulse = np.zeros(round(_RINGS_S * rate))
    impulse[0] = rig.dac.full_scale_v * rig.amplifier.gain
    response = scipy.signal.sosfilt(motion, impulse)
    if len(motion_fir):
        response = np.convolve(response, motion_fir)[: len(response)]
    response = scipy.signal.sosfilt(wk_sections(rate), response)
    largest = float(np.abs(np.fft.rfft(response)).max())
    return DoseSums(1.0, largest**2, (largest * float(np.abs(response).sum())) ** 2)


def decimation_taps(factor: int) -> FloatArray:
    """Return a decimation low-pass, (taps,), with -80 dB for aliases below 1/20 of the new rate."""
    if factor == 1:
        return np.ones(1)
    # The corner is half the new rate. Only low frequencies matter, so the transition may be wide.
    window = "kaiser", _KAISER_BETA
    return np.asarray(scipy.signal.firwin(_LENGTHS * factor + 1, 1.0 / factor, window=window))


def _motion(rig: Rig, rate: float) -> tuple[FloatArray, FloatArray]:
    """Return sections and FIR taps from volts to m/s² of the seat, or else of the moving mass."""
    source = rig.amplifier.source_impedance_ohm
    if rig.seat:
        return seat_sections(rig.actuator, rig.seat, rate, source), np.empty(0)
    sections, taps = motion_filters(rig.actuator, rate, source)
    return sections, taps["acceleration_m_s2"]
