"""Signals for the tests of the transform, and the measures taken of what comes out.

Makers return float64 arrays (frames,), full scale 1, and take seconds, Hz and a samplerate in Hz.
`played` and `in_blocks` run a transform over (frames,) or (frames, channels) and keep everything
that leaves it, the latency and what it still owed at the end included.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, hilbert, sosfilt, sosfiltfilt

from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.haptic import Form
from audioflinger_hook.transform.mapping import vibration_hz

FloatArray = NDArray[np.float64]

SAMPLERATES = (8_000, 11_025, 16_000, 22_050, 44_100, 48_000, 96_000, 192_000)
FIVE_TONES_HZ = (100.0, 350.0, 950.0, 1_350.0, 4_200.0)
"""The principal frequencies of the paper's Figure 7."""

FORMS: tuple[Form, ...] = ("live", "reference")


def times(seconds: float, samplerate: int) -> FloatArray:
    return np.arange(round(seconds * samplerate)) / samplerate


def silence(seconds: float, samplerate: int) -> FloatArray:
    return np.zeros(round(seconds * samplerate))


def tone(
    hz: float, seconds: float, samplerate: int, amplitude: float = 1.0, phase: float = 0.3
) -> FloatArray:
    """Return a steady sine; phase in radians at the first frame."""
    return np.asarray(amplitude * np.sin(2 * np.pi * hz * times(seconds, samplerate) + phase))


def five_tones(seconds: float, samplerate: int, amplitude: float = 0.15) -> FloatArray:
    tones = [tone(hz, seconds, samplerate, amplitude) for hz in FIVE_TONES_HZ]
    return np.asarray(np.sum(tones, axis=0))


def burst(hz: float, at_s: float, seconds: float, samplerate: int, amplitude: float) -> FloatArray:
    """Return a 0.25 s tone burst with a raised-cosine rise of 1 ms that begins at at_s."""
    since = times(seconds, samplerate) - at_s
    rise = 0.5 - 0.5 * np.cos(np.pi * np.clip(since / 0.001, 0.0, 1.0))
    return np.asarray(amplitude * rise * (since < 0.25) * np.sin(2 * np.pi * hz * since))


def square(hz: float, seconds: float, samplerate: int, amplitude: float = 1.0) -> FloatArray:
    """Return a square wave that is at its amplitude or its negative in every frame."""
    return np.where(np.floor(2 * hz * times(seconds, samplerate)) % 2 == 0, amplitude, -amplitude)


def white_noise(
    seconds: float, samplerate: int, amplitude: float = 1.0, seed: int = 0
) -> FloatArray:
    """Return uniform white noise that fills the range of its amplitude."""
    frames = round(seconds * samplerate)
    return np.random.default_rng(seed).uniform(-amplitude, amplitude, frames)


def low_noise(seconds: float, samplerate: int, rms: float, seed: int = 0) -> FloatArray:
    """Return noise of 60-500 Hz: wide peaks near 0 Hz, strong and weak ones mixed."""
    sections = butter(2, (60, 500), "bandpass", fs=samplerate, output="sos")
    noise = np.asarray(sosfilt(sections, white_noise(seconds, samplerate, 1.0, seed)))
    return noise * (rms / float(noise.std()))


def chirp(
    from_hz: float, to_hz: float, seconds: float, samplerate: int, amplitude: float = 0.5
) -> FloatArray:
    """Return a sweep whose frequency grows by the same factor in equal times."""
    growth = np.log(to_hz / from_hz) / seconds
    turns = from_hz / growth * np.expm1(growth * times(seconds, samplerate))
    return np.asarray(amplitude * np.sin(2 * np.pi * turns))


def one_sample(seconds: float, samplerate: int, at_s: float, height: float = 1.0) -> FloatArray:
    """Return silence but for one frame."""
    return np.where(np.arange(round(seconds * samplerate)) == round(at_s * samplerate), height, 0.0)


def joined(*parts: FloatArray) -> FloatArray:
    return np.concatenate(parts)


def columns(*channels: FloatArray) -> FloatArray:
    """Return (frames, channels) from one (frames,) for each channel, cut to the shortest."""
    frames = min(channel.size for channel in channels)
    return np.stack([channel[:frames] for channel in channels], axis=1)


