"""Python interface of the compiled core."""

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_size_t, c_uint64
from functools import lru_cache
from typing import Any

import numpy as np

from audioflinger_hook.core import library_path, structures
from device.errors import InternalError, NotFoundError
from device.extension import refuse_cut_off
from device.units import Float32Array, FloatArray

GLIDE_NUMBERS = len(structures.GLIDE_COLUMNS)
LONG_FRAMES = 8_192  # blocks of files; meanwhile other threads may run

_address = ctypes.c_void_p
_Nothing = ctypes.c_char * 0

# Return type and argument types of each function in core.h.
_FUNCTIONS: dict[str, Any] = {
    "check": (c_char_p, (_address, c_size_t, POINTER(structures.Info))),
    "open": (_address, (_address, c_size_t, _address)),
    "reset": (None, (_address, c_int)),
    "process": (None, (_address, _address, structures.Sound, _address, c_size_t, _address)),
    "vibrate": (None, (_address, structures.Sound, _address, c_size_t, _address)),
    "state": (c_size_t, (_address, _address, c_size_t)),
    "set_state": (c_int, (_address, _address, c_size_t)),
    "glides_max": (c_size_t, (_address, c_size_t)),
    "record": (c_size_t, (_address, _address, c_size_t)),
}


@lru_cache(maxsize=1)
def library() -> ctypes.PyDLL:
    """Return the compiled core. NotFoundError: no core of this version can be loaded."""
    path = library_path()
    if path is None:
        raise NotFoundError("the compiled core is missing; run `make run` with a C compiler")
    try:
        refuse_cut_off(path)
        found = ctypes.PyDLL(str(path))  # does not release the GIL during a call
        sizes = tuple((c_uint64 * len(structures.STRUCTURES)).in_dll(found, "core_sizes"))
        for name, (returned, taken) in _FUNCTIONS.items():
            function = getattr(found, f"core_{name}")
            function.restype, function.argtypes = returned, taken
    except (ImportError, OSError, ValueError) as error:
        raise NotFoundError(f"the compiled core cannot be loaded: {error}") from error
    except AttributeError:  # a function is missing
        sizes = ()
    if sizes != tuple(map(ctypes.sizeof, structures.STRUCTURES)):
        raise NotFoundError(f"{path} is of another version; run `make run`")
    return found


@lru_cache(maxsize=1)
def _long_vibrate() -> Any:
    """Return the core's function `vibrate`, which releases the GIL, so that other threads run."""
    function = ctypes.CDLL(library()._name).core_vibrate
    function.restype, function.argtypes = _FUNCTIONS["vibrate"]
    return function


class Core:
    """One stream of the core: sound in, actuator signals out.

    One thread calls the methods. Any thread may write `controls` and read `readings`.
    design: from `core_design`. outputs: number of output columns. InternalError: the design is
    invalid. NotFoundError: see `library`.
    """

    def __init__(self, design: bytes) -> None:
        self._library = library()
        self._design = np.frombuffer(design, np.uint8).copy()  # aligned to 16 bytes
        self.info, self.controls, self.readings = (
            structures.Info(),
            structures.Controls(sound_gain=1.0),
            structures.Readings(),
        )
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
        """Process sound (frames, inputs), float32 or float64; return signals (frames, outputs)."""
        samples, out = self._samples(sound), np.empty((len(sound), self.outputs), np.float32)
        self._library.core_process(
            self._core, self._controls, samples, _address_of(out), len(sound), self._readings
        )
        return out

    def vibrate(self, sound: Float32Array | FloatArray) -> FloatArray:
        """Run only the transform on sound (frames, inputs); return float64 (frames, vibrations)."""
        samples, out = self._samples(sound), np.empty((len(sound), self.info.vibrations))
        is_long = len(sound) >= LONG_FRAMES
        vibrate = _long_vibrate() if is_long else self._library.core_vibrate
        vibrate(self._core, samples, _address_of(out), len(sound), self._readings)
        return out

    def _samples(self, sound: Float32Array | FloatArray) -> structures.Sound:
        if sound.ndim != 2 or sound.shape[1] != self.info.inputs:
            raise InternalError(
                f"a block has shape {sound.shape}: (frames, {self.info.inputs}) was expected"
            )
        if sound.dtype not in (np.float32, np.float64) or not sound.flags.aligned:
            raise InternalError(
                f"a block has samples of {sound.dtype}; allowed: aligned float32, float64"
            )
        return structures.Sound(_address_of(sound), *sound.strides, sound.dtype == np.float64)

    @property
    def state(self) -> bytes:
        """The processing state. Another core with the same design can continue from this state."""
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
        """Latest partials: Hz in sound, Hz in vibration, amplitude. Any thread may read them."""
        found = self.readings
        return tuple((row[0], row[1], row[2]) for row in found.partials[: found.partials_count])

    def record_glides(self, frames: int) -> FloatArray:
        """Return the glides recorded since the last call, (glides, 9), and continue the recording.

        See `GLIDE_COLUMNS`. frames: number of following frames whose glides are recorded.
        """
        kept, rows = self._glides, self._library.core_glides_max(self._core, frames)
        self._glides = np.empty((rows, GLIDE_NUMBERS))
        return kept[: self._library.core_record(self._core, self._glides.ctypes.data, rows)]

    def reset(self, *, doses_too: bool = False) -> None:
        """Reset the stream; if `doses_too` is set, also temperatures, doses and counts."""
        self._library.core_reset(self._core, doses_too)
        self.readings.partials_count = 0


def _address_of(samples: Float32Array | FloatArray) -> int:
    """Return the address of samples. `from_buffer` is faster than `samples.ctypes`."""
    flags = samples.flags
    if flags.c_contiguous and flags.writeable:
        return ctypes.addressof(_Nothing.from_buffer(samples.data))
    return int(samples.ctypes.data)
