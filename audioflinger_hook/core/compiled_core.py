"""The compiled core, and one stream of it."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_size_t, c_uint64
from functools import lru_cache

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

# What each function of core.h returns, and what it takes.
_FUNCTIONS = {
    "check": (c_char_p, (_address, c_size_t, POINTER(Info))),
    "open": (_address, (_address, c_size_t, _address)),
    "reset": (None, (_address, c_int)),
    "process": (None, (_address, _address, Sound, _address, c_size_t, _address)),
    "vibrate": (None, (_address, Sound, _address, c_size_t, _address)),
    "state": (c_size_t, (_address, _address, c_size_t)),
    "set_state": (c_int, (_address, _address, c_size_t)),
    "glides_max": (c_size_t, (_address, c_size_t)),
    "record": (c_size_t, (_address, _address, c_size_t)),
}


@lru_cache(maxsize=1)
def library() -> ctypes.PyDLL:
    """Return the compiled core, which keeps the interpreter's lock: waiting for it takes longer.

    NotFoundError: it is not built, or damaged, or of another version.
    """
    path = library_path()
    if path is None:
        raise NotFoundError("the compiled core is missing; run `make run` with a C compiler")
    try:
        refuse_cut_off(path)
        found = ctypes.PyDLL(str(path))
        sizes = tuple((c_uint64 * len(STRUCTURES)).in_dll(found, "core_sizes"))
        for name, (returned, taken) in _FUNCTIONS.items():
            function = getattr(found, f"core_{name}")
            function.restype, function.argtypes = returned, taken
    except (ImportError, OSError, ValueError) as error:
        raise NotFoundError(f"the compiled core cannot be loaded: {error}") from error
    except AttributeError:  # it lacks a function
        sizes = ()
    if sizes != tuple(map(ctypes.sizeof, STRUCTURES)):
        raise NotFoundError(f"{path} is of another version; run `make run`")
    return found


class Core:
    """One stream: sound in, the signals of actuators out.

    One thread calls the methods; any thread may write `controls` and read `readings`.

    design: bytes of `core_design`. outputs: columns of what `process` returns.
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

    def process(self, sound: Float32Array | FloatArray) -> Float32Array:
        """Return the outputs, (frames, outputs), for float32 or float64 sound, (frames, inputs)."""
        samples, out = self._samples(sound), np.empty((len(sound), self.outputs), np.float32)
        self._library.core_process(
            self._core, self._controls, samples, _address_of(out), len(sound), self._readings
        )
        return out

    def vibrate(self, sound: Float32Array | FloatArray) -> FloatArray:
        """Return what the transform alone makes of sound, (frames, vibrations), float64."""
        samples, out = self._samples(sound), np.empty((len(sound), self.info.vibrations))
        self._library.core_vibrate(
            self._core, samples, _address_of(out), len(sound), self._readings
        )
        return out

    def _samples(self, sound: Float32Array | FloatArray) -> Sound:
        if sound.ndim != 2 or sound.shape[1] != self.info.inputs:
            raise InternalError(
                f"a block has shape {sound.shape}: (frames, {self.info.inputs}) was expected"
            )
        if sound.dtype not in (np.float32, np.float64) or not sound.flags.aligned:
            raise InternalError(
                f"a block has samples of {sound.dtype}; allowed: aligned float32, float64"
            )
        return Sound(_address_of(sound), *sound.strides, sound.dtype == np.float64)

    @property
    def state(self) -> bytes:
        """What changes as a stream goes on; may be set to that of a core of the same design."""
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
        kept, rows = self._glides, self._library.core_glides_max(self._core, frames)
        self._glides = np.empty((rows, GLIDE_NUMBERS))
        written = self._library.core_record(self._core, self._glides.ctypes.data, rows)
        return kept[:written]

    def reset(self, *, doses_too: bool = False) -> None:
        """Return to rest; temperatures and doses stay unless asked."""
        self._library.core_reset(self._core, doses_too)
        self.readings.partials_count = 0


def _address_of(samples: Float32Array | FloatArray) -> int:
    """Return where samples lie. A buffer gives it in a sixth of the time that `ctypes` takes."""
    flags = samples.flags
    if flags.c_contiguous and flags.writeable:
        return ctypes.addressof(_Nothing.from_buffer(samples.data))
    return int(samples.ctypes.data)
