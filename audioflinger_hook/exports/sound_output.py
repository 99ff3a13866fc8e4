"""Waveform files written by libsndfile, rate conversion, measurement of energy above 250 Hz."""

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import soundfile
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from audioflinger_hook.mixer.resampler import Resampler, frames_out
from device.atomic_file import AtomicFile
from device.blocks import peak
from device.drive.outputs import WrappedOutput
from device.errors import InternalError, UsageError, WriteError
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray, amplitude_to_db, check_channels

BLOCK_FRAMES = 4_096
"""Frames for each call of the encoder. The constant size makes a file's bytes independent of the
caller's blocks, and limits the stack of the Vorbis encoder."""
BLOCKS_AHEAD = 2  # blocks that may wait for a `BackgroundOutput`
LARGE_FRAMES = 65_536  # FLAC's bytes do not depend on the size, and large blocks cost less


class LibsndfileTarget:
    """A file for libsndfile. failure: first write error. UsageError: the file cannot be created."""

    def __init__(self, path: Path) -> None:
        self.file = AtomicFile(path)
        self._position = self._size = 0
        self.failure: WriteError | None = None

    def write(self, content: bytes) -> int:
        """Write bytes at the present position. Store an error in `failure`; do not raise it."""
        if self.failure is None:
            try:
                self._store(bytes(content))
            except WriteError as failure:
                self.failure = failure
        return len(content)

    def _store(self, content: bytes) -> None:
        if over := content[: self._size - self._position]:
            self.file.overwrite(over, self._position)
        if rest := content[len(over) :]:
            self.file.write(rest)
        self._position += len(content)
        self._size = max(self._size, self._position)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position of the next `write`, and return the position in bytes."""
        start = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}[whence]
        self._position = min(max(0, start + offset), self._size)
        return self._position

    def tell(self) -> int:
        """Return the position in bytes."""
        return self._position

    def read(self, _count: int = -1) -> bytes:
        """Return no bytes, because an encoder does not read its output."""
        return b""

    def commit(self) -> None:
        """Give the file its final name."""
        self.file.commit()


class SoundFileOutput:
    """Writes a FLAC or Ogg Vorbis file. Only one thread may use it.

    Samples beyond ±1.0 are clipped and counted.

    format, subtype: libsndfile's names, such as "FLAC" and "PCM_24".
    target: receives the encoded bytes; by default, they are written to the file.
    level: compression level, 0 to 1; default: that of libsndfile.
    UsageError: the format does not support the channels, or the file cannot be created. For rates
        that the format does not support, see `held_rate_hz`: libsndfile would crash.
    WriteError: the disk is full or has failed; no file remains.
    """

    def __init__(
        self,
        path: Path,
        samplerate: int,
        channels: int,
        format: str,
        subtype: str,
        *,
        target: LibsndfileTarget | None = None,
        level: float | None = None,
    ) -> None:
        self.samplerate, self.channels = samplerate, channels
        self.limited_samples = 0
        self._held = np.zeros((0, channels), np.float32)
        self._step = BLOCK_FRAMES if format == "OGG" else LARGE_FRAMES
        self._target = target or LibsndfileTarget(path)
        self._file: soundfile.SoundFile | None = None
        try:
            wanted = {"subtype": subtype, "format": format, "compression_level": level}
            self._file = soundfile.SoundFile(self._target, "w", samplerate, channels, **wanted)
        except (soundfile.LibsndfileError, ValueError, TypeError) as error:
            self._target.file.abort()
            if self._target.failure:
                raise self._target.failure from None
            raise UsageError(
                f"{path}: {format} cannot hold {channels} channels at {samplerate} Hz "
                f"({getattr(error, 'error_string', error)}); "
                "choose fewer channels, another --output-rate or the format wav"
            ) from None

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Append samples, (frames, channels)."""
        if self._file is None:
            raise InternalError("the sound file is closed: nothing can be written to it")
        check_channels(vibration, self.channels)
        samples = vibration.astype(np.float32, order="C")
        if not peak(samples) <= 1.0:
            self.limited_samples += int(np.count_nonzero(np.abs(samples) > 1.0))
            np.clip(samples, -1.0, 1.0, out=samples)
        self._held = np.concatenate((self._held, samples)) if len(self._held) else samples
        self._encode(len(self._held) - len(self._held) % BLOCK_FRAMES)

    def close(self) -> None:
        """Encode the remaining samples, and give the file its final name."""
        if self._file is None:
            return
        self._encode(len(self._held))
        file, self._file = self._file, None
        file.close()
        self._raise_failure()
        self._target.commit()

    def abort(self) -> None:
        """Discard the file."""
        file, self._file = self._file, None
        if file is not None:
            self._target.failure = self._target.failure or WriteError("aborted")
            file.close()
        self._target.file.abort()

    def _encode(self, frames: int) -> None:
        assert self._file is not None
        held = self._held[:frames]
        for first in range(0, frames, self._step):
            try:
                self._file.write(held[first : first + self._step])
            except (soundfile.LibsndfileError, RuntimeError) as error:
                self._target.failure = WriteError(f"cannot encode the sound file ({error})")
            self._raise_failure()
        self._held = self._held[frames:]

    def _raise_failure(self) -> None:
        if self._target.failure is not None:
            self.abort()
            raise self._target.failure


