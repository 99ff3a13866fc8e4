"""`cushion calibrate`: identifies a rig's values with sweeps, and can write a rig file."""

import argparse
import json
import os
from collections.abc import Callable
from dataclasses import asdict, replace

from audioflinger_hook.cli.terminal import progress_bar, warn
from device.address import parse_device
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError
from device.identification.acceleration import Mode
from device.identification.calibration import STEPS, Calibration, calibrate
from device.identification.live.laboratory import Devices
from device.identification.mechanics import format_rig
from device.identification.output_error import Estimate
from device.identification.recording import Sweep
from device.identification.simulated_laboratory import USUAL_SHARE, SimulatedLaboratory
from device.identification.transfer import LOW_COHERENCE, Quality
from device.rig import Rig, rig_by_name

NOT_FOR_TWIN = ("input", "channels", "shunt_ohm", "moving_mass_kg", "level", "loud")

_CLOSEST = "the file has the closest L1 + (L2 || R2) in the swept band"
COILS = {
    "plain": "coil: R + L, no eddy currents seen",
    "parallel": "coil with eddy currents: R + L1 + (L2 || R2)",
    "power": f"coil with eddy currents: R + K (jw)^n; {_CLOSEST}",
    "double": f"coil with eddy currents: R + L1 + (L2 || R2) + (L3 || R3); {_CLOSEST}",
    "mixed": f"coil with eddy currents: R + L + K (jw)^n; {_CLOSEST}",
}


def run(options: argparse.Namespace) -> int:
    """Identify the rig with sweeps of increasing level. An error ends the sequence of sweeps."""
    device = parse_device(options.device)
    rig = rig_by_name(options.rig)
    if (out := options.out) and out.suffix != ".toml":
        raise UsageError(f"out={out}: a rig's file ends in .toml, so that --rig accepts it")
    if out and not (out.parent.is_dir() and os.access(out.parent, os.W_OK)):
        raise UsageError(f"out={out}: the folder {out.parent} cannot be written; choose another")
    sweep = Sweep(low_hz=options.low_hz, high_hz=options.high_hz, duration_s=options.seconds)
    devices = None
    with progress_bar(f"sweeps of {sweep.low_hz:g} to {sweep.high_hz:g} Hz") as show:
        progress = Progress(show)
        if device.kind == "twin":
            if given := [name for name in NOT_FOR_TWIN if getattr(options, name)]:
                raise UsageError(f"--{given[0].replace('_', '-')} is not for twin; choose --share")
            bench = SimulatedLaboratory(rig, seat=options.seat)
            share = USUAL_SHARE if options.share is None else options.share
            sweep = bench.sweep_at_excursion(sweep, share)
            found = calibrate(bench, rig, sweep, progress.begin)
        else:
            from audioflinger_hook.cli.calibrate_live import calibrate_live

            found, devices = calibrate_live(device, rig, sweep, options, progress)
            rig = replace(rig, name=devices.output)
    if options.out:
        rig = replace(rig, name=options.out.stem)
    if found.rig:
        found = replace(found, rig=replace(found.rig, name=rig.name))
    return _end(found, rig, devices, options)


class Progress:
    """Shows the progress of the sweeps. The computation after them counts as one more sweep."""

    def __init__(self, show: Callable[[float, float | None], None]) -> None:
        self._show, self._begun = show, 0

    def begin(self, _level: float) -> None:
        """Show that the next sweep begins."""
        self._begun += 1
        self.within(0.0)

    def within(self, share: float) -> None:
        """Show the progress. share: the finished part of the current sweep, 0 to 1."""
        self._show(self._begun - 1 + share, len(STEPS) + 1)


