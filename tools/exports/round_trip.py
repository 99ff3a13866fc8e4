"""Exports a sound in all parametric formats and renders the files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import soundfile

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.exports.export import ExportOptions, export
from audioflinger_hook.sources import FramesTap, TapClient
from device.units import Float32Array
from tools.exports.measures import Likeness, births_in, likeness
from tools.exports.renderers import RENDERERS

PLAYED_HZ = 2_000
_BLOCK = 32_768


def round_trip(
    sound: Float32Array, rate_hz: int, profile: str, folder: Path
) -> dict[str, Likeness]:
    """Return, by format, the comparison of the rendered file with the vibration of a sound.

    sound: (frames, channels). folder: for the exported files; files of an earlier call are
        overwritten.
    """

    def exported(format_name: str, output_rate_hz: int | None = None) -> Path:
        client = TapClient(FramesTap(sound, rate_hz, _BLOCK))
        options = ExportOptions(format_name, output_rate_hz)
        path = folder / f"sound.{format_name}"
        export(client, path, Settings(profile=profile), options)
        return path

    original = soundfile.read(exported("wav", PLAYED_HZ), always_2d=True)[0][:, 0]
    births_s = births_in(exported("partials").read_bytes())
    found = {}
    for name, play in RENDERERS.items():
        made = play(exported(name).read_bytes(), original.size / PLAYED_HZ, PLAYED_HZ)
        found[name] = likeness(original, np.asarray(made)[: original.size], PLAYED_HZ, births_s)
    return found
