"""A small LADSPA host: the plugin's variants through the binary interface that hosts use."""

import ctypes
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config import profiles
from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core import library_path as plugin_path
from audioflinger_hook.core.design import core_design
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.plugin.variants import VariantDescriptor
from audioflinger_hook.transform import HapticTransform
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.downmix import source_mixes
from device.drive.design import DriveDesign, damping_for
from device.rig import CONSUMER, PAPER

Floats = NDArray[np.float32]

PROFILES = tuple(profiles.PROFILES)
RATES_HZ = (
    *(8_000, 11_025, 16_000, 22_050, 32_000, 44_100, 48_000, 88_200, 96_000, 176_400, 192_000),
)
ODD = (np.nan, np.inf, -np.inf, 1e30, -1e30)
"""What is no usable sample, gain or delay."""
STRONG = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=400.0))
"""A rig that protection has to limit all the time."""
LATENCY, SOUND_PEAK, VIBRATION_PEAK = 3, 4, 5


class Descriptor(VariantDescriptor):
    """LADSPA_Descriptor, whose beginning describes the ports."""


Instantiate = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.POINTER(Descriptor), ctypes.c_ulong)
Connect = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_ulong, ctypes.c_void_p)
Run = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_ulong)
Call = ctypes.CFUNCTYPE(None, ctypes.c_void_p)

Descriptor._fields_ = [
    *(("implementation", ctypes.c_void_p), ("instantiate", Instantiate), ("connect_port", Connect)),
    *(("activate", Call), ("run", Run), ("run_adding", ctypes.c_void_p)),
    *(("set_run_adding_gain", ctypes.c_void_p), ("deactivate", ctypes.c_void_p), ("cleanup", Call)),
]


def plugin() -> Path:
    path = plugin_path()
    assert path is not None, "the plugin is not built"
    return path


def descriptors() -> dict[str, Descriptor]:
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
    design = LiveDesign.of(parameters_of(profile), rate_hz)
    path.write_bytes(core_design(rate_hz, 2, transform=design.records()))
    return path


DESIGNS = ("transform", "protected", "several")


def several_drives(rate_hz: int) -> list[DriveDesign | None]:
    """A damped and capped rig, one that protection limits all the time, and none."""
    damping = damping_for(CONSUMER.actuator, CONSUMER.amplifier.source_impedance_ohm)
    strong = DriveDesign(STRONG, rate_hz, exposure_cap="limit")
    return [DriveDesign(CONSUMER, rate_hz, damping, "action"), strong, None]


def driven_design(
    rate_hz: int,
    channels: int,
    sides: Sequence[str],
    drives: Sequence[DriveDesign | None],
    *,
    each: bool = False,
) -> bytes:
    """The transform of the cinema profile, and actuators with these drives."""
    transform = LiveDesign.of(parameters_of("cinema"), rate_hz).records()
    mixes = source_mixes(source_weights(channels, sides)) if sides else ()
    told: Any = {"transform": transform, "each": each, "mixes": mixes, "drives": drives}
    return core_design(rate_hz, channels, delay_frames_max=rate_hz, **told)


def any_design(kind: str, rate_hz: int, channels: int) -> bytes:
    """A transform alone, with one damped and capped rig, or with three actuators of two sides."""
    drives = several_drives(rate_hz)
    if kind == "several":
        return driven_design(rate_hz, channels, ("mix", "left", "front"), drives)
    return driven_design(rate_hz, channels, (), drives[:1] if kind == "protected" else [])


def damaged(design: bytes) -> dict[str, bytes]:
    return {
        "cut or too long": design[:-8],
        "not a design": b"RIFF" + design[4:],
        "another version": design[:8] + b"\x63" + design[9:],
        "damaged": design[:400] + bytes([design[400] ^ 16]) + design[401:],
    }


def any_sound(
    rng: np.random.Generator, rate_hz: int, frames: int, channels: int, odd: Sequence[float] = ODD
) -> Floats:
    """Bursts of tones and noise in unequal and opposite channels, with odd samples in them."""
    at_s = np.arange(frames) / rate_hz
    tones = np.sin(2 * np.pi * 440.0 * at_s) + 0.4 * np.sin(2 * np.pi * 1_130.0 * at_s)
    parts = rng.uniform(-0.5, 0.5, channels) * tones[:, None]
    parts += 0.05 * rng.standard_normal(parts.shape)
    parts *= ((at_s % 0.5) < 0.3)[:, None]
    for sample in odd:
        parts[rng.integers(0, frames, 5), rng.integers(0, channels, 5)] = sample
    return parts.astype(np.float32)


def any_lengths(rng: np.random.Generator, frames: int) -> list[int]:
    """Lengths of 0 to 65 536 frames, as many short as long ones, that are so many together."""
    lengths: list[int] = []
    while (left := frames - sum(lengths)) > 0:
        lengths.append(min(left, int(2.0 ** rng.uniform(-1.0, 16.0))))
    return lengths


class Instance:
    """One instance of a public variant, whose controls are attributes."""

    def __init__(self, label: str, rate_hz: int) -> None:
        self._variant = descriptors()[label]
        handle = self._variant.instantiate(ctypes.byref(self._variant), rate_hz)
        self.made, self._handle = bool(handle), handle
        # Ports: 9 is an audio input, 10 an audio output, 4 a bit of controls.
        kinds = [self._variant.port_descriptors[port] for port in range(self._variant.port_count)]
        self._inputs = [port for port, kind in enumerate(kinds) if kind == 9]
        self._outputs = [port for port, kind in enumerate(kinds) if kind == 10]
        controls = [port for port, kind in enumerate(kinds) if kind & 4]
        self.controls = (ctypes.c_float * len(controls))()
        for index, port in enumerate(controls if self.made else ()):
            self._variant.connect_port(handle, port, ctypes.addressof(self.controls) + 4 * index)
        if self.made:
            self._variant.activate(handle)

    @property
    def channels(self) -> int:
        return len(self._inputs)

    def activate(self) -> None:
        self._variant.activate(self._handle)

    def run(self, sound: Floats, *, in_place: bool = False) -> Floats:
        """The vibration of a block, (frames, outputs)."""
        frames, rows = len(sound), np.ascontiguousarray(sound.T, np.float32)
        out = rows if in_place else np.full((len(self._outputs), frames), np.nan, np.float32)
        for row, port in zip(rows, self._inputs, strict=True):
            self._variant.connect_port(self._handle, port, row.ctypes.data)
        for row, port in zip(out, self._outputs, strict=False):
            self._variant.connect_port(self._handle, port, row.ctypes.data)
        self._variant.run(self._handle, frames)
        return out[: len(self._outputs)].T.copy()

    def close(self) -> None:
        if self.made:
            self._variant.cleanup(self._handle)
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
