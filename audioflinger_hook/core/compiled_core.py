"""The compiled core, and one stream of it."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_size_t, c_uint64
from functools import lru_cache
from typing import Any

import numpy as np

from audioflinger_hook.core import library_path
from audioflinger_hook.core.structures import (
    GLIDE_COLUMNS,
    STRUCTURES,
    Controls,
    Info,
    Readings,
    Sound,
)
from device.errors import InternalError, NotFoundError
from device.extension import refuse_cut_off
from device.units import Float32Array, FloatArray

GLIDE_NUMBERS = len(GLIDE_COLUMNS)

_address = ctypes.c_void_p
_Nothing = ctypes.c_char * 0


@lru_cache(maxsize=1)
def library() -> ctypes.PyDLL:
    """Return the compiled core.

    It keeps the interpreter's lock: a call is shorter than waiting for the lock would be.
    NotFoundError: it is not built, or damaged, or of another version.
    """
    path = library_path()
    if path is None:
        raise NotFoundError("the compiled core is missing; run `make run` with a C compiler")
    try:
        refuse_cut_off(path)
        found = ctypes.PyDLL(str(path))
        sizes = tuple((c_uint64 * len(STRUCTURES)).in_dll(found, "core_sizes"))
        _declare(found)
    except (ImportError, OSError, ValueError) as error:
        raise NotFoundError(f"the compiled core cannot be loaded: {error}") from error
    except AttributeError:  # it lacks a function
        sizes = ()
    if sizes != tuple(map(ctypes.sizeof, STRUCTURES)):
        raise NotFoundError(f"{path} is of another version; run `make run`")
    return found


def _declare(found: ctypes.PyDLL) -> None:
    found.core_check.restype = c_char_p
    found.core_check.argtypes = [_address, c_size_t, POINTER(Info)]
    found.core_open.restype, found.core_open.argtypes = _address, [_address, c_size_t, _address]
    found.core_reset.restype, found.core_reset.argtypes = None, [_address, c_int]
    found.core_process.restype = None
    found.core_process.argtypes = [_address, _address, Sound, _address, c_size_t, _address]
    found.core_vibrate.restype = None
    found.core_vibrate.argtypes = [_address, Sound, _address, c_size_t, _address]
    found.core_state.restype, found.core_state.argtypes = c_size_t, [_address, _address, c_size_t]
    found.core_set_state.restype = c_int
    found.core_set_state.argtypes = [_address, _address, c_size_t]
    found.core_glides_max.restype = c_size_t
    found.core_glides_max.argtypes = [_address, c_size_t]
    found.core_record.restype, found.core_record.argtypes = c_size_t, [_address, _address, c_size_t]


class Core:
    """One stream: sound in, the signals of actuators out.

    One thread calls `process` and `reset`; any thread may write `controls` and read `readings`.

    design: bytes of `core_design`.
    info: what the design is for. outputs: columns of what `process` returns.
    InternalError: the design cannot be used. NotFoundError: the core is not built.
    """

    def __init__(self, design: bytes) -> None:
        self._library = library()
        self._design = np.frombuffer(design, np.uint8).copy()  # at a multiple of 16
        self.info, self.controls, self.readings = Info(), Controls(sound_gain=1.0), Readings()
        place = self._design.ctypes.data
        misfit = self._library.core_check(place, len(design), self.info)
        if misfit:
            raise InternalError(f"the design cannot be used: {misfit.decode()}")
        for actuator in self.controls.actuators:
            actuator.gain, actuator.audible = 1.0, 1
        self.outputs = self.info.actuators or self.info.vibrations
        self._memory = np.zeros(self.info.memory_bytes // 16 + 1, np.complex128)
        self._glides: FloatArray = np.empty((0, GLIDE_NUMBERS))
        self._core = self._library.core_open(place, len(design), self._memory.ctypes.data)
        self._controls = ctypes.addressof(self.controls)
        self._readings = ctypes.addressof(self.readings)
        self._signals = _Room(self.outputs, np.dtype(np.float32))
        self._vibration = _Room(self.info.vibrations, np.dtype(np.float64))

    def process(self, sound: Float32Array | FloatArray) -> Float32Array:
        """Return as many frames of each output, (frames, outputs), as of sound, (frames, inputs).

        sound: float32 or float64, of any strides.
        """
        samples, room, frames = self._samples(sound), self._signals, len(sound)
        out = room.address(frames)
        self._library.core_process(self._core, self._controls, samples, out, frames, self._readings)
        return room.array[:frames].copy()

    def vibrate(self, sound: Float32Array | FloatArray) -> FloatArray:
        """Return what the transform alone makes of sound, (frames, vibrations), float64."""
        samples, room, frames = self._samples(sound), self._vibration, len(sound)
        out = room.address(frames)
        self._library.core_vibrate(self._core, samples, out, frames, self._readings)
        return room.array[:frames].copy()

    def _samples(self, sound: Float32Array | FloatArray) -> Sound:
        is_double = sound.dtype == np.float64
        if sound.ndim != 2 or sound.shape[1] != self.info.inputs:
            raise InternalError(
                f"a block has shape {sound.shape}: (frames, {self.info.inputs}) was expected"
            )
        if not (is_double or sound.dtype == np.float32) or not sound.flags.aligned:
            raise InternalError(
                f"a block has samples of {sound.dtype}; allowed: aligned float32, float64"
            )
        strides = sound.strides
        return Sound(_address_of(sound), strides[0], strides[1], is_double)

    @property
    def state(self) -> bytes:
        """What changes as a stream goes on; may be set to that of a like core.

        InternalError: it is set to what no core with this design can have; then it is reset.
        """
        size = self._library.core_state(self._core, None, 0)
        state = ctypes.create_string_buffer(size)
        self._library.core_state(self._core, state, size)
        return state.raw

    @state.setter
    def state(self, state: bytes) -> None:
        if not self._library.core_set_state(self._core, state, len(state)):
            raise InternalError("no core with this design can have that state")

    @property
    def partials(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop vibrates: Hz of the sound, Hz of vibration, amplitude. Any thread."""
        found = self.readings
        return tuple((row[0], row[1], row[2]) for row in found.partials[: found.partials_count])

    def record_glides(self, frames: int) -> FloatArray:
        """Return the glides since the last call, (glides, 9), and have room for more frames."""
        kept, self._glides = (
            self._glides,
            np.empty((self._library.core_glides_max(self._core, frames), GLIDE_NUMBERS)),
        )
        written = self._library.core_record(self._core, self._glides.ctypes.data, len(self._glides))
        return kept[:written]

    def reset(self, *, doses_too: bool = False) -> None:
        """Return to rest; temperatures and doses stay unless asked."""
        self._library.core_reset(self._core, doses_too)
        self.readings.partials_count = 0


class _Room:
    """Memory for what a call writes, which grows with the largest block. array: all of it."""

    def __init__(self, columns: int, dtype: np.dtype[Any]) -> None:
        self.array = np.empty((0, columns), dtype)
        self._at = 0

    def address(self, frames: int) -> int:
        """Return where so many frames fit."""
        if frames > len(self.array) or not self._at:
            self.array = np.empty((max(frames, 1), self.array.shape[1]), self.array.dtype)
            self._at = self.array.ctypes.data
        return self._at


def _address_of(samples: Float32Array | FloatArray) -> int:
    """Return where samples lie. A buffer gives it in a sixth of the time that `ctypes` takes."""
    flags = samples.flags
    if flags.c_contiguous and flags.writeable:
        return ctypes.addressof(_Nothing.from_buffer(samples.data))
    return int(samples.ctypes.data)
