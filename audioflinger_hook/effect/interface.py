"""What an effect is to the framework: a descriptor, `process` and `command`.

Codes, flags and status values are those of Android's effect interface (audio_effect.h), so that
somebody who knows AudioFlinger recognises them.
"""

from __future__ import annotations

import errno
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from types import NoneType
from typing import Protocol
from uuid import UUID

from audioflinger_hook.effect.parameters import Parameter
from audioflinger_hook.mixer.mix_buffer import MixBuffer

OK = 0
EINVAL = -errno.EINVAL
ENODATA = -errno.ENODATA
ENOSYS = -errno.ENOSYS
"""Return values of `process` and `command`; ENODATA from `process`: the tail has ended."""


class EffectFlag(IntFlag):
    """What kind an effect is, where in a chain it wants to stand, what it is told; combine by |.

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
    """What a framework may ask of an engine."""

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
    """How an effect writes its output: over the buffer's samples, or added to them."""

    WRITE = 1
    ACCUMULATE = 2


@dataclass(frozen=True)
class VendorCommand:
    """A command of an effect's own: its code from FIRST_PROPRIETARY up, and the type of its data.

    takes: `NoneType` for a command without data. Nothing else reaches the engine.
    """

    code: int
    name: str
    takes: type = NoneType


@dataclass(frozen=True)
class EffectDescriptor:
    """Who an effect is, and everything that it may be asked.

    type_uuid: what it does, shared by all implementations; uuid: this implementation;
    cpu_load in 0.1 MIPS, memory_kb in KB, as Android counts them. parameters, vendor_commands:
    all there are; the framework refuses any other before the engine sees it.
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
    """What SET_CONFIG carries: the stream that `process` will see, up to `frames` at a time."""

    samplerate: int
    channels: int
    haptic_channels: int
    frames: int
    access: Access = Access.WRITE


class EffectEngine(Protocol):
    """One instance of one effect, made by its library, held by one chain."""

    @property
    def descriptor(self) -> EffectDescriptor:
        """Who it is; constant."""
        ...

    def process(self, source: MixBuffer, target: MixBuffer) -> int:
        """Treat one buffer; both may be the same object. Returns OK or ENODATA (tail ended).

        With Access.WRITE target is overwritten, with ACCUMULATE added to. The arrays are lent
        for the call: their contents may be changed, nothing else. Called by the thread that
        steps the mixer, which must not wait.
        """
        ...

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Carry out a command and return its status and reply.

        Status: OK, EINVAL, ENODATA (nothing to reply with) or ENOSYS (not supported). data by
        code: SET_CONFIG an EffectConfig; SET_PARAM and SET_PARAM_DEFERRED a (name, value) pair;
        GET_PARAM a name, replied with the value; SET_VOLUME a tuple of gains; DUMP none, replied
        with text; vendor codes as the descriptor says. INIT begins anew, but parameters keep
        what was set. Called by the thread that steps the mixer, between two buffers.
        """
        ...
