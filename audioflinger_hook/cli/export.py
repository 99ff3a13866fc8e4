"""`cushion export`: writes the vibration of a sound file in a format of other haptic tools."""

import argparse
import dataclasses
import json

from audioflinger_hook.cli.render import chosen_settings
from audioflinger_hook.cli.terminal import level_text, progress_bar, warn
from audioflinger_hook.exports.export import ExportOptions, export, format_of
from audioflinger_hook.exports.options import LONG
from audioflinger_hook.offline.render import refuse_same_file
from audioflinger_hook.sources import FileTap, TapClient
from device.errors import UsageError
from device.values import counted


def run(options: argparse.Namespace) -> int:
    """Export the vibration of a sound file, and print a summary."""
    if str(options.output) == "-":
        raise UsageError("OUT = '-': standard output cannot take the file; name a file")
    wanted = ExportOptions(
        options.format or format_of(options.output), options.output_rate, options.device_band
    )
    refuse_same_file(options.input, options.output, None)
    settings = chosen_settings(options)
    tap = FileTap(options.input)
    client, (long_s, note) = TapClient(tap), LONG.get(wanted.format, (0, ""))
    if note and (client.frames_expected or 0) > long_s * client.samplerate:
        warn(f"the format {wanted.format} {note}")
    with progress_bar(options.input.name) as progress:
        report = export(client, options.output, settings, wanted, progress, tap.warnings)
    warn(*report.warnings)
    if options.json:
        print(json.dumps(dataclasses.asdict(report), indent=2))
        return 0
    parts = [
        f"{report.duration_s:.2f} s of vibration as {report.format}",
        f"{counted(report.channels, 'channels')} at {report.samplerate} Hz",
        counted(report.bytes, "bytes"),
        f"peak {level_text(report.peak)}",
    ]
    if report.limited_samples:
        parts.append(f"{counted(report.limited_samples, 'samples')} limited")
    if report.replaced_samples:
        parts.append(f"{counted(report.replaced_samples, 'unusable samples')} set to 0")
    parts += [f"{name.replace('_', ' ')} {value:.3g}" for name, value in report.error.items()]
    print(f"{options.output}: {', '.join(parts)}")
    return 0
