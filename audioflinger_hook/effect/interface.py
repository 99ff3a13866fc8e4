"""What an effect is to the framework: a descriptor, `process` and `command`.

Codes, flags and status values are those of Android's effect interface (audio_effect.h).
"""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from types import NoneType
from typing import Protocol, cast
from uuid import UUID

from audioflinger_hook.mixer.mix_buffer import MixBuffer

Value = bool | int | float | str
"""What a parameter may hold: plain Python values, no NumPy scalars."""

Values = Mapping[str, Value]

KINDS: dict[type, tuple[type, ...]] = {bool: (bool,), int: (int,), float: (float, int), str: (str,)}
"""Python types accepted for each kind of parameter. They must match exactly: True is no number."""


@dataclass(frozen=True)
class Parameter:
    """One parameter: kind `bool`, `int`, `float` or `str`, and its allowed values.

    low, high: the range of a number in `unit`, both included. choices: the strings allowed; if
    empty, every string is. default: None if the parameter can only be read.
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
        """Whether the parameter can only be read."""
        return self.default is None

    def accepts(self, value: object) -> bool:
        """Return whether the parameter may hold this value; never raises, whatever the value is."""
        if type(value) not in KINDS.get(self.kind, ()):
            return False
        if isinstance(value, str):
            return not self.choices or value in self.choices
        # False for NaN.
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
"""Return values of `process` and `command`; ENODATA from `process`: the tail has ended."""


class EffectFlag(IntFlag):
    """Kind of an effect, its place in the chain, and the events it receives; combine by |.

    SET_VOLUME goes only to an effect with one of VOLUME_*, SET_DEVICE only to one with DEVICE_IND.
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


class Access(IntEnum):
    """How an effect writes its output: it replaces the buffer's samples or adds to them."""

    WRITE = 1
    ACCUMULATE = 2


@dataclass(frozen=True)
class VendorCommand:
    """A vendor's command: its code, at least FIRST_PROPRIETARY, and the type of its data.

    takes: `NoneType` for a command without data; other types never reach the engine.
    """

    code: int
    name: str
    takes: type = NoneType


@dataclass(frozen=True)
class EffectDescriptor:
    """What identifies an effect, and its parameters and vendor commands.

    The framework refuses parameters and vendor commands that are not listed here.

    type_uuid: what the effect does, shared by all implementations. uuid: this implementation.
    cpu_load: load in 0.1 MIPS, as on Android. memory_kb: memory in KB, as on Android.
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
    """Data of SET_CONFIG: the format of the stream; a buffer has at most `frames` frames."""

    samplerate: int
    channels: int
    haptic_channels: int
    frames: int
    access: Access = Access.WRITE


class EffectEngine(Protocol):
    """One instance of one effect, made by its library, held by one chain."""

    @property
    def descriptor(self) -> EffectDescriptor:
        """The effect's descriptor, which never changes."""

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Treat one buffer; source and target may be one object. Return OK or ENODATA (tail ended).

        With Access.WRITE the target is overwritten, with ACCUMULATE the result is added to it. The
        arrays belong to the caller; only their contents may change. Called by the thread that steps
        the mixer, which must not wait.
        """

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Carry out a command and return its status and reply.

        Status: OK, EINVAL, ENODATA (nothing to reply with) or ENOSYS (not supported). Called by
        the thread that steps the mixer, between two buffers.

        - SET_CONFIG takes an EffectConfig.
        - SET_PARAM and SET_PARAM_DEFERRED take a (name, value) pair.
        - GET_PARAM takes a name and replies with the value.
        - SET_VOLUME takes a tuple of gains.
        - DUMP replies with text.
        - INIT resets the engine but keeps its parameters.
        - Vendor codes take what the descriptor says.
        """


@dataclass(frozen=True)
class EffectLibrary:
    """Effects of one package: each one's descriptor, and what makes an instance of it.

    name: what `path` in audio_effects.xml calls it.
    """

    name: str
    effects: tuple[tuple[EffectDescriptor, Callable[[], EffectEngine]], ...]
