"""`cushion render`: the vibration of a sound file."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

from audioflinger_hook import config
from audioflinger_hook.cli.terminal import level_text, progress_bar, warn
from audioflinger_hook.render import RenderReport, render_file
from audioflinger_hook.settings import Settings

EMPTY: Mapping[str, int] = MappingProxyType({})


def run(options: argparse.Namespace) -> int:
    """Render a file and say what came of it."""
    settings = chosen_settings(options)
    with progress_bar(options.input.name) as progress:
        report = render_file(
            options.input,
            options.output,
            settings,
            acceleration=options.acceleration,
            progress=progress,
        )
    show_report(report, options)
    return 0


def chosen_settings(options: argparse.Namespace, recorded: Settings | None = None) -> Settings:
    """Return what a config file says, if one is named, and over it what the options say.

    recorded: taken where no file is named.
    """
    settings = config.load(options.config).settings if options.config else recorded or Settings()
    given = {
        name: getattr(options, name)
        for name in ("form", "channels", "profile", "damping", "protection", "rig")
        if getattr(options, name) is not None
    }
    return settings.choosing(**given)


def show_report(
    report: RenderReport, options: argparse.Namespace, more: Mapping[str, int] = EMPTY
) -> None:
    """Print what came of it, as JSON where asked, with warnings on stderr; more: other counts."""
    for warning in report.warnings:
        warn(warning)
    if options.output.suffix.lower() not in (".wav", ".wave", ".rf64", ""):
        warn(f"{options.output} is a WAV file, whatever its name says")
    if options.json:
        print(json.dumps({**dataclasses.asdict(report), **more}, indent=2))
    else:
        counts = [f"{count} {name.replace('_', ' ')}" for name, count in more.items() if count]
        print(", ".join([_summary(report, options.output), *counts]))


def _summary(report: RenderReport, output: Path) -> str:
    parts = [
        f"{output}: {report.frames / report.samplerate:.2f} s of vibration",
        f"{report.channels} channel{'s' if report.channels > 1 else ''} at {report.samplerate} Hz",
        f"peak {level_text(report.peak)}",
    ]
    if report.limited_samples:
        parts.append(f"{report.limited_samples} samples limited")
    if report.replaced_samples:
        parts.append(f"{report.replaced_samples} unusable samples taken for 0")
    if report.peak_acceleration_m_s2 is not None:
        parts.append(f"peak acceleration {report.peak_acceleration_m_s2:.1f} m/s^2")
    return ", ".join(parts)
