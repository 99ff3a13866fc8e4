"""Which parameters of different stages, each allowed by itself, cannot be of one rig."""

import math
from typing import Any

from device.rig.parameters import (
    AccelerometerParameters,
    ActuatorParameters,
    AmplifierParameters,
    ConditioningParameters,
    DaqParameters,
)


def contradictions(stages: dict[str, Any]) -> list[str]:
    """What values of different stages contradict one another; absent stages contradict none."""
    get = stages.get
    actuator, amplifier, dac = get("actuator"), get("amplifier"), get("dac")
    large, accelerometer = get("large_signal"), get("accelerometer")
    conditioning, daq = get("conditioning"), get("daq")
    wrong = []
    if actuator and large and large.stop_m <= actuator.x_max_m:
        wrong.append(
            f"large_signal.stop_m={large.stop_m!r} must be above "
            f"actuator.x_max_m={actuator.x_max_m!r}, where the linear range ends"
        )
    if actuator:
        for name in ("amplifier", "conditioning"):
            stage = get(name)
            if stage and not stage.low_cut_hz < actuator.resonance_hz < stage.high_cut_hz:
                wrong.append(
                    f"actuator.resonance_hz={actuator.resonance_hz!r} must be inside the band of "
                    f"{name}, {stage.low_cut_hz!r} to {stage.high_cut_hz!r} Hz"
                )
    if actuator and amplifier:
        wrong += _against_the_drive_mode(actuator, amplifier)
    if actuator and accelerometer and accelerometer.resonance_hz < 5 * actuator.resonance_hz:
        wrong.append(
            f"accelerometer.resonance_hz={accelerometer.resonance_hz!r} must be at least five "
            f"times actuator.resonance_hz={actuator.resonance_hz!r}: choose a lighter one"
        )
    if dac and amplifier:
        step_v = amplifier.gain * dac.full_scale_v / 2.0 ** (dac.bits - 1)
        if amplifier.output_limit_v <= step_v:
            wrong.append(
                f"amplifier.output_limit_v={amplifier.output_limit_v!r} must be above one step "
                f"of the DAC after the gain, {step_v:.3g} V"
            )
    wrong += _below_the_noise(accelerometer, conditioning, daq)
    return wrong


def _against_the_drive_mode(a: ActuatorParameters, amplifier: AmplifierParameters) -> list[str]:
    ratio = amplifier.source_impedance_ohm / a.resistance_ohm
    words = (
        f"amplifier.drive_mode={amplifier.drive_mode!r} contradicts "
        f"source_impedance_ohm={amplifier.source_impedance_ohm!r}, {ratio:.3g} times "
        "actuator.resistance_ohm"
    )
    # Ten times the coil's resistance takes away nine tenths of the electrical damping.
    if amplifier.drive_mode == "current" and ratio < 10.0:
        return [f"{words}: at least 10 times makes a current drive"]
    if amplifier.drive_mode == "voltage" and ratio >= 10.0:
        return [f"{words}: that is a current drive"]
    return []


def _below_the_noise(
    accelerometer: AccelerometerParameters | None,
    conditioning: ConditioningParameters | None,
    daq: DaqParameters | None,
) -> list[str]:
    wrong = []
    if conditioning:
        noise_v = conditioning.noise_pc * conditioning.gain_v_per_pc
        for name, limit_v in (
            ("conditioning.output_limit_v", conditioning.output_limit_v),
            ("daq.range_v", daq.range_v if daq else math.inf),
        ):
            if limit_v <= noise_v:
                wrong.append(
                    f"{name}={limit_v!r} must be above the noise of the conditioning amplifier, "
                    f"{noise_v:.3g} V r.m.s.: lower its gain"
                )
        if accelerometer:
            charge_pc = accelerometer.limit_m_s2 * accelerometer.sensitivity_pc_per_m_s2
            if charge_pc <= conditioning.noise_pc:
                wrong.append(
                    f"accelerometer.limit_m_s2={accelerometer.limit_m_s2!r} gives "
                    f"{charge_pc:.3g} pC, which must be above "
                    f"conditioning.noise_pc={conditioning.noise_pc!r}"
                )
    if daq and daq.range_v <= daq.noise_v:
        wrong.append(f"daq.range_v={daq.range_v!r} must be above daq.noise_v={daq.noise_v!r}")
    return wrong
