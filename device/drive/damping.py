"""Damping: a filter that reduces the vibration after the end of a signal (the residual).

The filter cancels the actuator's resonant pair of poles by zeros, and adds a well damped pair of
poles. Within the available voltage, `choose_damping` selects the filter with the least residual in
the worst case. The filter must lower the residual even if the true resonance f0 differs by 20 %.

Definitions, for a 50 ms burst of a sine at the identified f0 of the rig:

- residual: energy of the acceleration after the burst, divided by the energy within the burst.
- settling: time after the burst until the acceleration stays under 10 % of the burst's peak.
- peak volts: largest voltage at the actuator, for equal r.m.s. acceleration within the burst.
- detuning: relative error of f0, caused by the stiffness; all else is unchanged.
- mass: the true moving mass divided by the identified moving mass.
"""

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

DAMPED_Q = 0.35  # usual Q of the new pair of poles
BURST_S, SETTLED = 0.05, 0.1
CURRENT_DRIVE_OHM = 1e5  # the resistance of a coil, a few ohm, is negligible beside it

SAMPLERATE = 48_000
_DECAYS = 12.0  # time constants simulated after the burst; e^-24 of the energy remains
NEVER_WORSE = 0.2  # relative error of f0 up to which the filter must lower the residual
WANTED_Q = (DAMPED_Q, 0.4, 0.45, 0.55, 0.7, 0.85, 1.0, 1.4, 2.0, 3.0)
CAUTION = (1.0, 0.9, 0.8, 0.65, 0.5, 0.35, 0.25)
SHIFT = (1.0, 1.03)
_BETTER = 0.98  # upper limit of residual with damping / residual without: -0.09 dB


@dataclass(frozen=True)
class Resonance:
    """A pair of poles: its magnitude / (2 pi), in Hz, and its Q, at most 0.5 for real poles."""

    frequency_hz: float
    q: float

    def polynomial(self, samplerate: float) -> FloatArray:
        """Return (z - e^(pT)) (z - e^(qT)), highest power of z first; p, q: poles, T: 1 / rate."""
        w, damping = math.tau * self.frequency_hz, 1.0 / (2.0 * self.q)
        root = np.sqrt(complex(damping**2 - 1.0))
        pair = np.exp(np.array([-damping + root, -damping - root]) * w / samplerate)
        return np.array([1.0, -(pair[0] + pair[1]).real, (pair[0] * pair[1]).real])


def resonance_of(p: ActuatorParameters, source_impedance_ohm: float = 0.0) -> Resonance:
    """Return the pair of poles of the actuator's resonance at an amplifier's source impedance."""
    rate, _, _ = state_space(p, source_impedance_ohm)
    poles = np.linalg.eigvals(rate)
    # The coil's pole is real. The pair is complex, or real and slower than the coil's pole.
    pair = poles[np.lexsort((np.abs(poles), -np.abs(poles.imag)))][:2]
    magnitude = math.sqrt(abs(pair[0] * pair[1]))
    return Resonance(magnitude / math.tau, magnitude / -float((pair[0] + pair[1]).real))


def resonance_as_damped(p: ActuatorParameters, is_damped: bool) -> tuple[float, float, float]:
    """Return the resonance's frequency in Hz, its Q, and the gain in dB that makes up for damping.

    Frequency and Q are clipped to 1 to 400 Hz and 0.1 to 20. is_damped: whether a filter reduces
    the Q to `DAMPED_Q` and restores the level at the resonance.
    """
    ringing = resonance_of(p)
    hz, q = min(max(ringing.frequency_hz, 1.0), 400.0), min(max(ringing.q, 0.1), 20.0)
    if not is_damped or q <= DAMPED_Q:
        return hz, q, 0.0
    return hz, DAMPED_Q, 20.0 * math.log10(q / DAMPED_Q)


