"""A rig: the parameters of its stages, and the source of each value."""

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

MIN_CURRENT_DRIVE_RATIO = 10.0
"""Ten times the coil's resistance removes nine tenths of the electrical damping."""


@dataclass(frozen=True)
class Source:
    """The source of one parameter's value."""

    parameter: str  # "stage.name"
    kind: SourceKind  # given: by a paper or datasheet; identified: by a fit to a measurement
    words: str  # by whom, why or how
    interval: tuple[float, float] | None = None  # 95 %, in the parameter's unit


@dataclass(frozen=True)
class Rig:
    """One chain from the vibration signal to the seat and back, under a name.

    name: what `--rig` takes. dac, amplifier, actuator: always there, the actuator near its rest
    position. large_signal: its behaviour towards Xmax and beyond. thermal: how its coil warms up.
    seat: frame, cushion and sitter. accelerometer, conditioning, daq: sensor at the seat, its
    charge amplifier, and the data-acquisition input. sources: one for each value whose origin the
    file states.
    UsageError: values of different stages contradict one another; the message names all of them.
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
        if wrong := find_contradictions(self.stages()):
            raise UsageError(f"rig {self.name!r}: {'; '.join(wrong)}; correct the rig")

    def stages(self) -> dict[str, Any]:
        """Return the parameters by the stage's name, in signal order, without absent stages."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: stage for name, stage in named.items() if isinstance(stage, Stage)}

    def assumed(self) -> tuple[str, ...]:
        """Return the parameters, as "stage.name", whose values are assumed."""
        return tuple(source.parameter for source in self.sources if source.kind == "assumed")


def find_contradictions(stages: dict[str, Any]) -> list[str]:
    """Return what values of different stages contradict one another; absent stages are ignored."""
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
        for name, stage in (("amplifier", amplifier), ("conditioning", conditioning)):
            if stage and not stage.low_cut_hz < actuator.resonance_hz < stage.high_cut_hz:
                wrong.append(
                    f"actuator.resonance_hz={actuator.resonance_hz!r} must be inside the band of "
                    f"{name}, {stage.low_cut_hz!r} to {stage.high_cut_hz!r} Hz"
                )
    if actuator and amplifier:
        ratio = amplifier.source_impedance_ohm / actuator.resistance_ohm
        if (amplifier.drive_mode == "current") != (ratio >= MIN_CURRENT_DRIVE_RATIO):
            wrong.append(
                f"amplifier.drive_mode={amplifier.drive_mode!r} contradicts "
                f"source_impedance_ohm={amplifier.source_impedance_ohm!r}, {ratio:.3g} times "
                "actuator.resistance_ohm: at least 10 times makes a current drive"
            )
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
