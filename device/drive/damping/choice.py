"""The automatic choice of damping: least residual in the worst case, within available volts.

No choice rings more than no damping would, at any f0 within `NEVER_WORSE` of the believed one.
"""

import itertools
from dataclasses import dataclass

from device.drive.damping.design import (
    DAMPED_Q,
    Damping,
    inverse_damping,
    no_damping,
    resonance_of,
)
from device.drive.damping.residual import Residual, burst_response, undamped
from device.rig import ActuatorParameters

HEADROOM_DB = 5.0
UNCERTAINTY = 0.1
"""Share by which f0 may differ in either direction: sitters alone shift it by about 10 %."""
NEVER_WORSE = 0.2
"""Share by which f0 may differ before damping may be worse than none."""
WANTED_Q = (DAMPED_Q, 0.4, 0.45, 0.55, 0.7, 0.85, 1.0, 1.4, 2.0, 3.0)
CAUTION = (1.0, 0.9, 0.8, 0.65, 0.5, 0.35, 0.25)
SHIFT = (1.0, 1.03)

_BETTER = 0.98
"""Residual against that of no damping, at most: 0.09 dB for what lies between the checked rigs."""


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
    detunings = sorted({0.0, -uncertainty, uncertainty})
    references = [undamped(p, detuning=d) for d in detunings]
    reference = undamped(p)
    plain = burst_response(p, no_damping(source_impedance_ohm))
    candidates = []
    for damping in _dampings(p, source_impedance_ohm):
        believed = burst_response(p, damping)
        shown = believed.against(reference)
        worst_db = max(
            burst_response(p, damping, detuning=d).against(other).residual_db
            for d, other in zip(detunings, references, strict=True)
        )
        affordable = shown.peak_volts_db <= headroom_db
        makeup = plain.rms_m_s2 / believed.rms_m_s2
        candidates.append(Candidate(damping, shown, worst_db, affordable, makeup))
    candidates.sort(key=_rank)
    if candidates[0].affordable:
        others = _other_rigs(p, source_impedance_ohm)
        chosen = next(one for one in candidates if _never_worse(p, one.damping, others))
        candidates.remove(chosen)
        candidates.insert(0, chosen)
    return candidates


_Other = tuple[float, float, float]
"""Detuning and mass of a rig that may be meant, and its residual without damping."""


def _other_rigs(p: ActuatorParameters, source_impedance_ohm: float) -> list[_Other]:
    """Return rigs with f0 up to `NEVER_WORSE` off by stiffness or by mass, the furthest first."""
    shares = [sign * part * NEVER_WORSE for part in (1.0, 0.75, 0.5, 0.25) for sign in (1, -1)]
    rigs = [(share, 1.0) for share in shares]
    rigs += [(0.0, 1.0 / (1.0 + share) ** 2) for share in shares]
    rigs.append((0.0, 1.0))
    plain = no_damping(source_impedance_ohm)
    return [
        (detuning, mass, burst_response(p, plain, detuning=detuning, mass=mass).residual)
        for detuning, mass in rigs
    ]


def _never_worse(p: ActuatorParameters, damping: Damping, others: list[_Other]) -> bool:
    """Return whether damping leaves less than none, or is none, on all these rigs."""
    return damping.ringing is None or all(
        burst_response(p, damping, detuning=detuning, mass=mass).residual <= _BETTER * without
        for detuning, mass, without in others
    )


def _rank(candidate: Candidate) -> tuple[bool, float]:
    """Sort key: affordable candidates by worst case, then the others by volts."""
    if candidate.affordable:
        return False, candidate.worst_db
    return True, candidate.as_believed.peak_volts_db


def _dampings(p: ActuatorParameters, source_impedance_ohm: float) -> list[Damping]:
    """Return all candidates at this source impedance."""
    q = resonance_of(p, source_impedance_ohm).q
    return [
        no_damping(source_impedance_ohm),
        *(
            inverse_damping(p, wanted_q, source_impedance_ohm, caution=caution, shift=shift)
            for wanted_q, caution, shift in itertools.product(WANTED_Q, CAUTION, SHIFT)
            if wanted_q < caution * q
        ),
    ]
