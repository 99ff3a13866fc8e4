"""The export formats, the options of an export with their allowed values, and its report."""

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
RESAMPLED_HZ = 192_000  # sample rate of a file whose format cannot hold the sound's
FLAC_ANY_HZ, FLAC_STEP_HZ = 65_535, 10  # above, FLAC's frames hold only multiples of 10 Hz


@dataclass(frozen=True)
class Format:
    """An export format.

    suffixes: file name endings that select the format; the first is the default. parametric:
    whether the file contains envelopes or partials instead of a waveform. channels_max: largest
    number of channels of vibration. rate_max_hz: highest sample rate of a waveform. whole: whether
    the whole file is made in memory, so that the sound may last at most 1 hour.
    """

    suffixes: tuple[str, ...]
    description: str
    parametric: bool = False
    channels_max: int = 1
    rate_max_hz: int = OUTPUT_RATE_MAX_HZ
    whole: bool = False


FORMATS: dict[str, Format] = {
    "wav": Format((".wav", ".wave", ".rf64"), "vibration, float32", channels_max=64),
    "flac": Format((".flac",), "vibration, 24 bits", channels_max=8, rate_max_hz=655_350),
    "ogg-haptic": Format(
        (".ogg", ".oga"),
        "the sound, with vibration as Android's haptic channels",
        channels_max=2,
        rate_max_hz=200_000,
    ),
    "ahap": Format((".ahap",), "curves and transients of Core Haptics", True, whole=True),
    "haptic": Format((".haptic",), "envelopes of Meta and Lofelt", True, whole=True),
    "vibration-xml": Format((".xml",), "vibration effect of Android 16", True, whole=True),
    "hjif": Format((".hjif",), "partials of ISO/IEC 23090-31", True, channels_max=64, whole=True),
    "partials": Format((".jsonl",), "partial tracks, JSON lines", True, channels_max=64),
}

LONG = {
    "ogg-haptic": (600, "takes about 4 times as long as wav or flac, because of its encoder"),
    "vibration-xml": (200, "holds 200 s of changing vibration; more of it is refused at the end"),
    "hjif": (600, "takes 4 to 30 times as long as wav or flac"),
    "partials": (600, "takes about 2 to 4 times as long as wav or flac"),
}
"""What a command says at its start about sounds longer than some seconds, by format."""


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export. UsageError: a value is out of range, or does not fit the format.

    format: a name in `FORMATS`. output_rate_hz: sample rate of a waveform, 1 000 to 768 000 Hz;
    None: that of the sound. device_band_hz: for parametric formats, lowest and highest frequency
    of the target's actuator, to which 20-220 Hz are mapped; None changes no frequency.
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
            if rate < OUTPUT_RATE_MIN_HZ or held_rate_hz(self.format, rate) != rate:
                steps = f", above {FLAC_ANY_HZ} Hz in steps of {FLAC_STEP_HZ} Hz"
                raise UsageError(
                    f"output_rate_hz={rate} is out of range; allowed: {OUTPUT_RATE_MIN_HZ} to "
                    f"{FORMATS[self.format].rate_max_hz} Hz{steps * (self.format == 'flac')}; "
                    "1000 Hz holds all of the vibration"
                )
        if self.device_band_hz is None:
            return
        low_hz, high_hz = self.device_band_hz
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
    """The result of an export. Field names contain their units; frames and samples are counts.

    frames, samplerate: of a waveform file, otherwise of the vibration. channels: of the vibration.
    peak: largest magnitude of the vibration; 1.0 is full scale.
    leak_above_250_hz_db: energy above 250 Hz in dB relative to the total energy; None for silence.
    exposure: of the rig with the largest A(8). None if damping, protection and cap are all off.
    limited_samples: number of samples that the limiter reduced, or that the format clipped.
    replaced_samples: number of unusable samples of the sound, such as NaN, that became 0.
    error: measured errors and counts of a parametric format; empty for other formats.
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
    """Return the name of the format that a path's suffix selects. UsageError: there is none."""
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
    """Raise UsageError if a format cannot hold this number of vibration channels."""
    most = FORMATS[name].channels_max
    if channels > most:
        enough = [other for other, one in FORMATS.items() if one.channels_max >= channels]
        raise UsageError(
            f"the format {name} cannot hold {channels} channels of vibration; allowed: 1 to "
            f"{most}; use channels = mono, fewer actuators, or one of: {', '.join(enough)}"
        )


def held_rate_hz(name: str, samplerate: int) -> int:
    """Return the sample rate of a format's file: that of the sound, or one that the file can have.

    samplerate: of the sound in Hz.
    """
    fine = name != "flac" or samplerate <= FLAC_ANY_HZ or samplerate % FLAC_STEP_HZ == 0
    return samplerate if fine and samplerate <= FORMATS[name].rate_max_hz else RESAMPLED_HZ


def to_device_hz(hz: FloatArray, band_hz: Band | None) -> FloatArray:
    """Map frequencies of the vibration linearly from 20-220 Hz to the band of a device.

    band_hz: lowest and highest frequency of the device; None changes no frequency.
    """
    if band_hz is None:
        return hz
    low_hz, high_hz = band_hz
    return low_hz + share_of(hz, VIBRATION_LOW_HZ, VIBRATION_HIGH_HZ) * (high_hz - low_hz)


def share_of(hz: FloatArray, low_hz: float, high_hz: float) -> FloatArray:
    """Return the positions of frequencies in a band, from 0 (`low_hz` and below) to 1."""
    return np.clip((hz - low_hz) / (high_hz - low_hz), 0.0, 1.0)


def band_text(band_hz: Band | None) -> str:
    """Return a text about the mapping of frequencies, for the exported file."""
    if band_hz is None:
        return "frequencies are those of the vibration, 20-220 Hz"
    return f"20-220 Hz of vibration are mapped to {band_hz[0]:g}-{band_hz[1]:g} Hz of the device"
