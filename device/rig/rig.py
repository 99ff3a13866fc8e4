"""A rig: the parameters of its stages, and where each value comes from."""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

from device.errors import UsageError
from device.rig.parameters import (
    AccelerometerParameters,
    ActuatorParameters,
    AmplifierParameters,
    ConditioningParameters,
    DacParameters,
    DaqParameters,
    LargeSignalParameters,
    SeatParameters,
    Stage,
    ThermalParameters,
)

SourceKind = Literal["given", "assumed", "measured", "identified"]
SOURCE_KINDS: tuple[SourceKind, ...] = get_args(SourceKind)


@dataclass(frozen=True)
class Source:
    """Where the value of one parameter comes from.

    parameter: "stage.name"; kind: given (by a paper or a datasheet), assumed, measured, or
    identified (by a fit to a measurement); words: by whom, why or how; interval: of 95 % for what
    was measured or identified, in the parameter's unit.
    """

    parameter: str
    kind: SourceKind
    words: str
    interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class Rig:
    """One chain from the vibration signal to the seat and back, under a name.

    sources: one for every value whose file says where it comes from.

    Raises
    ------
    UsageError
        Values of different stages contradict one another; all of them are named.
    """

    name: str
    dac: DacParameters
    amplifier: AmplifierParameters
    actuator: ActuatorParameters
    large_signal: LargeSignalParameters | None = None
    thermal: ThermalParameters | None = None
    seat: SeatParameters | None = None
    accelerometer: AccelerometerParameters | None = None
    conditioning: ConditioningParameters | None = None
    daq: DaqParameters | None = None
    sources: tuple[Source, ...] = field(default=(), repr=False, compare=False)

    def __post_init__(self) -> None:
        wrong = contradictions(self.stages())
        if wrong:
            raise UsageError(f"rig {self.name!r}: {'; '.join(wrong)}; correct the rig")

    def stages(self) -> dict[str, Any]:
        """Parameters by the name of the stage, in the order of the flow; without absent ones."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: stage for name, stage in named.items() if isinstance(stage, Stage)}

    def assumed(self) -> tuple[str, ...]:
        """The parameters, as "stage.name", whose values nobody gave or measured."""
        return tuple(source.parameter for source in self.sources if source.kind == "assumed")


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
