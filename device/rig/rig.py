"""A rig: the parameters of its stages, the source of each value, and its TOML file.

    [actuator]
    resonance_hz = { value = 90.0, given = "the paper: about 90 Hz" }
    q_mechanical = { value = 8.0, assumed = "a rubber suspension" }
    force_factor_n_per_a = { value = 9.8, measured = "impedance", interval = [9.6, 10.0] }
    inductance_h = 1e-3

Each stage is a table with the name of a field of `Rig`. The source of a value may be omitted.
`[actuator]` may also contain derived values (`DERIVED`), which must agree with the other values.
"""

import difflib
import math
import tomllib
from collections.abc import Iterable
from dataclasses import MISSING, dataclass, field, fields
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, get_args

from device.errors import UsageError
from device.rig import parameters
from device.rig.parameters import Stage

SourceKind = Literal["given", "assumed", "measured", "identified"]
SOURCE_KINDS: tuple[SourceKind, ...] = get_args(SourceKind)

MIN_CURRENT_DRIVE_RATIO = 10.0  # least source impedance / coil resistance of a current drive


@dataclass(frozen=True)
class Source:
    """The source of one parameter's value."""

    parameter: str  # "stage.name"
    kind: SourceKind  # given: by a paper or datasheet; identified: by a fit to a measurement
    words: str  # the paper, the reason or the method
    interval: tuple[float, float] | None = None  # 95 % confidence, in the parameter's unit


@dataclass(frozen=True)
class Rig:
    """All stages between vibration signal and seat, and from the accelerometer to the DAQ.

    name: the rig's name, from its file. dac, amplifier, actuator, large_signal, thermal: see their
    classes. seat, accelerometer, conditioning, daq: see their classes. sources: one for each value
    with a stated source. UsageError: values contradict one another.
    """

    name: str
    dac: parameters.DacParameters
    amplifier: parameters.AmplifierParameters
    actuator: parameters.ActuatorParameters
    large_signal: parameters.LargeSignalParameters | None = None
    thermal: parameters.ThermalParameters | None = None
    seat: parameters.SeatParameters | None = None
    accelerometer: parameters.AccelerometerParameters | None = None
    conditioning: parameters.ConditioningParameters | None = None
    daq: parameters.DaqParameters | None = None
    sources: tuple[Source, ...] = field(default=(), repr=False, compare=False)

    def __post_init__(self) -> None:
        if wrong := find_contradictions(self.stages()):
            raise UsageError(f"rig {self.name!r}: {'; '.join(wrong)}; correct the rig")

    def stages(self) -> dict[str, Any]:
        """Return the parameters of the existing stages by name, in signal order."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: stage for name, stage in named.items() if isinstance(stage, Stage)}

    def assumed(self) -> tuple[str, ...]:
        """Return the parameters with assumed values, as "stage.name"."""
        return tuple(source.parameter for source in self.sources if source.kind == "assumed")


def find_contradictions(stages: dict[str, Any]) -> list[str]:
    """Return the contradictions between the stages' values; missing stages are ignored."""
    names = ("dac", "amplifier", "actuator", "large_signal", "accelerometer", "conditioning", "daq")
    dac, amplifier, actuator, large, accelerometer, conditioning, daq = map(stages.get, names)
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


SUFFIX = ".toml"
SHIPPED = ("paper", "consumer")
_NAMES = ", ".join(SHIPPED)

STAGES: dict[str, type[Stage]] = {
    stage.name: kind
    for stage in fields(Rig)
    for kind in (stage.type, *get_args(stage.type))
    if isinstance(kind, type) and issubclass(kind, Stage)
}
DERIVED = ("stiffness_n_per_m", "damping_n_s_per_m", "q_electrical", "q_total")
AGREEMENT = 0.02  # relative tolerance of derived values, which usually have two or three digits


