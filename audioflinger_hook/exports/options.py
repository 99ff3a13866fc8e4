"""What can be exported: formats, options and their allowed values, and the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from device.drive.exposure import Exposure
from device.errors import UsageError
from device.units import FloatArray
from device.values import nearest

VIBRATION_LOW_HZ, VIBRATION_HIGH_HZ = 20.0, 220.0
Band = tuple[float, float]  # lowest and highest frequency in Hz
DEVICE_MIN_HZ, DEVICE_MAX_HZ = 20.0, 1_000.0
DEVICE_SPAN_MIN_HZ = 10.0
OUTPUT_RATE_MIN_HZ, OUTPUT_RATE_MAX_HZ = 1_000, 768_000


@dataclass(frozen=True)
class Format:
    """An export format.

    suffixes: endings of file names that choose it; the first is the usual one. parametric: it holds
    envelopes or partials instead of a waveform. channels_max: of vibration. whole: its file is made
    as a whole, so that the sound may last 3 hours at most.
    """

    suffixes: tuple[str, ...]
    description: str
    parametric: bool = False
    channels_max: int = 1
    whole: bool = False


FORMATS: dict[str, Format] = {
    "wav": Format((".wav", ".wave", ".rf64"), "vibration, float32", channels_max=64),
    "flac": Format((".flac",), "vibration, 24 bits", channels_max=8),
    "ogg-haptic": Format(
        (".ogg", ".oga"), "the sound, with vibration as Android's haptic channels", channels_max=2
    ),
    "ahap": Format((".ahap",), "curves and transients of Core Haptics", True, whole=True),
    "haptic": Format((".haptic",), "envelopes of Meta and Lofelt", True, whole=True),
    "vibration-xml": Format((".xml",), "vibration effect of Android 16", True, whole=True),
    "hjif": Format((".hjif",), "partials of ISO/IEC 23090-31", True, channels_max=64, whole=True),
    "partials": Format((".jsonl",), "partial tracks, JSON lines", True, channels_max=64),
}


@dataclass(frozen=True)
class ExportOptions:
    """How a sound is exported. UsageError: a value is out of range, or the format cannot hold it.

    format: a name in `FORMATS`. output_rate_hz: rate of the file, 1 000 to 768 000 Hz, for
    waveforms; None: that of the sound. device_band_hz: band that the target's actuator plays, for
    parametric formats; 20-220 Hz is mapped to it.
    """

    format: str
    output_rate_hz: int | None = None
    device_band_hz: Band | None = None

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            guess = nearest(self.format, FORMATS)
            raise UsageError(
                f"format {self.format!r} is not known; "
                f"{f'did you mean {guess!r}? ' if guess else ''}allowed: {', '.join(FORMATS)}"
            )
        parametric, rate = FORMATS[self.format].parametric, self.output_rate_hz
        if rate is not None:
            if parametric:
                raise UsageError(
                    f"output_rate_hz={rate} does not fit the format {self.format}, which holds no "
                    f"waveform; leave it out, or choose one of {_names(parametric=False)}"
                )
            if self.format == "ogg-haptic":
                raise UsageError(
                    f"output_rate_hz={rate} does not fit the format ogg-haptic, which holds the "
                    "sound at its own rate; leave it out, or choose wav or flac"
                )
            if not OUTPUT_RATE_MIN_HZ <= rate <= OUTPUT_RATE_MAX_HZ:
                raise UsageError(
                    f"output_rate_hz={rate} is out of range; allowed: {OUTPUT_RATE_MIN_HZ} to "
                    f"{OUTPUT_RATE_MAX_HZ} Hz; 1000 Hz holds all of the vibration"
                )
        if self.device_band_hz is not None:
            self._check_band(*self.device_band_hz)

    def _check_band(self, low_hz: float, high_hz: float) -> None:
        given = f"device_band_hz={low_hz:g}:{high_hz:g}"
        if not FORMATS[self.format].parametric:
            raise UsageError(
                f"{given} does not fit the format {self.format}, which holds a waveform; "
                f"leave it out, or choose one of {_names(parametric=True)}"
            )
        inside = low_hz >= DEVICE_MIN_HZ and high_hz <= DEVICE_MAX_HZ
        if not (inside and high_hz - low_hz >= DEVICE_SPAN_MIN_HZ):
            raise UsageError(
                f"{given} is out of range; allowed: LOW:HIGH from {DEVICE_MIN_HZ:g} to "
                f"{DEVICE_MAX_HZ:g} Hz, {DEVICE_SPAN_MIN_HZ:g} Hz or more apart, such as 55:200"
            )


@dataclass(frozen=True)
class ExportReport:
    """What was exported. Field names contain their units; frames and samples are counts.

    frames, samplerate, channels: of the file if it is a waveform, otherwise of the vibration.
    peak: largest magnitude of the vibration; 1.0 is full scale.
    leak_above_250_hz_db: energy of the vibration above 250 Hz in dB of all; None for silence.
    exposure: of the rig, if it is damped, protected or capped.
    limited_samples: samples that the limiter or the format's full scale has changed.
    error: measured error of a parametric format against its partials.
    """

    format: str
    frames: int
    samplerate: int
    channels: int
    duration_s: float
    profile: str
    peak: float
    leak_above_250_hz_db: float | None
    limited_samples: int
    replaced_samples: int
    bytes: int
    exposure: Exposure | None = None
    error: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def format_of(path: Path) -> str:
    """Return the name of the format that a file's ending chooses. UsageError: there is none."""
    known = {suffix: name for name, one in FORMATS.items() for suffix in one.suffixes}
    ending = path.suffix.lower()
    if name := known.get(ending or path.name.lower()):
        return name
    guess = nearest(ending, known)
    raise UsageError(
        f"OUT = '{path}' has no ending of a known format; "
        f"{f'did you mean {guess}? ' if guess else ''}allowed: {', '.join(known)}; "
        "or name the format with --format"
    )


def _names(*, parametric: bool) -> str:
    return ", ".join(name for name, one in FORMATS.items() if one.parametric == parametric)


def check_channel_count(name: str, channels: int) -> None:
    """Raise UsageError if a format cannot hold this many channels of vibration."""
    most = FORMATS[name].channels_max
    if channels > most:
        enough = [other for other, one in FORMATS.items() if one.channels_max >= channels]
        raise UsageError(
            f"the format {name} cannot hold {channels} channels of vibration; allowed: 1 to "
            f"{most}; use channels = mono, fewer actuators, or one of: {', '.join(enough)}"
        )


def to_device_hz(hz: FloatArray, band_hz: Band | None) -> FloatArray:
    """Return the frequencies that a device plays for 20-220 Hz of vibration, on a straight line.

    band_hz: lowest and highest frequency of the device; None: frequencies do not change.
    """
    if band_hz is None:
        return hz
    low_hz, high_hz = band_hz
    return low_hz + share_of(hz, VIBRATION_LOW_HZ, VIBRATION_HIGH_HZ) * (high_hz - low_hz)


def share_of(hz: FloatArray, low_hz: float, high_hz: float) -> FloatArray:
    """Return where frequencies are in a band: 0 at its low end and below, 1 at its high end."""
    return np.clip((hz - low_hz) / (high_hz - low_hz), 0.0, 1.0)


def band_text(band_hz: Band | None) -> str:
    """Return the sentence in a file about the mapping of frequencies."""
    if band_hz is None:
        return "frequencies are those of the vibration, 20-220 Hz"
    return f"20-220 Hz of vibration are mapped to {band_hz[0]:g}-{band_hz[1]:g} Hz of the device"
