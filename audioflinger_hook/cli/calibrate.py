"""`cushion calibrate`: sweep a rig, and write what was identified into its file."""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import replace
from pathlib import Path

from audioflinger_hook.cli.calibrate_report import document, table
from audioflinger_hook.cli.terminal import warn
from device.address import parse_device
from device.errors import UsageError
from device.identification.calibration import Calibration, calibrate
from device.identification.live.laboratory import Devices
from device.identification.rig_values import write_rig
from device.identification.simulated_laboratory import USUAL_SHARE, SimulatedLaboratory
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

    devices = None
    if device.kind == "twin":
        bench = SimulatedLaboratory(rig, seat=options.seat)
        share = USUAL_SHARE if options.share is None else options.share
        found = calibrate(bench, rig, bench.sweep_at_excursion(sweep, share), tell)
    else:
        from audioflinger_hook.cli.calibrate_live import calibrate_live

        found, devices = calibrate_live(device, rig, sweep, options, tell)
        rig = replace(rig, name=options.out.stem) if options.out else rig
        if found.rig:
            found = replace(found, rig=replace(found.rig, name=rig.name))
    return _conclude(found, rig, devices, options)


def _check_out(path: Path | None) -> None:
    """Refuse a file that could not be written, before anything is played."""
    if path is None:
        return
    if path.suffix != SUFFIX:
        raise UsageError(f"out={path}: a rig's file ends in {SUFFIX}, so that --rig takes it")
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK):
        raise UsageError(f"out={path}: the folder {path.parent} cannot be written; choose another")


def _conclude(
    found: Calibration, rig: Rig, devices: Devices | None, options: argparse.Namespace
) -> int:
    if options.out and found.rig:
        write_rig(found.rig, options.out)
    if options.json:
        print(json.dumps(document(found, rig, devices), indent=2))
    else:
        print(table(found, devices))
    if found.on_seat and found.impedance:
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
