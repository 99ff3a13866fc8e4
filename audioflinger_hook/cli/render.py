"""`cushion render`: writes the vibration of one or several sound files."""

import argparse
import dataclasses
import json
from collections.abc import Mapping
from pathlib import Path

from audioflinger_hook.cli.arguments import given_values
from audioflinger_hook.cli.terminal import complain, level_text, progress_bar, warn
from audioflinger_hook.config import file as config
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline import batch
from audioflinger_hook.offline.render import RenderReport, render_file
from device.errors import UsageError
from device.rig.model_record import in_words
from device.values import counted

WAV_SUFFIXES = (".wav", ".wave", ".rf64")
SEE_HELP = "see `cushion render --help`"


def run(options: argparse.Namespace) -> int:
    """Render one file, or several files into a folder, and print a summary."""
    workers = chosen_workers(options.workers)
    if options.out_dir is not None:
        return _run_several(options, workers)
    files = options.files
    if len(files) < 2:
        missing = ", ".join(("IN", "OUT")[len(files) :])
        raise UsageError(f"the following arguments are required: {missing}; {SEE_HELP}")
    if len(files) > 2:
        more = " ".join(str(file) for file in files[2:])
        raise UsageError(
            f"unrecognized arguments: {more}; allowed: IN OUT, or any number of IN with "
            f"--out-dir DIR; {SEE_HELP}"
        )
    out = files[1]
    if str(out) == "-":
        raise UsageError("OUT = '-': standard output cannot take a WAV; name a file")
    if out.suffix.lower() not in (*WAV_SUFFIXES, ""):
        allowed = f"a name that ends in {', '.join(WAV_SUFFIXES)}, or without an ending"
        raise UsageError(f"OUT = '{out}': the vibration is written as WAV; allowed: {allowed}")
    source, options.output = files
    settings, acceleration = chosen_settings(options), options.acceleration
    with progress_bar(source.name) as progress:
        report = render_file(source, out, settings, acceleration=acceleration, progress=progress)
    show_report(report, options)
    return 0


def _run_several(options: argparse.Namespace, workers: int) -> int:
    if not options.files:
        raise UsageError(f"the following arguments are required: IN; {SEE_HELP}")
    if options.acceleration is not None:
        raise UsageError("--acceleration names one file; render one by one with it: IN OUT")
    targets = batch.targets_in(options.out_dir, options.files)
    settings = chosen_settings(options)
    came: list[batch.Rendered] = []
    warned: set[str] = set()
    with progress_bar(f"{len(targets)} files") as progress:
        for rendered in batch.render_files(
            options.files, targets, settings, workers, lambda share: progress(share, 1.0)
        ):
            came.append(rendered)
            if rendered.report is None:
                complain(rendered.error)
                continue
            for warning in rendered.report.warnings:
                if warning not in warned:  # print equal warnings of several files once
                    warn(warning)
                    warned.add(warning)
            if not options.json:
                print(_summary(rendered.report, rendered.target), flush=True)
    if options.json:
        print(json.dumps({"files": [_entry(rendered) for rendered in came]}, indent=2))
    return max(rendered.exit_code for rendered in came)


def _entry(rendered: batch.Rendered) -> dict[str, object]:
    head = {"input": str(rendered.source), "output": str(rendered.target)}
    if rendered.report is None:
        return {**head, "error": rendered.error, "exit_code": rendered.exit_code}
    return {**head, **dataclasses.asdict(rendered.report)}


def chosen_workers(wanted: int | None) -> int:
    """Return `wanted`, or the number of usable cores for None. UsageError: it is out of range."""
    if wanted is None:
        return batch.usable_cores()
    if not 1 <= wanted <= batch.WORKERS_MAX:
        raise UsageError(f"--workers={wanted} is out of range; allowed: 1 to {batch.WORKERS_MAX}")
    return wanted


def chosen_settings(options: argparse.Namespace, recorded: Settings | None = None) -> Settings:
    """Return the settings of `--config`, else `recorded`, else defaults; options override them."""
    default = options.default_profile
    if options.config:
        settings = config.load(options.config, default).settings
    else:
        settings = recorded or Settings(profile=default)
    names = ("form", "channels", "profile", "damping", "protection", "rig", "model", "tolerance")
    return settings.choosing(**given_values(options, names))


def show_report(
    report: RenderReport, options: argparse.Namespace, more: Mapping[str, int] | None = None
) -> None:
    """Print a summary, and warnings on stderr. more: further counts to print, keyed by name."""
    more = more or {}
    warn(*report.warnings)
    if options.json:
        print(json.dumps({**dataclasses.asdict(report), **more}, indent=2))
    else:
        counts = [counted(count, name.replace("_", " ")) for name, count in more.items() if count]
        print(", ".join([_summary(report, options.output), *counts]))
        for line in in_words(report.models):
            print(f"  {line}")


def _summary(report: RenderReport, output: Path) -> str:
    parts = [
        f"{output}: {report.frames / report.samplerate:.2f} s of vibration",
        f"{counted(report.channels, 'channels')} at {report.samplerate} Hz",
        f"peak {level_text(report.peak)}",
    ]
    if report.limited_samples:
        parts.append(f"{counted(report.limited_samples, 'samples')} limited")
    if report.replaced_samples:
        parts.append(f"{counted(report.replaced_samples, 'unusable samples')} set to 0")
    if report.peak_acceleration_m_s2 is not None:
        parts.append(f"peak acceleration {report.peak_acceleration_m_s2:.1f} m/s²")
    if report.strength_db is not None:
        parts.append(f"felt {report.strength_db:+.1f} dB against no damping")
    return ", ".join(parts)
