"""Waveform files written by libsndfile, rate conversion, measurement of energy above 250 Hz."""

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import soundfile
from scipy.signal import ellip, sosfilt

from audioflinger_hook.mixer.resampler import Resampler, frames_out
from device.atomic_file import AtomicFile
from device.drive.outputs import WrappedOutput
from device.errors import InternalError, UsageError, WriteError
from device.output import VibrationOutput
from device.units import Float32Array, FloatArray, amplitude_to_db, check_channels

BLOCK_FRAMES = 4_096
"""Frames for each call of the encoder. The constant size makes a file's bytes independent of the
caller's blocks, and limits the stack of the Vorbis encoder.
"""


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
        over = content[: self._size - self._position]
        if over:
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
    UsageError: the format does not support the rate or the channels, or the file cannot be created.
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
                f"{path}: {format} cannot hold {channels} channels at {samplerate} Hz ({error}); "
                "choose fewer channels, another --output-rate or the format wav"
            ) from None

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Append samples, (frames, channels)."""
        if self._file is None:
            raise InternalError("the sound file is closed: nothing can be written to it")
        check_channels(vibration, self.channels)
        self._held = np.concatenate((self._held, vibration.astype(np.float32)))
        whole = len(self._held) - len(self._held) % BLOCK_FRAMES
        self._encode(whole)

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
        for first in range(0, frames, BLOCK_FRAMES):
            block = self._held[first : min(frames, first + BLOCK_FRAMES)]
            beyond = np.abs(block) > 1.0
            if beyond.any():
                self.limited_samples += int(beyond.sum())
                block = np.clip(block, -1.0, 1.0)
            try:
                self._file.write(block)
            except (soundfile.LibsndfileError, RuntimeError) as error:
                self._target.failure = WriteError(f"cannot encode the sound file ({error})")
            self._raise_failure()
        self._held = self._held[frames:]

    def _raise_failure(self) -> None:
        if self._target.failure is not None:
            self.abort()
            raise self._target.failure


AUDIBLE_FROM_HZ = 250.0
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


Watch = Callable[[FloatArray | Float32Array, int], None]
"""Called with each block of vibration, (frames, channels), before rate conversion, and with the
block's rate in Hz.
"""


class LeakMeter(WrappedOutput):
    """Passes vibration to an output, and measures the vibration's energy above 250 Hz.

    The measuring filter is an elliptic high-pass of order 12. Its ripple above 250 Hz is 0.1 dB,
    and its attenuation below 230 Hz is at least 80 dB. Only one thread may use a meter.
    """

    def __init__(self, output: VibrationOutput, watch: Watch | None = None) -> None:
        super().__init__(output)
        self._watch = watch
        self._high_pass = ellip(
            12, 0.1, 80.0, AUDIBLE_FROM_HZ, "high", fs=self.samplerate, output="sos"
        )
        self._state = np.zeros((len(self._high_pass), 2, self.channels))
        self._energy = self._above = 0.0

    @property
    def leak_db(self) -> float | None:
        """Energy above 250 Hz in dB relative to the total energy; None for silence."""
        if not self._energy or not self._above:
            return None
        return amplitude_to_db(float(np.sqrt(self._above / self._energy)))

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Measure a block, (frames, channels), and pass it on."""
        check_channels(vibration, self.channels)
        if len(vibration):
            exact = vibration.astype(np.float64)
            above, self._state = sosfilt(self._high_pass, exact, axis=0, zi=self._state)
            # BLAS is not used, since its threads would compete with other workers.
            self._energy += float(np.square(exact).sum())
            self._above += float(np.square(above).sum())
            if self._watch:
                self._watch(vibration, self.samplerate)
        super().write(vibration)
