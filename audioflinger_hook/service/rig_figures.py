"""What a status tells of the rig: what protection did, and how much vibration a sitter had."""

from __future__ import annotations

from dataclasses import dataclass

from audioflinger_hook.service.levels import Level


@dataclass(frozen=True)
class ProtectionFigures:
    """Counts of blocks of 2 ms since the start, and the last one's readings, the worst channel's.

    limited_blocks: where some drive was taken away; infeasible_blocks: where all of it was, since
    nothing else would have kept the limits. gain, least_gain: of the drive, now and the smallest,
    0 to 1. limited_by: what asked for the gain now, "" where nothing did. excursion_mm: amplitude
    that is predicted; coil_c: predicted, degrees C, None where the rig does not say how it warms
    up.
    """

    blocks: int
    limited_blocks: int
    infeasible_blocks: int
    replaced_samples: int
    gain: float
    least_gain: float
    limited_by: str
    excursion_mm: float
    coil_c: float | None


@dataclass(frozen=True)
class ExposureFigures:
    """Predicted vibration of the seat since the start, weighted by Wk of ISO 2631-1.

    time_s: of vibration; running_m_s2: r.m.s. of the last second; a8_m_s2: A(8); vdv: m/s^1.75;
    above_action, above_limit: whether 2002/44/EC says so; extrapolated: share of the energy above
    80 Hz, where the weighting is an extrapolation. knows_seat: whether the seat is the rig file's,
    else it is taken to move as the mass does. cap, cap_gain: what `exposure_cap` says, and the gain
    that is left by it, 0 to 1.
    """

    time_s: float
    running_m_s2: float
    a8_m_s2: float
    vdv: float
    above_action: bool
    above_limit: bool
    extrapolated: float
    knows_seat: bool = False
    cap: str = "off"
    cap_gain: float = 1.0


@dataclass(frozen=True)
class ActuatorFigures:
    """One of several actuators: what was asked for, and what it gets.

    source: of its vibration; channels: of the device, as the config names them; rig: by its own
    name or its file's. level: of what it gets, protection and its own level included. protection,
    exposure: None where nothing is done for it.
    """

    source: str
    channels: tuple[str, ...]
    rig: str
    gain_db: float
    polarity: str
    delay_ms: float
    level: Level
    protection: ProtectionFigures | None
    exposure: ExposureFigures | None