@dataclass(frozen=True)
class Damping:
    """One damping filter, and the amplifier for which it is designed; the default is no filter.

    source_impedance_ohm: of the amplifier. 0 is voltage drive, which damps the resonance; a large
    value is current drive. gain: factor on the signal. ringing, wanted: removed and new poles.
    """

    source_impedance_ohm: float = 0.0
    ringing: Resonance | None = None
    wanted: Resonance | None = None
    gain: float = 1.0

    def sections(self, samplerate: float) -> FloatArray:
        """Return the second-order sections, without the factor `gain`, (n, 6), n 0 or 1.

        The sections have gain 1 at 0 Hz. UsageError: a resonance is not below samplerate / 2.
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
        """Return a filtered signal, (frames,), with `gain`; the initial state is zero."""
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
    """Return a filter that replaces the actuator's resonance by a pair of poles with wanted_q.

    wanted_q: above 0; up to 0.5 the poles are real, without oscillation. caution: factor on the
    removed Q, up to 1. A lower value needs less voltage and tolerates a larger error of the
    resonance frequency, but damps less. shift: factor on the frequency of removed and new poles. A
    value above 1 helps if the true resonance frequency is above the identified one; else it harms.
    """
    ringing = resonance_of(p, source_impedance_ohm)
    frequency_hz = shift * ringing.frequency_hz
    removed = Resonance(frequency_hz, caution * ringing.q)
    return Damping(source_impedance_ohm, removed, Resonance(frequency_hz, wanted_q))


@dataclass(frozen=True)
class BurstResponse:
    """Acceleration and voltage of an actuator for one burst."""

    residual: float  # energy after the burst over the energy within the burst
    settling_s: float
    peak_v: float  # for 1 m/s² r.m.s. within the burst
    rms_m_s2: float  # within the burst, for a drive of 1 V (current source: about 1 A)

    def against(self, reference: "BurstResponse") -> "Residual":
        """Return this response relative to a reference response."""
        return Residual(
            residual_db=amplitude_to_db(math.sqrt(self.residual / reference.residual)),
            settling_s=self.settling_s,
            peak_volts_db=amplitude_to_db(self.peak_v / reference.peak_v),
        )


@dataclass(frozen=True)
class Residual:
    """Residual energy and peak volts relative to a reference, in dB, and the settling time."""

    residual_db: float
    settling_s: float
    peak_volts_db: float


def burst_response(
    p: ActuatorParameters, damping: Damping, *, detuning: float = 0.0, mass: float = 1.0
) -> BurstResponse:
    """Return the linear model's response to a burst. detuning, mass: see the top of this file."""
    true, source = vary(detune(p, detuning), mass), damping.source_impedance_ohm
    frames = round((BURST_S + max(decay_s(true, source), BURST_S)) * SAMPLERATE)
    burst = sine_burst(frames, BURST_S, p.resonance_hz)
    # With a current source, the factor gives about 1 A for 1 V of the burst.
    drive = damping.filtered(burst, SAMPLERATE) * (1.0 + source)
    actuator = LinearActuator(true, SAMPLERATE, source)
    motion = actuator.move(drive, ("acceleration_m_s2", "current_a"))
    return measured(motion.acceleration_m_s2, drive - source * motion.current_a)


def measured(acceleration_m_s2: FloatArray, volts: FloatArray) -> BurstResponse:
    """Return the response to a burst that starts at frame 0. Both arguments: (frames,)."""
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
    """Return the reference response, with current drive: only the actuator's friction damps."""
    return burst_response(p, Damping(CURRENT_DRIVE_OHM), detuning=detuning)


def decay_s(p: ActuatorParameters, source_impedance_ohm: float) -> float:
    """Return the time in s in which the energy decays to e^-24 of its value after a burst."""
    return _DECAYS * p.q_total(source_impedance_ohm) / (math.pi * p.resonance_hz)