class BackgroundOutput(WrappedOutput):
    """Passes blocks to an output on a second thread, so that an encoder uses another core.

    An error of the output is raised by a later call. Only one thread may use this class.
    """

    def __init__(self, output: VibrationOutput) -> None:
        super().__init__(output)
        self._thread = ThreadPoolExecutor(1)
        self._waiting: deque[Future[None]] = deque()

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Pass a copy of a block on."""
        self.run(self._output.write, vibration.copy())

    def run(self, work: Callable[..., None], *arguments: Any) -> None:
        """Call a function on the second thread, after all earlier calls."""
        self._wait(BLOCKS_AHEAD)
        self._waiting.append(self._thread.submit(work, *arguments))

    def close(self) -> None:
        """Wait for all calls, and finish the output. May be repeated."""
        self._wait(0)
        self._thread.shutdown()
        super().close()

    def abort(self) -> None:
        """Discard the output. The call that runs is finished first."""
        self._thread.shutdown(cancel_futures=True)
        super().abort()

    def _wait(self, most: int) -> None:
        while len(self._waiting) > most:
            self._waiting.popleft().result()


AUDIBLE_FROM_HZ = 250.0
BATCH_WINDOWS = 4
KEPT_BYTES = 1 << 24
LONG_BATCHES = 300  # 3 to 7 minutes; from then on, SciPy's faster transform is worth its import
PIECE_FRAMES = 8_192  # frames for each call of the resampler, to limit its memory


class ResampledOutput(WrappedOutput):
    """Converts the sample rate before an output, with a linear-phase low-pass and without delay.

    n input frames give ceil(n rate_out / rate_in) output frames. Only one thread may use it.

    samplerate: sample rate of the input in Hz.
    """

    def __init__(self, output: VibrationOutput, samplerate: int) -> None:
        super().__init__(output)
        self.samplerate = samplerate
        common = int(np.gcd(samplerate, output.samplerate))
        self._up, self._down = output.samplerate // common, samplerate // common
        most = frames_out(PIECE_FRAMES, samplerate, output.samplerate) + 1
        self._resampler = Resampler(samplerate, output.samplerate, self.channels, most)
        # Initial silence makes the filter's delay a whole number of output frames.
        silence = -self._resampler.latency_frames % self._down
        self._resampler.feed(np.zeros((silence, self.channels), np.float32))
        self._fed = silence
        self._to_skip = (silence + self._resampler.latency_frames) * self._up // self._down
        self._made = self._taken = 0

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Convert a block, (frames, channels), and write the result to the output."""
        self._taken += len(vibration)
        self._feed(vibration)

    def close(self) -> None:
        """Write the frames that are still in the filter, and close the output."""
        wanted = self._to_skip + frames_out(self._taken, self._down, self._up)
        while self._made < wanted:
            self._feed(np.zeros((PIECE_FRAMES, self.channels), np.float32), wanted)
        super().close()

    def _feed(self, vibration: FloatArray | Float32Array, wanted: int | None = None) -> None:
        for first in range(0, len(vibration), PIECE_FRAMES):
            piece = vibration[first : first + PIECE_FRAMES].astype(np.float32)
            self._resampler.feed(piece)
            self._fed += len(piece)
            ready = frames_out(self._fed, self._down, self._up)
            due = (ready if wanted is None else min(ready, wanted)) - self._made
            frames = np.empty((due, self.channels), np.float32)
            self._resampler.produce(frames)
            skipped = min(due, max(0, self._to_skip - self._made))
            self._made += due
            self._output.write(frames[skipped:])


def resampled(output: VibrationOutput, samplerate: int) -> VibrationOutput:
    """Return an output that takes this sample rate in Hz: the given one, or a `ResampledOutput`."""
    return output if output.samplerate == samplerate else ResampledOutput(output, samplerate)


