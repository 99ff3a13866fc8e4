"""HJIF of ISO/IEC 23090-31 (MPEG haptics): each partial is a wave in a separate band.

An effect has one whole frequency in Hz, so that players which integrate frequency and players
which do not agree. Where a partial drifts from that by 0.03 cycles, another effect goes on in
phase. Positions are in ms. Tracks of onsets are kept unchanged, in ticks of 2 ms.
"""

from __future__ import annotations

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
"""Largest error of a phase, in cycles. At 0.1, beats of steady partials differ: the
envelope of an engine correlates by 0.80 with the vibration's, and by 0.97 at 0.03."""

BODY_PART_UNSPECIFIED = 0
VERSION = "2024"
DATE = "2024-01-01"  # fixed so that equal sounds give equal files


class HjifWriter(TrackWriter):
    """Collects the tracks of all channels and writes them at the end."""

    def __init__(self, job: Job) -> None:
        super().__init__(job)
        self._waves: list[list[dict[str, Any]]] = [[] for _ in range(job.channels)]

    def take(self, channel: int, track: PartialTrack) -> None:
        """Keep a track as effects."""
        self._waves[channel] += effects_of(track)

    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the file. UsageError: more partials sound at a time than the format has bands."""
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
            "reference_devices": [self._device(low_hz, high_hz)],
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

    def _device(self, low_hz: float, high_hz: float) -> dict[str, Any]:
        """Return the rig of the settings, or an actuator of the device's band."""
        rig = rig_by_name(self._job.settings.rig)
        resonance_hz = min(max(rig.actuator.resonance_hz, low_hz), high_hz)
        return {
            "id": 0,
            "name": "device" if self._band_hz else rig.name,
            "body_part_mask": BODY_PART_UNSPECIFIED,
            "minimum_frequency": low_hz,
            "maximum_frequency": high_hz,
            "resonance_frequency": resonance_hz,
            "type": "VCA",
        }


def effects_of(track: PartialTrack) -> list[dict[str, Any]]:
    """Return a track as effects that follow one another in phase, none overlapping the next."""
    times, amplitude = track.time_s, np.minimum(1.0, track.amplitude)
    first = max(0, math.ceil(TICKS_A_SECOND * float(times[0])))
    last = math.floor(TICKS_A_SECOND * float(times[-1]))
    if last - first < 1:
        return []
    # Phase and frequency at every tick.
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
        # Half of the drift before and half after the true phase.
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
    """Spread effects over as few bands as possible; in a band none overlap."""
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
