"""Writes vibration or simulated acceleration to a float32 WAV file, complete or not at all.

libsndfile is unsuitable: it does not report why a write failed, and writes the present time into
float files. python-soundfile must choose between WAV and RF64 before the first write.
"""

import os
import struct

import numpy as np

from device.atomic_file import AtomicFile
from device.errors import InternalError, WriteError
from device.units import Float32Array, FloatArray, check_channels

_SAMPLE = np.dtype("<f4")
_IEEE_FLOAT = 3  # WAVE_FORMAT_IEEE_FLOAT
_IN_DS64 = 0xFFFF_FFFF  # marks a 32-bit size in RF64 whose true value is in the ds64 chunk


class WavOutput:
    """A `VibrationOutput` that writes a float32 WAV file, or RF64 above 4 GB.

    Memory use is independent of the length of the file. Samples beyond ±1.0 are stored unchanged.
    samplerate: Hz. channels: 1 to 16383. comment: text of the RIFF INFO chunk ICMT, UTF-8. frames:
    number of frames written. The constructor, `write` and `close` raise the errors of `AtomicFile`.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        samplerate: int,
        channels: int,
        *,
        comment: str | None = None,
    ) -> None:
        self.samplerate, self.channels, self.frames = samplerate, channels, 0
        self._comment = comment
        # The final header replaces this one at the end; both have the same length.
        header = self._header()
        self._file: AtomicFile | None = AtomicFile(path)
        self._file.write(header)

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Append (frames, channels) samples, rounded to float32."""
        if self._file is None:
            raise InternalError("the WAV file is closed: nothing can be written to it")
        check_channels(vibration, self.channels)
        if vibration.size == 0:  # Python cannot cast a memoryview of an empty array to bytes
            return
        try:
            self._file.write(np.ascontiguousarray(vibration, dtype=_SAMPLE).data)
        except WriteError:
            self._file = None
            raise
        self.frames += len(vibration)

    def close(self) -> None:
        """Complete the header, check the file size, and give the file its name."""
        file, self._file = self._file, None
        if file is None:
            return
        header = self._header()
        file.overwrite(header)
        expected = len(header) + self.frames * self.channels * _SAMPLE.itemsize
        if (size := file.size()) != expected:
            file.abort()
            raise WriteError(
                f"cannot write {file.path}: only {size} of {expected} bytes are on the disk; "
                "name another folder"
            )
        file.commit()

    def abort(self) -> None:
        """Discard the file."""
        file, self._file = self._file, None
        if file is not None:
            file.abort()

    def _header(self) -> bytes:
        return wav_header(self.samplerate, self.channels, self.frames, self._comment)


def wav_header(samplerate: int, channels: int, frames: int, comment: str | None = None) -> bytes:
    """Return the header of a float32 WAV file. The length of the header is independent of `frames`.

    Chunks: ds64, fmt, fact, LIST INFO ICMT for a comment, data. A file of less than 4 GB has a JUNK
    chunk of the same size in place of ds64 (EBU Tech 3306). A larger file begins with RF64 in place
    of RIFF. InternalError: samplerate or channels does not fit into a WAV header.
    """
    frame_bytes = channels * _SAMPLE.itemsize
    if not (0 < samplerate * frame_bytes <= _IN_DS64 and 0 < channels <= 0x3FFF):
        raise InternalError(
            f"a WAV file cannot have samplerate={samplerate} Hz with channels={channels}"
        )
    bytes_a_second, bits = samplerate * frame_bytes, 8 * _SAMPLE.itemsize
    fmt = struct.pack(
        "<HHIIHHH", _IEEE_FLOAT, channels, samplerate, bytes_a_second, frame_bytes, bits, 0
    )
    info = b""
    if comment is not None:
        text = comment.encode("utf-8", "replace") + b"\0"
        info = _chunk(b"LIST", b"INFO" + _chunk(b"ICMT", text))
    samples_bytes = frames * frame_bytes
    ds64_bytes, fact_bytes, data_head_bytes = 36, 12, 8
    head_bytes = 12 + ds64_bytes + len(fmt) + 8 + fact_bytes + len(info) + data_head_bytes
    if (riff_bytes := head_bytes + samples_bytes - 8) < _IN_DS64:
        start = struct.pack("<4sI4s", b"RIFF", riff_bytes, b"WAVE") + _chunk(b"JUNK", bytes(28))
        fact, data_bytes = frames, samples_bytes
    else:
        ds64 = struct.pack("<QQQI", riff_bytes, samples_bytes, frames, 0)
        start = struct.pack("<4sI4s", b"RF64", _IN_DS64, b"WAVE") + _chunk(b"ds64", ds64)
        fact, data_bytes = _IN_DS64, _IN_DS64
    header = start + _chunk(b"fmt ", fmt) + _chunk(b"fact", struct.pack("<I", fact)) + info
    return header + struct.pack("<4sI", b"data", data_bytes)


def _chunk(name: bytes, content: bytes) -> bytes:
    """Return a RIFF chunk, padded to an even length; its size field excludes the padding."""
    return struct.pack("<4sI", name, len(content)) + content + b"\0" * (len(content) % 2)