class Watch(Protocol):
    """Receives the vibration of a file before rate conversion. samplerate: Hz."""

    def watch(self, vibration: FloatArray | Float32Array, samplerate: int) -> None:
        """Take the next block, (frames, channels)."""

    def finish(self, power: FloatArray, samplerate: int) -> None:
        """Take the sum of the power spectra of all windows, (frequencies, channels)."""


class LeakMeter(WrappedOutput):
    """Passes vibration to an output, and measures the vibration's energy above 250 Hz.

    The meter adds the power spectra of windows of 0.33 to 0.67 s, which overlap by half. The
    squares of the windows add up to 1. At 220 Hz, the windows attenuate by at least 75 dB. Twice
    the length costs 3.6 times the CPU time. Only one thread may use a meter.
    """

    def __init__(self, output: VibrationOutput, watch: Watch | None = None) -> None:
        super().__init__(output)
        self._watch = watch
        self._hop = 1 << (self.samplerate // 6).bit_length()
        self._held = np.zeros((self.channels, (BATCH_WINDOWS + 1) * self._hop))
        self._windows = sliding_window_view(self._held, 2 * self._hop, axis=1)[:, :: self._hop]
        self._windowed = np.empty(self._windows.shape[1:])
        self._spectra = np.empty((BATCH_WINDOWS, self._hop + 1), np.complex128)
        self._filled = self._hop  # as after silence
        self._power = np.zeros((self.channels, self._hop + 1))
        self._batches = 0

    @property
    def leak_db(self) -> float | None:
        """Energy above 250 Hz in dB relative to the total energy; None for silence."""
        first = int(AUDIBLE_FROM_HZ * 2 * self._hop / self.samplerate) + 1
        above, energy = float(self._power[:, first:].sum()), float(self._power.sum())
        return amplitude_to_db(float(np.sqrt(above / energy))) if above else None

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Measure a block, (frames, channels), and pass it on."""
        check_channels(vibration, self.channels)
        if self._watch and len(vibration):
            self._watch.watch(vibration, self.samplerate)
        super().write(vibration)
        while len(vibration):
            taken = vibration[: self._held.shape[1] - self._filled]
            self._held[:, self._filled : self._filled + len(taken)] = taken.T
            self._filled += len(taken)
            vibration = vibration[len(taken) :]
            if self._filled == self._held.shape[1]:
                self._add_windows(BATCH_WINDOWS)

    def close(self) -> None:
        """Measure the last windows, and close the output."""
        self._held[:, self._filled :] = 0.0
        if self._filled > BATCH_WINDOWS * self._hop:
            self._add_windows(BATCH_WINDOWS)
            self._held[:, self._hop :] = 0.0
        self._add_windows(-(-self._filled // self._hop))
        if self._watch:
            self._watch.finish(self._power.T, self.samplerate)
        super().close()

    def _add_windows(self, count: int) -> None:
        window = _window(self._hop)
        transform = _scipy_rfft() if self._batches > LONG_BATCHES else None
        for windows, total in zip(self._windows[:, :count], self._power, strict=True):
            if transform:
                # Half the precision costs half the time; its noise is below -130 dB.
                parts = transform(np.multiply(windows, window, dtype=np.float32)).view(np.float32)
            else:
                windowed = np.multiply(windows, window, out=self._windowed[:count])
                parts = np.fft.rfft(windowed, out=self._spectra[:count]).view(np.float64)
            power = np.square(parts, out=parts).sum(axis=0)
            total += power[::2]
            total += power[1::2]
        self._held[:, : self._hop] = self._held[:, -self._hop :]
        self._filled = self._hop
        self._batches += 1


@lru_cache(maxsize=1)
def _scipy_rfft() -> Callable[[Float32Array], NDArray[np.complex64]] | None:
    """Return SciPy's transform; None if the limit of memory is too small for it."""
    try:
        from scipy.fft import rfft
    except (UsageError, MemoryError, ImportError):
        return None
    # Once a mapped block is freed, glibc's malloc keeps blocks up to its size for later calls.
    np.empty(KEPT_BYTES, np.uint8)
    return partial(rfft, overwrite_x=True)


@lru_cache(maxsize=4)
def _window(hop: int) -> FloatArray:
    """Return the power-complementary window of the Vorbis codec, (2 * hop,)."""
    phase = np.pi * (np.arange(2 * hop) + 0.5) / (2 * hop)
    return np.sin(0.5 * np.pi * np.sin(phase) ** 2)
