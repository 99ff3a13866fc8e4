"""HJIF of ISO/IEC 23090-31 (MPEG haptics): each partial is a sequence of effects (sine waves).

Effects that sound at the same time are in different bands. Each effect has a constant frequency, an
integer in Hz, because some players compute the phase of a varying frequency incorrectly. When the
phase has drifted by more than 0.03 cycles, a new effect begins. Positions are in ms.
"""

import math
from typing import Any

import numpy as np

from audioflinger_hook.exports.options import VIBRATION_HIGH_HZ, VIBRATION_LOW_HZ, band_text
from audioflinger_hook.exports.parametric import Job, TrackWriter, json_bytes
from audioflinger_hook.exports.tracks import PartialTrack
from device.errors import UsageError
from device.rig import rig_by_name

TICKS_A_SECOND = 1_000
LEVEL_1_BANDS, LEVEL_2_BANDS = 7, 63
DRIFT_TURNS = 0.03
"""Largest phase drift of an effect in cycles. Larger drifts change the beats between partials."""

BODY_PART_UNSPECIFIED = 0
VERSION = "2024"
DATE = "2024-01-01"  # constant, so that equal sounds give equal files


class HjifWriter(TrackWriter):
    """Collects the partial tracks of all channels, and writes the file at the end."""

    def __init__(self, job: Job) -> None:
        super().__init__(job)
        self._waves: list[list[dict[str, Any]]] = [[] for _ in range(job.channels)]

    def take(self, channel: int, track: PartialTrack) -> None:
        """Convert a partial track to effects, and store them in memory."""
        self._waves[channel] += effects_of(track)

    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the file. UsageError: the format has too few bands for simultaneous partials."""
        bands = [_banded(waves) for waves in self._waves]
        most = max(len(one) for one in bands)
        if most > LEVEL_2_BANDS:
            raise UsageError(
                f"{most} partials sound at the same time, but the format hjif has "
                f"{LEVEL_2_BANDS} bands; set partials_max to 16 or less, or use the format partials"
            )
        self._job.file.write(json_bytes(self._document(bands, most, duration_s)))
        keyframes = sum(len(effect["keyframes"]) for waves in self._waves for effect in waves)
        return {"bands": most, "keyframes": keyframes}

    def _document(
        self, bands: list[list[list[dict[str, Any]]]], most: int, duration_s: float
    ) -> dict[str, Any]:
        low_hz, high_hz = self._band_hz or (VIBRATION_LOW_HZ, VIBRATION_HIGH_HZ)
        rig = rig_by_name(self._job.settings.rig)
        device = {  # that the file is for
            "id": 0,
            "name": "device" if self._band_hz else rig.name,
            "body_part_mask": BODY_PART_UNSPECIFIED,
            "minimum_frequency": low_hz,
            "maximum_frequency": high_hz,
            "resonance_frequency": min(max(rig.actuator.resonance_hz, low_hz), high_hz),
            "type": "VCA",
        }
        limits = {
            "lower_frequency_limit": math.floor(low_hz),
            "upper_frequency_limit": math.ceil(high_hz),
        }
        channels = [
            {
                "id": number,
                "description": f"channel {number + 1}",
                "gain": 1.0,
                "mixing_weight": 1.0,
                "body_part_mask": BODY_PART_UNSPECIFIED,
                "reference_device_id": 0,
                "bands": [
                    {"band_type": "VectorialWave", **limits, "effects": effects} for effects in mine
                ],
            }
            for number, mine in enumerate(bands)
        ]
        perception = {
            "id": 0,
            "avatar_id": 0,
            "description": "vibration of a seat",
            "perception_modality": "Vibrotactile",
            "reference_devices": [device],
            "channels": channels,
            "effect_library": [],
        }
        return {
            "version": VERSION,
            "profile": "Main",
            "level": 1 if most <= LEVEL_1_BANDS else 2,
            "date": DATE,
            "description": (
                f"Haptic Cushion, {duration_s:.3f} s; a sine's phase is in radians; "
                f"{band_text(self._band_hz)}"
            ),
            "timescale": TICKS_A_SECOND,
            "avatars": [{"id": 0, "lod": 0, "type": "Vibration"}],
            "perceptions": [perception],
            "syncs": [{"timestamp": 0}],
        }


def effects_of(track: PartialTrack) -> list[dict[str, Any]]:
    """Return a partial track as consecutive effects, which do not overlap."""
    times, amplitude = track.time_s, np.minimum(1.0, track.amplitude)
    first = max(0, math.ceil(TICKS_A_SECOND * float(times[0])))
    last = math.floor(TICKS_A_SECOND * float(times[-1]))
    if last - first < 1:
        return []
    # Frequency, phase and level at every tick.
    ticks = np.arange(first, last + 1)
    seconds = ticks / TICKS_A_SECOND
    at_hz, turns = np.interp(seconds, times, track.hz), track.turns_at(seconds)
    level = np.interp(seconds, times, amplitude)
    knees = np.clip(np.rint(TICKS_A_SECOND * times), first, last).astype(int) - first
    effects = []
    begin = 0
    while begin < ticks.size - 1:
        whole_hz = max(1, round(float(at_hz[begin : begin + 50].mean())))
        drift = turns[begin:] - turns[begin] - whole_hz * (seconds[begin:] - seconds[begin])
        beyond = np.flatnonzero(np.abs(drift) > DRIFT_TURNS)
        end = begin + max(1, int(beyond[0])) if beyond.size else ticks.size - 1
        # The phase error changes from +drift/2 at the start to -drift/2 at the end.
        phase = turns[begin] + 0.5 * float(drift[end - begin])
        inside = knees[(knees > begin) & (knees < end)]
        keyframes = [
            {
                "relative_position": int(one - begin),
                "amplitude_modulation": round(float(level[one]), 6),
                "frequency_modulation": whole_hz,
            }
            for one in np.unique([begin, *inside.tolist(), end])
        ]
        effects.append(
            {
                "effect_type": "Basis",
                "position": int(ticks[begin]),
                "phase": round(2.0 * math.pi * ((phase + 0.25) % 1.0), 5),
                "base_signal": "Sine",
                "keyframes": keyframes,
            }
        )
        begin = end
    return effects


def _banded(effects: list[dict[str, Any]]) -> list[list[dict[str, Any]]]:
    """Distribute effects over as few bands as possible, so that none overlap in a band."""
    bands: list[list[dict[str, Any]]] = []
    for effect in sorted(effects, key=lambda one: (one["position"], one["phase"])):
        free = next((band for band in bands if _end_of(band[-1]) <= effect["position"]), None)
        if free is None:
            bands.append([effect])
        else:
            free.append(effect)
    return bands


def _end_of(effect: dict[str, Any]) -> int:
    return int(effect["position"] + effect["keyframes"][-1]["relative_position"])