def opened(samplerate: int, channels: int, form: Form = "live", **options: Any) -> HapticTransform:
    return HapticTransform(samplerate, channels, form=form, **options)


def made(sound: NDArray[Any], samplerate: int, **options: Any) -> HapticTransform:
    """Return a new transform that fits the sound; options: as of `HapticTransform`."""
    return opened(samplerate, 1 if sound.ndim == 1 else sound.shape[1], **options)


def played(sound: NDArray[Any], samplerate: int, **options: Any) -> FloatArray:
    """Return all vibration of the sound in one block, (frames + latency, channels_out)."""
    transform = made(sound, samplerate, **options)
    return np.concatenate((transform.process(sound), transform.finish()))


def in_blocks(
    sound: NDArray[Any], blocks: Iterable[int], samplerate: int, **options: Any
) -> FloatArray:
    """Return the same from blocks of the given lengths; what they leave is the last block."""
    transform = made(sound, samplerate, **options)
    parts = []
    first = 0
    for frames in blocks:
        block = sound[first : first + frames]
        parts.append(transform.process(block))
        assert len(parts[-1]) == len(block)
        first = min(first + frames, len(sound))
    parts += [transform.process(sound[first:]), transform.finish()]
    return np.concatenate(parts)


def identical(one: FloatArray, other: FloatArray) -> bool:
    """Return whether two arrays are the same, byte for byte: the sign of 0 counts, too."""
    return one.shape == other.shape and one.tobytes() == other.tobytes()


def level_db(vibration: FloatArray) -> float:
    """Return the level of a vibration, a full-scale sine at 0 dB."""
    return float(10 * np.log10(2 * np.mean(vibration**2) + 1e-30))


def felt_hz(audio_hz: float) -> float:
    """Return where a tone is felt by the paper's mapping."""
    return float(vibration_hz(np.array([float(audio_hz)]), TransformParameters())[0])


def energy_above_db(vibration: FloatArray, hz: float, samplerate: int) -> float:
    """Return the share of a signal's energy above a frequency; it must begin and end at rest."""
    power = np.abs(np.fft.rfft(vibration)) ** 2
    above = np.fft.rfftfreq(vibration.size, 1 / samplerate) > hz
    return float(10 * np.log10(power[above].sum() / power.sum()))


def best_sinusoid(
    vibration: FloatArray, samplerate: float, hz: float
) -> tuple[float, float, float]:
    """Return frequency, amplitude and residual (dB under it) of the sinusoid that fits best, by
    Newton steps of least squares from a guess within a fraction of 1/duration."""
    time = np.arange(vibration.size) / samplerate
    time -= time.mean()
    for _ in range(6):
        cosine, sine = np.cos(2 * np.pi * hz * time), np.sin(2 * np.pi * hz * time)
        basis = np.stack((cosine, sine, time * cosine, time * sine), axis=1)
        a, b, a_slope, b_slope = np.linalg.lstsq(basis, vibration)[0]
        hz += (b * a_slope - a * b_slope) / (a * a + b * b) / (2 * np.pi)
    basis = np.stack((np.cos(2 * np.pi * hz * time), np.sin(2 * np.pi * hz * time)), axis=1)
    (a, b), *_ = np.linalg.lstsq(basis, vibration)
    residual = vibration - basis @ np.array((a, b))
    residual_db = 10 * np.log10((residual**2).mean() / (vibration**2).mean())
    return float(hz), float(np.hypot(a, b)), float(residual_db)


def envelope(vibration: FloatArray, samplerate: float, low_pass_hz: float = 60.0) -> FloatArray:
    """Return the Hilbert envelope, low-passed forwards and backwards so that it is not delayed."""
    sections = butter(2, low_pass_hz, fs=samplerate, output="sos")
    return np.asarray(sosfiltfilt(sections, np.abs(hilbert(vibration))))


def thinned(vibration: FloatArray, samplerate: int) -> tuple[FloatArray, float]:
    """Return every n-th frame and their rate, at least 3 kHz: plenty for vibration to 220 Hz."""
    step = max(1, samplerate // 3_000)
    return vibration[::step], samplerate / step
