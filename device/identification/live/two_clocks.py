"""The delay of a recording, and the drift between the clocks of output and input.

The delay is the time of the deconvolved impulse response's peak (Farina 2000), within some ms of
the true delay. The time between the two marks of an `Excitation` gives the drift.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft, rfftfreq

from device.identification.live.exchange import MOST_LATENCY_S
from device.identification.recording import Excitation, IdentificationError
from device.units import FloatArray

MOST_DRIFT_PPM = 200.0  # two crystals of ±100 ppm; a larger drift means lost or inserted frames
MOST_UNSURE_PPM = 20.0  # largest half-width of a 95 % interval: 0.04 periods of 400 Hz in 5 s
CLEAREST = 8.0  # least ratio of an impulse response's peak to its r.m.s.; noise has less
_RING_S, _EARLY_S, _BELOW = 0.2, 0.6, 1e-2


class DropoutError(IdentificationError):
    """Frames were probably lost or added; the sweep can be repeated."""


@dataclass(frozen=True)
class Drift:
    """Relative deviation of the recording's clock from the output's clock, in ppm."""

    value: float
    reach: float  # half the 95 % interval


def find_delay(excitation: Excitation, channel: FloatArray, name: str) -> int:
    """Return the frame of a recorded channel, (frames,), at which the playback begins.

    IdentificationError: the channel does not follow the played signal.
    """
    mark = excitation.samples[: excitation.sweep_start]
    early = channel[: excitation.sweep_start + round(_EARLY_S * excitation.sweep.samplerate)]
    peak, clearness = _peak(excitation, excitation.samples, channel)
    if clearness < CLEAREST:  # lost frames blur the whole response, but not the first mark
        by_mark = _peak(excitation, mark, early)
        peak, clearness = max((peak, clearness), by_mark, key=lambda one: one[1])
    if clearness < CLEAREST:
        raise IdentificationError(
            f"{name} does not follow the sweep: its impulse response is {clearness:.1f} times "
            f"above the rest, it must be {CLEAREST:g} times; this is another channel, or noise: "
            "check the inputs, and that nothing else plays"
        )
    return peak


def check_latency(excitation: Excitation, channel: FloatArray, name: str) -> None:
    """Raise IdentificationError if a channel, (frames,), ends before the delayed playback ends."""
    rate = excitation.sweep.samplerate
    room = len(channel) - excitation.frames
    latest = len(channel) - round(_EARLY_S * rate)
    peak, clearness = _peak(excitation, excitation.samples, channel, latest)
    if peak > room and clearness >= CLEAREST:
        raise IdentificationError(
            f"{name}: the sweep arrives {peak / rate:.2f} s after it was played, at most "
            f"{MOST_LATENCY_S:g} s is allowed; use a wired output and input, and smaller buffers "
            "of the sound server"
        )


def _peak(
    excitation: Excitation, played: FloatArray, channel: FloatArray, latest: int | None = None
) -> tuple[int, float]:
    """Return the impulse response's peak: its delay in frames, and its ratio to the r.m.s."""
    length = int(next_fast_len(len(channel) + len(played), real=True))
    reference, response = rfft(played, length), rfft(channel - channel.mean(), length)
    power = np.where(_inside(excitation, length), np.abs(reference) ** 2, 0.0)
    floor = _BELOW * float(power.max())
    impulse = irfft(np.where(power > 0.0, response * reference.conj() / (power + floor), 0), length)
    size = np.abs(impulse)
    latest = len(channel) - len(played) + 1 if latest is None else latest
    peak = int(np.argmax(size[: max(1, latest)]))
    return peak, float(size[peak] / max(float(np.sqrt(np.mean(size**2))), 1e-300))


def find_drift(excitation: Excitation, channel: FloatArray, delay: int, name: str) -> Drift:
    """Return the drift from the two marks in a channel whose playback begins at frame `delay`."""
    rate = excitation.sweep.samplerate
    length = excitation.mark_frames + round(_RING_S * rate)
    window = np.ones(length)
    fade = round(0.02 * rate)
    window[:fade] = np.sin(0.5 * np.pi * np.arange(fade) / fade) ** 2
    window[-fade:] = window[:fade][::-1]
    starts = delay - fade, delay + excitation.second_mark - fade
    marks = [_cut(channel, start, length) * window for start in starts]
    size = int(next_fast_len(2 * length, real=True))
    inside = _inside(excitation, size)
    cross = np.where(inside, rfft(marks[0], size).conj() * rfft(marks[1], size), 0.0)
    coarse = int(np.argmax(irfft(cross, size)))
    coarse -= size if coarse > size // 2 else 0
    # fit a line through 0 to the remaining phase
    turn = math.tau * rfftfreq(size)[inside]
    cross = cross[inside] * np.exp(1j * turn * coarse)
    weight, phase = np.abs(cross), np.angle(cross)
    total = float(np.sum(weight * turn**2))
    fine = -float(np.sum(weight * turn * phase)) / max(total, 1e-300)
    left = phase + turn * fine
    # padding correlates neighbouring bins: size / length bins count as one
    together = size / length
    variance = together * float(np.sum((weight * turn * left) ** 2)) / max(total, 1e-300) ** 2
    ppm, frames = 1e6 / excitation.second_mark, coarse + fine
    found = Drift(ppm * frames, 1.96 * ppm * math.sqrt(variance))
    if not found.reach <= MOST_UNSURE_PPM:
        raise DropoutError(
            f"{name}: the two clocks cannot be compared, to ±{found.reach:.3g} ppm, "
            f"±{MOST_UNSURE_PPM:g} is needed: the marks before and after the sweep are too weak, "
            "or frames were lost between them; raise the level a little, or close other programs"
        )
    if abs(found.value) > MOST_DRIFT_PPM:
        what = "added" if frames > 0 else "lost"
        raise DropoutError(
            f"{name}: {abs(frames):.0f} frames were {what} during the sweep ({found.value:+.0f} "
            f"ppm, two clocks differ by {MOST_DRIFT_PPM:g} at most): a dropout; close other "
            "programs, and sweep again"
        )
    return found


def resample_to_played(
    channel: FloatArray, first: float, drift_ppm: float, frames: int
) -> FloatArray:
    """Resample a channel to the played frames. first: the first played frame's position in it."""
    step = 1.0 + 1e-6 * drift_ppm
    position = first + step * np.arange(frames)
    whole = np.floor(position).astype(np.int64)
    if abs(step - 1.0) * frames < 0.01 and first == round(first):
        return _cut(channel, round(first), frames)
    x = position - whole
    padded = _cut(channel, int(whole[0]) - 1, int(whole[-1] - whole[0]) + 4)
    at = whole - whole[0]
    a, b, c, d = (padded[at + k] for k in range(4))
    return np.asarray(
        -a * x * (x - 1.0) * (x - 2.0) / 6.0
        + b * (x + 1.0) * (x - 1.0) * (x - 2.0) / 2.0
        - c * (x + 1.0) * x * (x - 2.0) / 2.0
        + d * (x + 1.0) * x * (x - 1.0) / 6.0
    )


def _inside(excitation: Excitation, length: int) -> np.ndarray:
    f = rfftfreq(length, 1.0 / excitation.sweep.samplerate)
    return np.asarray((f >= excitation.sweep.low_hz) & (f <= excitation.sweep.high_hz))


def _cut(channel: FloatArray, start: int, frames: int) -> FloatArray:
    """Return `frames` samples of a channel from `start` on; samples outside it are 0."""
    part = np.zeros(frames)
    low, high = max(0, start), min(len(channel), start + frames)
    if high > low:
        part[low - start : high - start] = channel[low:high]
    return part
