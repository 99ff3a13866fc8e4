"""Damping: less residual vibration, so that the seat stops when the signal stops.

The filter cancels the poles of the actuator by zeros and adds a well damped pair of poles; its
numbers do not depend on the sample rate. It is chosen for the least residual in the worst case,
within available volts. No choice rings more than no damping would, at any f0 within `NEVER_WORSE`
of the believed one.

Definitions, for a 50 ms burst of a sine at the f0 of the rig as identified:

- residual: energy of the acceleration after the burst's end over that within it.
- settling: time after the end until the acceleration stays under 10 % of the burst's peak.
- peak volts: at the actuator's terminals, for the same r.m.s. acceleration within the burst.
- detuning: the true stiffness gives another f0; mass and friction are as believed. Filter and
  burst do not change.
- mass: the true moving mass over the believed one.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
import scipy

from device.errors import UsageError
from device.rig import ActuatorParameters
from device.rig.actuator import LinearActuator, state_space
from device.rig.parameters import detune, vary
from device.units import FloatArray, amplitude_to_db

DAMPED_Q = 0.35  # Q of the poles that replace those of the actuator, unless a rig needs a higher

BURST_S = 0.05
SETTLED = 0.1
CURRENT_DRIVE_OHM = 1e5  # beside which the actuator's 3.3 ohm are negligible (3e-5)

SAMPLERATE = 48_000
_DECAYS = 12.0  # time constants of the slowest mode after the burst: e^-24 of its energy remains

HEADROOM_DB = 5.0
UNCERTAINTY = 0.1  # share by which f0 may differ either way: sitters alone shift it by about 10 %
NEVER_WORSE = 0.2  # share by which f0 may differ before damping may be worse than none
WANTED_Q = (DAMPED_Q, 0.4, 0.45, 0.55, 0.7, 0.85, 1.0, 1.4, 2.0, 3.0)
CAUTION = (1.0, 0.9, 0.8, 0.65, 0.5, 0.35, 0.25)
SHIFT = (1.0, 1.03)

_BETTER = 0.98  # residual over that of no damping, at most: 0.09 dB for rigs between those checked


@dataclass(frozen=True)
class Resonance:
    """A pair of poles: its magnitude over 2 pi in Hz, and its Q, at most 0.5 for real poles."""

    frequency_hz: float
    q: float

    def polynomial(self, samplerate: float) -> FloatArray:
        """Return (z - e^(pT)) (z - e^(p'T)) for the poles p and p', highest power first, (3,).

        The discrete model of the actuator has the same poles, so they cancel exactly at any rate.
        """
        w, damping = math.tau * self.frequency_hz, 1.0 / (2.0 * self.q)
        root = np.sqrt(complex(damping**2 - 1.0))
        pair = np.exp(np.array([-damping + root, -damping - root]) * w / samplerate)
        return np.array([1.0, -(pair[0] + pair[1]).real, (pair[0] * pair[1]).real])


def resonance_of(p: ActuatorParameters, source_impedance_ohm: float = 0.0) -> Resonance:
    """Return the pair of poles with which the actuator rings at this source impedance."""
    rate, _, _ = state_space(p, source_impedance_ohm)
    poles = np.linalg.eigvals(rate)
    # The coil's pole is real. The pair is complex, or the two slowest poles.
    pair = poles[np.lexsort((np.abs(poles), -np.abs(poles.imag)))][:2]
    magnitude = math.sqrt(abs(pair[0] * pair[1]))
    return Resonance(magnitude / math.tau, magnitude / -float((pair[0] + pair[1]).real))


def resonance_as_damped(p: ActuatorParameters, is_damped: bool) -> tuple[float, float, float]:
    """Return the resonance that a drive meets: 1 to 400 Hz, Q 0.1 to 20, gain before it in dB.

    is_damped: to `DAMPED_Q`, with a gain that makes up for the loss at the resonance.
    """
    ringing = resonance_of(p)
    hz, q = min(max(ringing.frequency_hz, 1.0), 400.0), min(max(ringing.q, 0.1), 20.0)
    if not is_damped or q <= DAMPED_Q:
        return hz, q, 0.0
    return hz, DAMPED_Q, 20.0 * math.log10(q / DAMPED_Q)


@dataclass(frozen=True)
class Damping:
    """One damping filter, and the amplifier that it is meant for; by default there is no filter.

    source_impedance_ohm: of the amplifier; 0 (voltage drive) damps (Qts), large: current drive
        (Qms).
    ringing, wanted: the resonance that the filter removes, and the one that replaces it.
    gain: additional factor.
    """

    source_impedance_ohm: float = 0.0
    ringing: Resonance | None = None
    wanted: Resonance | None = None
    gain: float = 1.0

    def sections(self, samplerate: float) -> FloatArray:
        """Return the second-order sections without the gain, (n, 6), n 0 or 1.

        Their gain is 1 at 0 Hz, and at most 1 if the wanted Q is lower at the same frequency.
        UsageError: a resonance is not below half the sample rate.
        """
        if self.ringing is None or self.wanted is None:
            return np.empty((0, 6))
        highest_hz = max(self.ringing.frequency_hz, self.wanted.frequency_hz)
        if not samplerate > 2.0 * highest_hz:
            raise UsageError(
                f"samplerate={samplerate!r} Hz is too low for a resonance at {highest_hz:.1f} Hz; "
                f"choose more than {2.0 * highest_hz:.0f} Hz"
            )
        zeros, poles = self.ringing.polynomial(samplerate), self.wanted.polynomial(samplerate)
        return np.array([[*(zeros * (poles.sum() / zeros.sum())), *poles]])

    def filtered(self, signal: FloatArray, samplerate: float) -> FloatArray:
        """Return a whole signal, (frames,), damped from rest."""
        sections = self.sections(samplerate)
        scaled = self.gain * signal
        return np.asarray(scipy.signal.sosfilt(sections, scaled)) if len(sections) else scaled


def inverse_damping(
    p: ActuatorParameters,
    wanted_q: float,
    source_impedance_ohm: float = 0.0,
    *,
    caution: float = 1.0,
    shift: float = 1.0,
) -> Damping:
    """Return the resonance inverse with a chosen Q at the actuator's ringing frequency.

    wanted_q: above 0; up to 0.5 the actuator does not swing. caution: factor on the removed Q, up
    to 1; a lower one needs fewer volts and tolerates another resonance better, but damps less.
    shift: factor on the frequency; above 1 it tolerates a higher resonance better, a lower worse.
    """
    ringing = resonance_of(p, source_impedance_ohm)
    frequency_hz = shift * ringing.frequency_hz
    removed = Resonance(frequency_hz, caution * ringing.q)
    return Damping(source_impedance_ohm, removed, Resonance(frequency_hz, wanted_q))


@dataclass(frozen=True)
class BurstResponse:
    """The response to one burst."""

    residual: float  # energy after the burst, as a share of that within it
    settling_s: float
    peak_v: float  # for 1 m/s² r.m.s. within the burst
    rms_m_s2: float  # in the burst, for a drive of 1 V (current source: about 1 A)

    def against(self, reference: BurstResponse) -> Residual:
        """Return the difference from another response in dB."""
        return Residual(
            residual_db=amplitude_to_db(math.sqrt(self.residual / reference.residual)),
            settling_s=self.settling_s,
            peak_volts_db=amplitude_to_db(self.peak_v / reference.peak_v),
        )


@dataclass(frozen=True)
class Residual:
    """A burst against a reference: residual energy and peak volts in dB, and the settling time."""

    residual_db: float
    settling_s: float
    peak_volts_db: float


def burst_response(
    p: ActuatorParameters, damping: Damping, *, detuning: float = 0.0, mass: float = 1.0
) -> BurstResponse:
    """Return the response of the linear model; p: the believed actuator; detuning: a share."""
    true, source = vary(detune(p, detuning), mass), damping.source_impedance_ohm
    frames = round((BURST_S + max(decay_s(true, source), BURST_S)) * SAMPLERATE)
    burst = sine_burst(frames, BURST_S, p.resonance_hz)
    # Scaled so that a current source gives about the same volts.
    drive = damping.filtered(burst, SAMPLERATE) * (1.0 + source)
    actuator = LinearActuator(true, SAMPLERATE, source)
    motion = actuator.move(drive, ("acceleration_m_s2", "current_a"))
    return measured(motion.acceleration_m_s2, drive - source * motion.current_a)


def measured(acceleration_m_s2: FloatArray, volts: FloatArray) -> BurstResponse:
    """Return the response to a burst from 0 on. Acceleration, terminal volts: (frames,)."""
    end = round(BURST_S * SAMPLERATE)
    within, after = acceleration_m_s2[:end], acceleration_m_s2[end:]
    rms_m_s2 = math.sqrt(np.sum(within**2) / (BURST_S * SAMPLERATE))
    loud = np.flatnonzero(np.abs(after) > SETTLED * np.abs(within).max())
    return BurstResponse(
        residual=float(np.sum(after**2) / np.sum(within**2)),
        settling_s=float((loud[-1] + 1) / SAMPLERATE) if loud.size else 0.0,
        peak_v=float(np.abs(volts).max()) / rms_m_s2,
        rms_m_s2=rms_m_s2,
    )


def undamped(p: ActuatorParameters, *, detuning: float = 0.0) -> BurstResponse:
    """Return the reference: current drive, so that only the actuator's friction damps."""
    return burst_response(p, Damping(CURRENT_DRIVE_OHM), detuning=detuning)


def decay_s(p: ActuatorParameters, source_impedance_ohm: float) -> float:
    """Return the time after a burst in which the energy falls to e^-24."""
    return _DECAYS * p.q_total(source_impedance_ohm) / (math.pi * p.resonance_hz)


def sine_burst(frames: int, burst_s: float, frequency_hz: float) -> FloatArray:
    """Return a sine from 0, then silence, (frames,)."""
    burst = np.zeros(frames)
    phase = math.tau * frequency_hz / SAMPLERATE * np.arange(round(burst_s * SAMPLERATE))
    burst[: len(phase)] = np.sin(phase)
    return burst


@dataclass(frozen=True)
class Candidate:
    """A damping and its residual, compared with undamped current drive."""

    damping: Damping
    as_believed: Residual  # of the rig as identified
    worst_db: float  # largest residual of all possible rigs
    affordable: bool  # the peak volts for the identified rig are within the headroom
    makeup: float  # factor on the drive that makes a burst as strong as one without damping


def choose_damping(
    p: ActuatorParameters,
    *,
    uncertainty: float = UNCERTAINTY,
    headroom_db: float = HEADROOM_DB,
    source_impedance_ohm: float = 0.0,
) -> list[Candidate]:
    """Return all candidates; the first is the best that is never worse than no damping.

    Best is the least residual in the worst case. Takes about a second. If no candidate is within
    the headroom, the first needs the fewest volts of all, and its `affordable` is False.

    p: the actuator as identified. uncertainty: share by which f0 may differ in either direction, 0
    to 0.5. headroom_db: available peak volts above those of undamped current drive for equal
    vibration. source_impedance_ohm: of the amplifier.
    """
    references = {d: undamped(p, detuning=d) for d in (0.0, -uncertainty, uncertainty)}
    plain = burst_response(p, Damping(source_impedance_ohm))
    candidates = []
    for damping in _dampings(p, source_impedance_ohm):
        believed = burst_response(p, damping)
        shown = believed.against(references[0.0])
        worst_db = max(
            burst_response(p, damping, detuning=d).against(other).residual_db
            for d, other in references.items()
        )
        affordable = shown.peak_volts_db <= headroom_db
        makeup = plain.rms_m_s2 / believed.rms_m_s2
        candidates.append(Candidate(damping, shown, worst_db, affordable, makeup))
    # Affordable candidates by their worst case, then the others by volts.
    within = sorted((one for one in candidates if one.affordable), key=lambda one: one.worst_db)
    beyond = [one for one in candidates if not one.affordable]
    candidates = [*within, *sorted(beyond, key=lambda one: one.as_believed.peak_volts_db)]
    if within:
        others = _other_rigs(p, source_impedance_ohm)
        chosen = next(one for one in candidates if _never_worse(p, one.damping, others))
        candidates.remove(chosen)
        candidates.insert(0, chosen)
    return candidates


_Other = tuple[float, float, float]  # detuning, mass, and residual without damping


def _other_rigs(p: ActuatorParameters, source_impedance_ohm: float) -> list[_Other]:
    """Return rigs with f0 up to `NEVER_WORSE` off by stiffness or by mass, the furthest first."""
    shares = [sign * part * NEVER_WORSE for part in (1.0, 0.75, 0.5, 0.25) for sign in (1, -1)]
    rigs = [(share, 1.0) for share in shares]
    rigs += [(0.0, 1.0 / (1.0 + share) ** 2) for share in shares]
    rigs.append((0.0, 1.0))
    plain = Damping(source_impedance_ohm)
    return [
        (share, mass, burst_response(p, plain, detuning=share, mass=mass).residual)
        for share, mass in rigs
    ]


def _never_worse(p: ActuatorParameters, damping: Damping, others: list[_Other]) -> bool:
    return damping.ringing is None or all(
        burst_response(p, damping, detuning=detuning, mass=mass).residual <= _BETTER * without
        for detuning, mass, without in others
    )


def _dampings(p: ActuatorParameters, source_impedance_ohm: float) -> list[Damping]:
    q = resonance_of(p, source_impedance_ohm).q
    return [Damping(source_impedance_ohm)] + [
        inverse_damping(p, wanted_q, source_impedance_ohm, caution=caution, shift=shift)
        for wanted_q, caution, shift in itertools.product(WANTED_Q, CAUTION, SHIFT)
        if wanted_q < caution * q
    ]
