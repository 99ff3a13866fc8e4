"""A small LADSPA host: the plugin's faces through the binary interface that hosts use."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.plugin import plugin_path
from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.transform.design import LiveDesign

Floats = NDArray[np.float32]

PROFILES = ("paper", "cinema", "game", "music")
LATENCY, SOUND_PEAK, VIBRATION_PEAK = 3, 4, 5


class Descriptor(ctypes.Structure):
    """LADSPA_Descriptor."""


Instantiate = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(Descriptor), ctypes.c_ulong)
Connect = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_ulong, ctypes.c_void_p)
Run = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_ulong)
Call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)

Descriptor._fields_ = [
    ("unique_id", ctypes.c_ulong),
    ("label", ctypes.c_char_p),
    ("properties", ctypes.c_int),
    ("name", ctypes.c_char_p),
    ("maker", ctypes.c_char_p),
    ("copyright", ctypes.c_char_p),
    ("port_count", ctypes.c_ulong),
    ("port_descriptors", ctypes.POINTER(ctypes.c_int)),
    ("port_names", ctypes.POINTER(ctypes.c_char_p)),
    ("port_ranges", ctypes.c_void_p),
    ("implementation", ctypes.c_void_p),
    ("instantiate", Instantiate),
    ("connect_port", Connect),
    ("activate", Call),
    ("run", Run),
    ("run_adding", ctypes.c_void_p),
    ("set_run_adding_gain", ctypes.c_void_p),
    ("deactivate", ctypes.c_void_p),
    ("cleanup", Call),
]


def plugin() -> Path:
    """The compiled plugin."""
    path = plugin_path()
    assert path is not None, "the plugin is not built"
    return path


def descriptors() -> dict[str, Descriptor]:
    """All faces by label."""
    describe = ctypes.CDLL(str(plugin())).ladspa_descriptor
    describe.argtypes, describe.restype = [ctypes.c_ulong], ctypes.POINTER(Descriptor)
    found: dict[str, Descriptor] = {}
    while one := describe(len(found)):
        found[one.contents.label.decode()] = one.contents
    return found


def write_design(folder: Path, profile: str, rate_hz: int) -> Path:
    """Write a design where the plugin looks for it, in the data folder `folder`."""
    path = folder / "haptic-cushion" / "designs" / f"{profile}-{rate_hz}.design"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(LiveDesign.of(parameters_of(profile), rate_hz).to_bytes())
    return path


class Instance:
    """One instance of a public face, whose controls are attributes."""

    def __init__(self, label: str, rate_hz: int) -> None:
        self._face = descriptors()[label]
        handle = self._face.instantiate(ctypes.byref(self._face), rate_hz)
        self.made = bool(handle)
        self._handle = handle
        # Ports: 9 is an audio input, 10 an audio output, 4 a bit of controls.
        kinds = [self._face.port_descriptors[port] for port in range(self._face.port_count)]
        self._inputs = [port for port, kind in enumerate(kinds) if kind == 9]
        self._outputs = [port for port, kind in enumerate(kinds) if kind == 10]
        controls = [port for port, kind in enumerate(kinds) if kind & 4]
        self.controls = (ctypes.c_float * len(controls))()
        for index, port in enumerate(controls if self.made else ()):
            place = ctypes.addressof(self.controls) + 4 * index
            self._face.connect_port(handle, port, place)
        if self.made:
            self._face.activate(handle)

    @property
    def channels(self) -> int:
        """Of the sound."""
        return len(self._inputs)

    def activate(self) -> None:
        """Begin a new stream."""
        self._face.activate(self._handle)

    def run(self, sound: Floats, *, in_place: bool = False) -> Floats:
        """The vibration of a block, (frames, outputs)."""
        frames = len(sound)
        rows = np.ascontiguousarray(sound.T, np.float32)
        out = rows if in_place else np.full((len(self._outputs), frames), np.nan, np.float32)
        for row, port in zip(rows, self._inputs, strict=True):
            self._face.connect_port(self._handle, port, row.ctypes.data)
        for row, port in zip(out, self._outputs, strict=False):
            self._face.connect_port(self._handle, port, row.ctypes.data)
        self._face.run(self._handle, frames)
        return out[: len(self._outputs)].T.copy()

    def close(self) -> None:
        """End it."""
        if self.made:
            self._face.cleanup(self._handle)
        self.made = False


def split(sound: Floats, lengths: Sequence[int]) -> Iterable[Floats]:
    """Parts of a sound of these lengths, again and again."""
    start, index = 0, 0
    while start < len(sound):
        length = lengths[index % len(lengths)]
        yield sound[start : start + length]
        start, index = start + length, index + 1


def vibration(sound: Floats, profile: str, rate_hz: int) -> Floats:
    """What the transform makes of a sound, as float32, (frames,)."""
    transform = HapticTransform(rate_hz, sound.shape[1], parameters_of(profile))
    return transform.process(sound)[:, 0].astype(np.float32)
