"""HJIF of ISO/IEC 23090-31 (MPEG haptics): each partial is a sequence of effects (sine waves).

Effects that sound at the same time are in different bands. Each effect has a constant frequency, an
integer in Hz, because some players compute the phase of a varying frequency incorrectly. When the
phase has drifted by more than 0.03 cycles, a new effect begins. Positions are in ms.
"""

import heapq
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
EFFECT_TICKS_MAX = 1_000  # longest effect, so that the time of conversion is linear
PHASE_MAX = 6.28318  # largest phase in radians that the format allows

BODY_PART_UNSPECIFIED = 0
AVATAR, DEVICE = 1, 1  # identifiers of both must be positive
NO_EFFECTS = b'"effects":[]'
_Effect = tuple[int, float, int, bytes]  # first tick, phase, last tick, JSON


class HjifWriter(TrackWriter):
    """Collects the partial tracks of all channels, and writes the file at the end."""

    def __init__(self, job: Job) -> None:
        super().__init__(job)
        self._effects: list[list[_Effect]] = [[] for _ in range(job.channels)]
        self._keyframes = 0

    def take(self, tracks: list[tuple[int, PartialTrack]]) -> None:
        """Convert partial tracks to effects, and store them in memory as JSON."""
        for channel, track in tracks:
            for effect in effects_of(track):
                last = effect["keyframes"][-1]["relative_position"]
                at, phase = effect["position"], effect["phase"]
                self._effects[channel].append((at, phase, at + last, json_bytes(effect)))
                self._keyframes += len(effect["keyframes"])

    def write_rest(self, duration_s: float) -> dict[str, int]:
        """Write the file. UsageError: the format has too few bands for simultaneous partials."""
        channels = [_banded(effects) for effects in self._effects]
        if (most := max(len(bands) for bands in channels)) > LEVEL_2_BANDS:
            raise UsageError(
                f"{most} partials sound at the same time, but the format hjif has "
                f"{LEVEL_2_BANDS} bands; set partials_max to 16 or less, or use the format partials"
            )
        # A document without effects, divided where the effects belong.
        document = json_bytes(self._document([len(bands) for bands in channels], most, duration_s))
        *parts, end = document.split(NO_EFFECTS)
        write = self._job.file.write
        for part, band in zip(parts, [band for bands in channels for band in bands], strict=True):
            write(part + NO_EFFECTS[:-1])
            for number, (_, _, _, effect) in enumerate(band):
                write(b"," * bool(number) + effect)
            write(b"]")
        write(end)
        return {"bands": most, "keyframes": self._keyframes}

    def _document(self, bands: list[int], most: int, duration_s: float) -> dict[str, Any]:
        low_hz, high_hz = self._band_hz or (VIBRATION_LOW_HZ, VIBRATION_HIGH_HZ)
        rig = rig_by_name(self._job.settings.rig)
        device = {  # that the file is for
            "id": DEVICE,
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
                "mixing_coefficient": 1.0,
                "body_part_mask": BODY_PART_UNSPECIFIED,
                "reference_device_id": DEVICE,
                "bands": [{"band_type": "VectorialWave", **limits, "effects": []}] * count,
            }
            for number, count in enumerate(bands)
        ]
        perception = {
            "id": 0,
            "avatar_id": AVATAR,
            "description": "vibration of a seat",
            "perception_modality": "Vibrotactile",
            "reference_devices": [device],
            "channels": channels,
            "effect_library": [],
        }
        return {
            "version": "2023",
            "profile": "Main",
            "level": 1 if most <= LEVEL_1_BANDS else 2,
            "date": "2024-01-01T00:00:00+00:00",  # constant, so that equal sounds give equal files
            "description": (
                f"Haptic Cushion, {duration_s:.3f} s; a sine's phase is in radians; "
                f"{band_text(self._band_hz)}"
            ),
            "timescale": TICKS_A_SECOND,
            "avatars": [{"id": AVATAR, "lod": 0, "type": "Vibration"}],
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
        stop = min(ticks.size, begin + EFFECT_TICKS_MAX + 1)
        drift = turns[begin:stop] - turns[begin] - whole_hz * (seconds[begin:stop] - seconds[begin])
        beyond = np.flatnonzero(np.abs(drift) > DRIFT_TURNS)
        end = begin + max(1, int(beyond[0])) if beyond.size else stop - 1
        # The phase error changes from +drift/2 at the start to -drift/2 at the end.
        phase = turns[begin] + 0.5 * float(drift[end - begin])
        inside = knees[np.searchsorted(knees, begin) : np.searchsorted(knees, end)]
        keyframes = [
            {
                "relative_position": int(one - begin),
                "amplitude_modulation": round(float(level[one]), 6),
                "frequency_modulation": whole_hz,
            }
            for one in sorted({begin, *inside.tolist(), end})
        ]
        effects.append(
            {
                "effect_type": "Basis",
                "position": int(ticks[begin]),
                "phase": min(PHASE_MAX, round(2.0 * math.pi * ((phase + 0.25) % 1.0), 5)),
                "base_signal": "Sine",
                "keyframes": keyframes,
            }
        )
        begin = end
    return effects


def _banded(effects: list[_Effect]) -> list[list[_Effect]]:
    """Distribute effects over as few bands as possible, so that none overlap in a band."""
    bands: list[list[_Effect]] = []
    ends: list[tuple[int, int]] = []  # end of each band's last effect, and index of the band
    for effect in sorted(effects):
        if ends and ends[0][0] <= effect[0]:
            band = heapq.heapreplace(ends, (effect[2], ends[0][1]))[1]
            bands[band].append(effect)
        else:
            heapq.heappush(ends, (effect[2], len(bands)))
            bands.append([effect])
    return bands
