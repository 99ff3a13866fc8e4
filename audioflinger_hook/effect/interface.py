"""Interface between the framework and an effect: a descriptor, `process` and `command`.

Commands, flags and status values are numbered as in Android's audio_effect.h.
"""

import errno
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from types import NoneType
from typing import Protocol, cast
from uuid import UUID

from audioflinger_hook.mixer.mix_buffer import MixBuffer

Value = bool | int | float | str  # NumPy scalars are not allowed
Values = Mapping[str, Value]

KINDS: dict[type, tuple[type, ...]] = {bool: (bool,), int: (int,), float: (float, int), str: (str,)}
"""Accepted Python types for each kind of parameter. Subclasses do not match, so True is no int."""


@dataclass(frozen=True)
class Parameter:
    """One parameter with its allowed values.

    kind: `bool`, `int`, `float` or `str`. low, high: inclusive range of a number in `unit`.
    choices: allowed strings; if empty, all strings are allowed. default: None if read-only.
    """

    name: str
    kind: type
    default: Value | None = None
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    unit: str = ""
    meaning: str = ""

    @property
    def read_only(self) -> bool:
        """Whether SET_PARAM is refused."""
        return self.default is None

    def accepts(self, value: object) -> bool:
        """Return whether a value of any type is valid for the parameter; never raises."""
        if type(value) not in KINDS.get(self.kind, ()):
            return False
        if isinstance(value, str):
            return not self.choices or value in self.choices
        # The comparison is False for NaN.
        return isinstance(value, bool) or self.low <= cast(float, value) <= self.high

    def __str__(self) -> str:
        if self.kind is bool:
            allowed = "true or false"
        elif self.kind is str:
            allowed = ", ".join(self.choices) or "any text"
        else:
            allowed = f"{self.low:g} to {self.high:g} {self.unit}".rstrip()
        return f"{self.name} ({'read only' if self.read_only else allowed})"


OK = 0
EINVAL = -errno.EINVAL
ENODATA = -errno.ENODATA
ENOSYS = -errno.ENOSYS
"""Status values of `process` and `command`. ENODATA from `process` says that the tail has ended."""


class EffectFlag(IntFlag):
    """Kind of an effect, its place in the chain and the events that it receives.

    SET_VOLUME needs a VOLUME_* flag; SET_DEVICE needs a flag of DEVICE_MASK.
    """

    INSERT = 0x0
    AUXILIARY = 0x1
    REPLACE = 0x2
    PRE_PROC = 0x3
    POST_PROC = 0x4
    TYPE_MASK = 0x7
    INSERT_ANY = 0x0
    INSERT_FIRST = 0x8
    INSERT_LAST = 0x10
    INSERT_EXCLUSIVE = 0x18
    INSERT_MASK = 0x38
    VOLUME_CTRL = 0x40
    VOLUME_IND = 0x80
    VOLUME_MONITOR = 0xC0
    VOLUME_MASK = 0x1C0
    DEVICE_IND = 0x200
    DEVICE_MASK = 0xE00


class Command(IntEnum):
    """Commands from the framework to an engine."""

    INIT = 0
    SET_CONFIG = 1
    RESET = 2
    ENABLE = 3
    DISABLE = 4
    SET_PARAM = 5
    SET_PARAM_DEFERRED = 6
    SET_PARAM_COMMIT = 7
    GET_PARAM = 8
    SET_DEVICE = 9
    SET_VOLUME = 10
    SET_AUDIO_MODE = 11
    SET_CONFIG_REVERSE = 12
    SET_INPUT_DEVICE = 13
    GET_CONFIG = 14
    GET_CONFIG_REVERSE = 15
    GET_FEATURE_SUPPORTED_CONFIGS = 16
    GET_FEATURE_CONFIG = 17
    SET_FEATURE_CONFIG = 18
    SET_AUDIO_SOURCE = 19
    OFFLOAD = 20
    DUMP = 21
    FIRST_PROPRIETARY = 0x10000


# how an effect writes its output: WRITE overwrites samples, ACCUMULATE adds to them
Access = IntEnum("Access", "WRITE ACCUMULATE")


@dataclass(frozen=True)
class VendorCommand:
    """A vendor-specific command. code: FIRST_PROPRIETARY or higher. takes: type of its data."""

    code: int
    name: str
    takes: type = NoneType


@dataclass(frozen=True)
class EffectDescriptor:
    """Identity, parameters and vendor commands of an effect.

    The framework refuses parameters and vendor commands that are not listed here.

    type_uuid: identifies the kind of effect; all implementations of this kind share it. uuid:
    identifies this implementation. cpu_load: computing load in 0.1 MIPS, as on Android.
    """

    type_uuid: UUID
    uuid: UUID
    name: str
    implementor: str
    flags: EffectFlag = EffectFlag.INSERT
    api_version: int = 0x0002_0000
    cpu_load: int = 0
    memory_kb: int = 0
    parameters: tuple[Parameter, ...] = ()
    vendor_commands: tuple[VendorCommand, ...] = ()


@dataclass(frozen=True)
class EffectConfig:
    """Data of SET_CONFIG: the stream's format. samplerate: Hz. frames: largest buffer size."""

    samplerate: int
    channels: int
    haptic_channels: int
    frames: int
    access: Access = Access.WRITE


class EffectEngine(Protocol):
    """One instance of an effect in one chain."""

    @property
    def descriptor(self) -> EffectDescriptor:
        """The constant descriptor of the effect."""

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Process one buffer. Return OK, or ENODATA if a disabled effect has no output left.

        With Access.WRITE, overwrite the samples of `target`, which may be `source`. With
        Access.ACCUMULATE, add the output to these samples. Do not replace the arrays of a buffer.
        Do not block the mixer's thread.
        """

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Execute a command between two buffers and return (status, reply).

        The status is OK, EINVAL, ENODATA (no reply) or ENOSYS (not supported).

        - The data of SET_CONFIG is an EffectConfig.
        - The data of SET_PARAM and SET_PARAM_DEFERRED is a (name, value) pair.
        - The data of GET_PARAM is a name; the reply is the value.
        - The data of SET_VOLUME is a tuple of gains from 0 to 1.
        - DUMP replies with text.
        - INIT resets the engine and keeps its parameters.
        - The data of vendor commands has the type `VendorCommand.takes`.
        """


@dataclass(frozen=True)
class EffectLibrary:
    """A library of effects.

    name: identifies the library in audio_effects.xml.
    effects: descriptor and factory of each effect.
    """

    name: str
    effects: tuple[tuple[EffectDescriptor, Callable[[], EffectEngine]], ...]
