"""A rig: the parameters of its stages, and where each value comes from."""

from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

from device.errors import UsageError
from device.rig.contradictions import contradictions
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
