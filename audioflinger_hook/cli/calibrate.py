"""`cushion calibrate`: sweep a rig, and write what was identified into its file."""

from __future__ import annotations

import argparse
import json

from audioflinger_hook.cli.terminal import warn
from device.address import parse_device
from device.errors import NotFoundError
from device.identification.bench import Bench
from device.identification.calibration import Calibration, calibrate
from device.identification.rig_values import write_rig
from device.identification.sweep import Sweep
from device.rig import rig_by_name


def run(options: argparse.Namespace) -> int:
    """Calibrate, from low levels on; whatever is unexpected ends it before it becomes loud."""
    device = parse_device(options.device)
    if device.kind != "twin":
        raise NotFoundError(
            f"device {str(device)!r} cannot be calibrated, only the twin can: choose --device twin"
        )
    rig = rig_by_name(options.rig)
    bench = Bench(rig, seat=options.seat)
    sweep = bench.level(
        Sweep(low_hz=options.low_hz, high_hz=options.high_hz, duration_s=options.seconds),
        options.share,
    )

    def tell(level: float) -> None:
        if not options.json:
            print(f"sweep {sweep.low_hz:g} to {sweep.high_hz:g} Hz, level {level:.4f}", flush=True)

    found = calibrate(bench, rig, sweep, tell)
    if options.out:
        write_rig(found.rig, options.out)
    if options.json:
        print(json.dumps(_document(found), indent=2))
    else:
        print(_table(found))
    if found.force_factor is None:
        warn(
            "Bl and moving mass are not identified on a seat that gives way; put the actuator on "
            "solid ground for them"
        )
    return 0


def _document(found: Calibration) -> dict[str, object]:
    return {
        "rig": found.rig.name,
        "level": found.sweep.level,
        "level_of_x_max": found.mode.level_of_x_max,
        "on_seat": found.force_factor is None,
        "driven_f0_hz": found.driven.f0_hz.value,
        "driven_q": found.driven.q.value,
        "values": {
            parameter: {"value": estimate.value, "interval": list(estimate.interval)}
            for parameter, estimate in found.values.items()
        },
    }


def _table(found: Calibration) -> str:
    rows = [
        f"{parameter:<32} {estimate.value:>12.5g}   {estimate.low:.5g} to {estimate.high:.5g}"
        for parameter, estimate in found.values.items()
    ]
    mode = found.driven
    rows.append(f"driven by its amplifier: {mode.f0_hz.value:.2f} Hz, Q {mode.q.value:.2f}")
    rows.append(f"swept at {found.mode.level_of_x_max:.3f} Xmax; intervals are of 95 %")
    return "\n".join(rows)