def sine_burst(frames: int, burst_s: float, frequency_hz: float) -> FloatArray:
    """Return a sine of length burst_s from frame 0 on, followed by zeros, (frames,)."""
    burst = np.zeros(frames)
    phase = math.tau * frequency_hz / SAMPLERATE * np.arange(round(burst_s * SAMPLERATE))
    burst[: len(phase)] = np.sin(phase)
    return burst


@dataclass(frozen=True)
class Candidate:
    """A damping filter, and its residual relative to current drive without damping."""

    damping: Damping
    as_believed: Residual  # of the rig as identified
    worst_db: float  # largest residual at the identified f0, and at f0 ± uncertainty
    affordable: bool  # whether the peak volts for the identified rig are within the headroom
    makeup: float  # gain that makes a burst as strong as without damping


def choose_damping(
    p: ActuatorParameters,
    *,
    uncertainty: float = 0.1,
    headroom_db: float = 5.0,
    source_impedance_ohm: float = 0.0,
) -> list[Candidate]:
    """Return all candidate filters, the best one first. The function is slow.

    The best filter is within the headroom and never worse than no filter (see `NEVER_WORSE`). No
    such filter has a smaller `worst_db`. If no candidate is within the headroom, the best
    filter is the one that needs the least voltage, and its `affordable` is False.
    p: the actuator as identified. uncertainty: relative error of f0 in either direction, 0 to 0.5.
    headroom_db: largest allowed peak volts, relative to current drive without damping.
    source_impedance_ohm: source impedance of the amplifier.
    """
    references = {d: undamped(p, detuning=d) for d in (0.0, -uncertainty, uncertainty)}
    plain = burst_response(p, Damping(source_impedance_ohm))
    q = resonance_of(p, source_impedance_ohm).q
    dampings = [Damping(source_impedance_ohm)] + [
        inverse_damping(p, wanted_q, source_impedance_ohm, caution=caution, shift=shift)
        for wanted_q, caution, shift in itertools.product(WANTED_Q, CAUTION, SHIFT)
        if wanted_q < caution * q
    ]
    candidates = []
    for damping in dampings:
        believed = burst_response(p, damping)
        shown = believed.against(references[0.0])
        worst_db = max(
            burst_response(p, damping, detuning=d).against(other).residual_db
            for d, other in references.items()
        )
        affordable = shown.peak_volts_db <= headroom_db
        makeup = plain.rms_m_s2 / believed.rms_m_s2
        candidates.append(Candidate(damping, shown, worst_db, affordable, makeup))
    # affordable candidates by their worst case, then the others by voltage
    candidates.sort(key=lambda c: c.worst_db if c.affordable else c.as_believed.peak_volts_db)
    candidates.sort(key=lambda one: not one.affordable)
    if candidates[0].affordable:
        others = _other_rigs(p, source_impedance_ohm)
        chosen = next(one for one in candidates if _never_worse(p, one.damping, others))
        candidates.sort(key=lambda one: one is not chosen)
    return candidates


_Other = tuple[float, float, float]  # detuning, mass, and residual without damping


def _other_rigs(p: ActuatorParameters, source_impedance_ohm: float) -> list[_Other]:
    """Return rigs whose stiffness or mass differs, which shifts f0 by up to `NEVER_WORSE`."""
    shares = [sign * part * NEVER_WORSE for part in (1.0, 0.75, 0.5, 0.25) for sign in (1, -1)]
    rigs = [(share, 1.0) for share in shares]
    rigs += [(0.0, 1.0 / (1.0 + share) ** 2) for share in shares]
    rigs.append((0.0, 1.0))
    plain = Damping(source_impedance_ohm)
    responses = (burst_response(p, plain, detuning=share, mass=mass) for share, mass in rigs)
    return [(*rig, one.residual) for rig, one in zip(rigs, responses, strict=True)]


def _never_worse(p: ActuatorParameters, damping: Damping, others: list[_Other]) -> bool:
    return damping.ringing is None or all(
        burst_response(p, damping, detuning=detuning, mass=mass).residual <= _BETTER * without
        for detuning, mass, without in others
    )
