"""The automatic choice of damping: least residual in the worst case, within available volts."""

from dataclasses import dataclass

from device.drive.damping.design import Damping, inverse_damping, no_damping, resonance_of
from device.drive.damping.residual import Residual, burst_response, undamped
from device.rig import ActuatorParameters

HEADROOM_DB = 5.0
UNCERTAINTY = 0.1
"""Share by which f0 may differ in either direction: sitters alone shift it by about 10 %."""
WANTED_Q = (0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.85, 1.0, 1.4, 2.0, 3.0)
CAUTION = (1.0, 0.9, 0.8, 0.65, 0.5)


@dataclass(frozen=True)
class Candidate:
    """A damping and its residual, compared with undamped current drive.

    as_believed: residual of the rig as identified.
    worst_db: largest residual of all possible rigs.
    affordable: whether the peak volts for the identified rig are within the headroom.
    makeup: factor on the drive that makes a burst as strong as one without damping.
    """

    damping: Damping
    as_believed: Residual
    worst_db: float
    affordable: bool
    makeup: float


def choose_damping(
    p: ActuatorParameters,
    *,
    uncertainty: float = UNCERTAINTY,
    headroom_db: float = HEADROOM_DB,
    source_impedance_ohm: float = 0.0,
) -> list[Candidate]:
    """Return all candidates; the first has the least residual in the worst case.

    Takes some tenths of a second. If no candidate is within the headroom, the first candidate needs
    the fewest volts, and its `affordable` is False.

    Parameters
    ----------
    p : ActuatorParameters
        The actuator as identified.
    uncertainty : float
        Share by which f0 may differ in either direction, 0 to 0.5.
    headroom_db : float
        Available peak volts above those of undamped current drive for equal vibration.
    source_impedance_ohm : float
        Source impedance of the amplifier.
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
        candidates.append(
            Candidate(
                damping,
                shown,
                worst_db,
                affordable=shown.peak_volts_db <= headroom_db,
                makeup=plain.rms_m_s2 / believed.rms_m_s2,
            )
        )
    return sorted(candidates, key=_rank)


def _rank(candidate: Candidate) -> tuple[bool, float]:
    """Sort key: affordable candidates by worst case, then the others by volts."""
    if candidate.affordable:
        return False, candidate.worst_db
    return True, candidate.as_believed.peak_volts_db


def _dampings(p: ActuatorParameters, source_impedance_ohm: float) -> list[Damping]:
    """Return all candidates at this source impedance."""
    ringing = resonance_of(p, source_impedance_ohm)
    inverses = [
        inverse_damping(p, wanted_q, source_impedance_ohm, caution=caution)
        for wanted_q in WANTED_Q
        for caution in CAUTION
        if wanted_q < caution * ringing.q
    ]
    return [no_damping(source_impedance_ohm), *inverses]