def read_rig(path: str | Path) -> Rig:
    """Return the rig of a TOML file. The rig's default name is the file's name without .toml.

    path: the file. UsageError: it cannot be read, or values are wrong; the message names them all.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not text in UTF-8"
        raise UsageError(
            f"cannot read the rig file {path}: {reason}; check it, or choose one of: {_NAMES}"
        ) from None
    return parse_rig(text, path.stem, str(path))


def parse_rig(text: str, name: str, origin: str) -> Rig:
    """Return the rig that a TOML text describes.

    name: the rig's name, unless the text states another. origin: source of the text, for error
    messages. UsageError: as for `read_rig`.
    """
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"the rig file {origin} is not TOML: {error}; correct it") from None
    reading = _Reading()
    stages = reading.read(document)
    stated = document.get("name", name)
    if not (isinstance(stated, str) and stated):
        reading.wrong.append(f"name={stated!r} must be a word")
    reading.wrong += find_contradictions(stages)
    if reading.wrong:
        raise UsageError(f"the rig file {origin}: {'; '.join(reading.wrong)}; correct the file")
    return Rig(name=stated, sources=tuple(reading.sources), **stages)


@dataclass
class _Reading:
    """The sources and problems found in one file."""

    wrong: list[str] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)

    def read(self, document: dict[str, Any]) -> dict[str, Any]:
        self._refuse_unknown("", document, [*STAGES, "name", "description"])
        stages: dict[str, Any] = {}
        for name, kind in STAGES.items():
            if name not in document:
                if name in ("dac", "amplifier", "actuator"):
                    self.wrong.append(f"[{name}] is missing")
            elif not isinstance(document[name], dict):
                self.wrong.append(f"{name}={document[name]!r} must be a table, [{name}]")
            elif stage := self._stage(name, kind, document[name]):
                stages[name] = stage
        return stages

    def _stage(self, name: str, kind: type[Stage], table: dict[str, Any]) -> Stage | None:
        before = len(self.wrong)
        known = {f.name: f for f in fields(kind)}  # type: ignore[arg-type]
        following = DERIVED if name == "actuator" else ()
        every = [*known, *following]
        self._refuse_unknown(f"{name}.", table, every)
        values = {k: self._value(f"{name}.{k}", table[k]) for k in every if k in table}
        for key, description in known.items():
            if key not in values and description.default is MISSING:
                self.wrong.append(f"{name}.{key} is missing")
        stated = {key: values.pop(key) for key in following if key in values}
        self.wrong += [f"{name}.{problem}" for problem in kind.problems(values)]
        if len(self.wrong) > before:
            return None
        are_floats = {key: get_args(known[key].type)[0] is float for key in values}
        stage = kind(**{k: float(v) if are_floats[k] else v for k, v in values.items()})
        for key, value in stated.items():
            follows = getattr(stage, key)
            follows = follows() if callable(follows) else follows
            if not (isinstance(value, float) and abs(value / follows - 1.0) <= AGREEMENT):
                self.wrong.append(
                    f"actuator.{key}={value!r} contradicts the rest, from which {follows:.4g} "
                    "follows: correct one of them, or leave it out"
                )
        return stage

    def _value(self, parameter: str, stated: object) -> Any:
        """Return the bare value and store its source, if there is one."""
        if not isinstance(stated, dict):
            return stated
        value, interval = stated.get("value", math.nan), stated.get("interval")
        kinds = [kind for kind in SOURCE_KINDS if kind in stated]
        unknown = set(stated) - {"value", "interval", *SOURCE_KINDS}
        if "value" not in stated or len(kinds) != 1 or unknown:
            self.wrong.append(
                f"{parameter} must be a number or {{ value = ..., KIND = 'why' }} with one KIND "
                f"of {', '.join(SOURCE_KINDS)}"
            )
            return value
        bounds = None
        if interval is not None and not (bounds := _interval_around(value, interval)):
            self.wrong.append(f"{parameter}: interval={interval!r} must be [low, high] around it")
        self.sources.append(Source(parameter, kinds[0], str(stated[kinds[0]]), bounds))
        return value

    def _refuse_unknown(self, prefix: str, table: Iterable[str], known: list[str]) -> None:
        for key in table:
            if key not in known:
                near = difflib.get_close_matches(key, known, 1)
                hint = f", did you mean {near[0]}?" if near else ""
                self.wrong.append(f"{prefix}{key} is unknown{hint}")


def _interval_around(value: Any, interval: Any) -> tuple[float, float] | None:
    try:
        low, high = interval
        return (float(low), float(high)) if low <= value <= high else None
    except (TypeError, ValueError):
        return None


def _shipped(name: str) -> Rig:
    text = files("device.rig").joinpath(name + SUFFIX).read_text(encoding="utf-8")
    return parse_rig(text, name, f"{name}{SUFFIX} of this package")


_RIGS = {name: _shipped(name) for name in SHIPPED}
PAPER, CONSUMER = _RIGS["paper"], _RIGS["consumer"]


def rig_by_name(name: str) -> Rig:
    """Return a rig. name: of a built-in rig, or a path in .toml. UsageError: missing or invalid."""
    if name in _RIGS:
        return _RIGS[name]
    if name.endswith(SUFFIX):
        return read_rig(name)
    raise UsageError(f"no rig is named {name!r}; choose one of: {_NAMES}; or a file, NAME{SUFFIX}")
