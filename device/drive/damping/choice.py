"""The automatic choice: the least residual in the worst case, within the available volts."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import get_args

import numpy as np

from device.drive.damping.design import (
    Damping,
    ShaperKind,
    inverse_damping,
    no_damping,
    resonance_of,
    shaper_damping,
)
from device.drive.damping.residual import Residual, burst_response, undamped
from device.errors import UsageError
from device.rig import ActuatorParameters

HEADROOM_DB = 5.0
WANTED_Q = (0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.85, 1.0, 1.4, 2.0, 3.0)
CAUTION = (1.0, 0.9, 0.8, 0.65, 0.5)
SHIFT = (1.0, 1.02, 1.04, 1.06)


@dataclass(frozen=True)
class Uncertainty:
    """How far the rig may be from what was identified.

    Attributes
    ----------
    resonance : float
        Share of f0 in either direction, 0 to 0.5; sitters alone shift it by about 10 %.
    q_mechanical : tuple[float, float] | None
        Lowest and highest value; None if the rig's is exact.
    """

    resonance: float = 0.1
    q_mechanical: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.resonance <= 0.5:
            raise UsageError(
                f"resonance={self.resonance!r} of the uncertainty must be 0 to 0.5 (a share of "
                "f0, not %); correct it"
            )
        if self.q_mechanical and not 0.0 < self.q_mechanical[0] <= self.q_mechanical[1]:
            raise UsageError(
                f"q_mechanical={self.q_mechanical!r} must be two values above 0, the lower one "
                "first; correct it"
            )


@dataclass(frozen=True)
class Candidate:
    """A damping and its residual, against undamped current drive.

    Attributes
    ----------
    damping : Damping
        The filter.
    as_believed : Residual
        For the rig as identified.
    worst_db : float
        Largest residual of all possible rigs.
    affordable : bool
        Whether its peak volts for the believed rig are within the headroom.
    makeup : float
        Factor on the drive that makes a burst as strong as without damping.
    """

    damping: Damping
    as_believed: Residual
    worst_db: float
    affordable: bool
    makeup: float


@dataclass(frozen=True)
class DampingChoice:
    """The chosen candidate, and all candidates, the best first."""

    chosen: Candidate
    candidates: tuple[Candidate, ...] = field(repr=False)

    @property
    def damping(self) -> Damping:
        """The damping of the chosen candidate."""
        return self.chosen.damping


def choose_damping(
    p: ActuatorParameters,
    *,
    uncertainty: Uncertainty | None = None,
    headroom_db: float = HEADROOM_DB,
    source_impedances_ohm: Sequence[float] = (0.0,),
    latency_s: float = 0.0,
) -> DampingChoice:
    """Return the damping with the least residual in the worst case; takes some tenths of a second.

    If nothing is within the headroom, the choice is what needs the fewest volts; `affordable` is
    then False.

    Parameters
    ----------
    p : ActuatorParameters
        The actuator as identified.
    uncertainty : Uncertainty | None
        How far it may be from that; None for the default.
    headroom_db : float
        Peak volts beyond those of undamped current drive for the same vibration.
    source_impedances_ohm : Sequence[float]
        Of the amplifier's drive modes.
    latency_s : float
        Delay that a damping may add; 0 excludes shapers.

    Raises
    ------
    UsageError
        headroom_db is not a number, or there is no source impedance.
    """
    if not np.isfinite(headroom_db):
        raise UsageError(f"headroom_db={headroom_db!r} must be a number; correct it")
    if not source_impedances_ohm:
        raise UsageError("no source impedance to choose from; name at least that of the amplifier")
    possible = _possible_rigs(p, uncertainty or Uncertainty())
    references = [undamped(q_rig, detuning=d) for q_rig, d in possible]
    reference = undamped(p)
    candidates = []
    for source in source_impedances_ohm:
        plain = burst_response(p, no_damping(source))
        for damping in _dampings(p, source):
            if damping.latency_s > latency_s:
                continue
            believed = burst_response(p, damping)
            shown = believed.against(reference)
            worst_db = max(
                burst_response(rig, damping, detuning=d).against(other).residual_db
                for (rig, d), other in zip(possible, references, strict=True)
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
    candidates.sort(key=_rank)
    return DampingChoice(candidates[0], tuple(candidates))


def _rank(candidate: Candidate) -> tuple[bool, float]:
    """Sort affordable ones by their worst case, then the others by their volts."""
    if candidate.affordable:
        return False, candidate.worst_db
    return True, candidate.as_believed.peak_volts_db


def _possible_rigs(
    p: ActuatorParameters, uncertainty: Uncertainty
) -> list[tuple[ActuatorParameters, float]]:
    """Return all corners of the uncertainty: rigs, and the share of f0 by which each is detuned."""
    low, high = uncertainty.q_mechanical or (p.q_mechanical, p.q_mechanical)
    shares = {0.0, -uncertainty.resonance, uncertainty.resonance}
    return [
        (replace(p, q_mechanical=q), share) for q in sorted({low, high}) for share in sorted(shares)
    ]


def _dampings(p: ActuatorParameters, source_impedance_ohm: float) -> list[Damping]:
    """Return all candidates at this source impedance."""
    ringing = resonance_of(p, source_impedance_ohm)
    dampings = [no_damping(source_impedance_ohm)]
    if ringing.q > 0.5:
        dampings += [
            shaper_damping(p, kind, source_impedance_ohm, shift=shift)
            for kind in get_args(ShaperKind)
            for shift in SHIFT
        ]
    dampings += [
        inverse_damping(p, wanted_q, source_impedance_ohm, caution=caution)
        for wanted_q in WANTED_Q
        for caution in CAUTION
        if wanted_q < caution * ringing.q
    ]
    return dampings