def _end(found: Calibration, rig: Rig, devices: Devices | None, options: argparse.Namespace) -> int:
    if options.out and found.rig:
        write_bytes_atomically(options.out, format_rig(found.rig).encode())
    if options.json:
        print(json.dumps(document(found, rig, devices), indent=2))
    else:
        print(table(found, devices))
    if found.on_seat and found.impedance:
        warn(
            "Bl and moving mass cannot be identified on an elastic seat; put the actuator on solid "
            "ground"
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


def document(found: Calibration, rig: Rig, devices: Devices | None) -> dict[str, object]:
    """Return the result for `--json`. A value that was not measured or computed is None."""
    driven, scaled = found.driven, found.level_of_x_max is not None
    return {
        "rig": rig.name,
        "level": found.sweep.level,
        "level_of_x_max": found.level_of_x_max,
        "on_seat": found.on_seat,
        "driven_f0_hz": driven and driven.f0_hz.value,
        "driven_f0_interval_hz": driven and driven.f0_hz.interval,
        "driven_q": driven and driven.q.value,
        "driven_q_interval": driven and driven.q.interval,
        "driven_sensitivity": _estimate(driven.sensitivity) if driven and scaled else None,
        "values": {parameter: _estimate(estimate) for parameter, estimate in found.values.items()},
        "coil_law": found.impedance and found.impedance.law.name,
        "volts_per_full_scale": found.drive and _estimate(found.drive.volts),
        "matched": found.matched,
        "devices": devices and asdict(devices),
        "recordings": [_quality(one) for one in found.qualities],
    }


def _estimate(estimate: Estimate) -> dict[str, object]:
    return {"value": estimate.value, "interval": estimate.interval}


def _quality(one: Quality) -> dict[str, object]:
    return {
        "reference": one.names[0],
        "response": one.names[1],
        "coherence": one.coherence,
        "low_coherence_hz": one.low_hz,
        "distortion": [
            asdict(h) | ({} if h.largest_share else {"at_hz": None}) for h in one.harmonics
        ],
    }


def table(found: Calibration, devices: Devices | None) -> str:
    """Return the result as text for people."""
    rows = [
        f"{parameter:<32} {estimate.value:>12.5g}   {estimate.low:.5g} to {estimate.high:.5g}"
        for parameter, estimate in found.values.items()
    ]
    if found.impedance:
        rows.append(COILS[found.impedance.law.name])
    if found.drive:
        volts = found.drive.volts
        limits = f"({volts.low:.4g} to {volts.high:.4g})"
        rows.append(f"full scale gives {volts.value:.4g} V without a load {limits}")
    if found.driven:
        rows += _mode(found.driven, found)
    rows += map(_line, found.qualities)
    if found.level_of_x_max is not None:
        rows.append(f"swept at {found.level_of_x_max:.3f} Xmax; intervals are of 95 %")
    else:
        rows.append(
            f"swept at {found.sweep.level:.3g} of full scale; the excursion is not known, so the "
            "intervals of 95 % do not include the shift by the level"
        )
    if devices:
        rows.append(
            f"{devices.output} to {devices.input}: {1e3 * devices.delay_s:.1f} ms later, clocks "
            f"{devices.drift_ppm:+.1f} ppm apart"
        )
    return "\n".join(rows)


def _mode(mode: Mode, found: Calibration) -> list[str]:
    f0, q, s = mode.f0_hz, mode.q, mode.sensitivity
    row = f"driven by its amplifier: {f0.value:.2f} Hz, Q {q.value:.2f}"
    if found.mode or found.impedance:
        return [row]
    row += f" ({f0.low:.3f} to {f0.high:.3f} Hz, Q {q.low:.3f} to {q.high:.3f})"
    if found.level_of_x_max is None:
        return [row, "no sensitivity: the accelerometer's own was not given"]
    measured = {one.names for one in found.qualities}
    unit = "V" if ("voltage", "acceleration") in measured else "full scale"
    limits = f"({s.low:.4g} to {s.high:.4g})"
    return [row, f"sensitivity above the resonance: {s.value:.4g} m/s² per {unit} {limits}"]


def _line(one: Quality) -> str:
    line = f"{one.names[1]} for {one.names[0]}: coherence {one.coherence:.4f}"
    if one.low_hz:
        ends = ", ".join(f"{low:.0f}-{high:.0f}" for low, high in one.low_hz[:4])
        more = " and more" if len(one.low_hz) > 4 else ""
        line += f", below {LOW_COHERENCE} at {ends}{more} Hz"
    orders = [
        f"{h.order}: {100 * h.largest_share:.2g} % at {h.at_hz:.0f} Hz"
        for h in one.harmonics
        if h.largest_share
    ]
    return f"{line}; distortion by order {', '.join(orders) or 'below the noise'}"
