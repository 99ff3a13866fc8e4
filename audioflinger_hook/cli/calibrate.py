"""`cushion calibrate`: sweep a rig, and write what was identified into its file."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

from audioflinger_hook.cli.calibrate_report import document, table
from audioflinger_hook.cli.terminal import warn
from device.address import parse_device
from device.errors import NotFoundError, UsageError
from device.identification.bench import USUAL_SHARE, Bench
from device.identification.calibration import Calibration, calibrate
from device.identification.rig_values import write_rig
from device.identification.sweep import Sweep
from device.rig import Rig, rig_by_name

SUFFIX = ".toml"


def run(options: argparse.Namespace) -> int:
    """Calibrate, from low levels on; whatever is unexpected ends it before it becomes loud."""
    device = parse_device(options.device)
    rig = rig_by_name(options.rig)
    _check_out(options.out)
    sweep = Sweep(low_hz=options.low_hz, high_hz=options.high_hz, duration_s=options.seconds)

    def tell(level: float) -> None:
        if not options.json:
            print(f"sweep {sweep.low_hz:g} to {sweep.high_hz:g} Hz, level {level:.4f}", flush=True)

    if device.kind == "twin":
        bench = Bench(rig, seat=options.seat)
        share = USUAL_SHARE if options.share is None else options.share
        found = calibrate(bench, rig, bench.level(sweep, share), tell)
    else:
        raise NotFoundError(
            f"device {str(device)!r} cannot be calibrated, only the twin can: choose --device twin"
        )
    return _conclude(found, rig, options)


def _check_out(path: Path | None) -> None:
    """Refuse a file that could not be written, before anything is played."""
    if path is None:
        return
    if path.suffix != SUFFIX:
        raise UsageError(f"out={path}: a rig's file ends in {SUFFIX}, so that --rig takes it")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise UsageError(f"out={path}: the folder {path.parent} cannot be written; choose another")


def _conclude(found: Calibration, rig: Rig, options: argparse.Namespace) -> int:
    if options.out and found.rig:
        write_rig(found.rig, options.out)
    print(json.dumps(document(found, rig), indent=2) if options.json else table(found))
    if found.on_seat and found.impedance and not found.force_factor:
        warn(
            "Bl and moving mass are not identified on a seat that gives way; put the actuator on "
            "solid ground for them"
        )
    if found.matched:
        warn(
            "f0 and Qms follow from this mode only with the coil's assumed values, so the file "
            "calls them assumed; measure voltage and current to identify them"
        )
    if found.why_not:
        message = f"f0 and Qms do not follow from this mode: {found.why_not}"
        if options.out:
            raise UsageError(f"{options.out} is not written: {message}")
        warn(message)
    return 0
