"""The figures of driven rigs, as the status shows them. Any thread may call the functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from audioflinger_hook.drive.driven_rig import DrivenRig
from audioflinger_hook.service.status import ExposureFigures, ProtectionFigures

Rigs = Sequence[DrivenRig | None]


def protection_figures(rig: DrivenRig | None) -> ProtectionFigures | None:
    """Return the figures of a rig's protection, None without one."""
    if rig is None:
        return None
    seen = rig.protection()
    return ProtectionFigures(
        blocks=seen.blocks,
        limited_blocks=seen.limited_blocks,
        infeasible_blocks=seen.infeasible_blocks,
        replaced_samples=seen.replaced_samples,
        gain=seen.gain,
        least_gain=seen.least_gain,
        limited_by=seen.limited_by,
        excursion_mm=1e3 * seen.excursion_m,
        coil_c=seen.coil_c,
        makeup_db=rig.makeup_db,
        strength_db=rig.strength_db,
    )


def exposure_figures(rig: DrivenRig | None, since: str) -> ExposureFigures | None:
    """Return the figures of a rig's exposure, None without one; since: see `ExposureFigures`."""
    if rig is None:
        return None
    dose = rig.exposure()
    return ExposureFigures(
        time_s=dose.time_s,
        running_m_s2=dose.running_m_s2,
        a8_m_s2=dose.a8_m_s2,
        vdv=dose.vdv,
        above_action=dose.above_action,
        above_limit=dose.above_limit,
        extrapolated=dose.extrapolated,
        knows_seat=rig.knows_seat,
        cap=rig.exposure_cap,
        cap_gain=rig.exposure_gain,
        since=since,
    )


def protection_of(rigs: Rigs) -> ProtectionFigures | None:
    """Return the figures of the rig whose gain is lowest; None without rigs."""
    found = [figures for rig in rigs if (figures := protection_figures(rig))]
    return min(found, key=lambda one: (one.gain, one.least_gain), default=None)


def exposure_of(rigs: Rigs, since: str) -> ExposureFigures | None:
    """Return each reading of the rig where it is worst; None without rigs."""
    return worst_exposure([figures for rig in rigs if (figures := exposure_figures(rig, since))])


def worst_exposure(found: Sequence[ExposureFigures]) -> ExposureFigures | None:
    """Return each reading where it is worst; None without any."""
    if not found:
        return None
    most = max(found, key=lambda one: one.a8_m_s2)
    capped = min(found, key=lambda one: one.cap_gain)
    return replace(
        most,
        time_s=max(one.time_s for one in found),
        running_m_s2=max(one.running_m_s2 for one in found),
        vdv=max(one.vdv for one in found),
        above_action=any(one.above_action for one in found),
        above_limit=any(one.above_limit for one in found),
        cap=capped.cap,
        cap_gain=capped.cap_gain,
    )
