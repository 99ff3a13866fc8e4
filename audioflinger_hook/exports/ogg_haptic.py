"""Ogg Vorbis with haptic channels for Android: channels of sound first, then vibration.

The comment ANDROID_HAPTIC=1 or 2 states the number of haptic channels. libsndfile cannot write this
comment, and gives each stream a random serial number. Therefore this module rewrites the pages that
libsndfile writes (RFC 3533; Vorbis I specification, section 5).
"""

import struct
import zlib
from collections import deque
from pathlib import Path

import numpy as np

from audioflinger_hook.exports.sound_output import LibsndfileTarget, SoundFileOutput, resampled
from device.drive.outputs import WrappedOutput
from device.errors import InternalError, UsageError
from device.units import Float32Array, FloatArray

AUDIO_CHANNELS_MAX = 8
SERIAL = 0x48435553  # serial number of all streams, so that equal sounds give equal files
HEADERS = 3
_BITS_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_PAGE_HEAD = struct.Struct("<4sBBqIIIB")


class OggHapticOutput(WrappedOutput):
    """Writes sound and vibration to one file. Only one thread may use it.

    samplerate: of sound and vibration. file_rate: sample rate of the file, at most 200 000 Hz;
        libvorbis crashes at higher rates. Both are in Hz.
    audio_channels: 1 to 8. haptic_channels: 1 or 2. UsageError, WriteError: see `SoundFileOutput`.
    """

    def __init__(
        self, path: Path, samplerate: int, file_rate: int, audio_channels: int, haptic_channels: int
    ) -> None:
        if audio_channels > AUDIO_CHANNELS_MAX:
            raise UsageError(
                f"the format ogg-haptic cannot hold {audio_channels} channels of sound; allowed: 1 "
                f"to {AUDIO_CHANNELS_MAX}; mix some of them down first"
            )
        self._file = SoundFileOutput(
            path,
            file_rate,
            audio_channels + haptic_channels,
            "OGG",
            "VORBIS",
            target=_HapticPages(path, haptic_channels),
            level=0.1,  # 0 to 1; a low level distorts the vibration little
        )
        super().__init__(resampled(self._file, samplerate))
        self.channels = haptic_channels
        self._waiting: tuple[deque[Float32Array], ...] = (deque(), deque())
        """Blocks of sound that wait for vibration, and of vibration that wait for sound."""

    @property
    def limited_samples(self) -> int:
        """Number of samples, of sound or vibration, that were beyond full scale and clipped."""
        return self._file.limited_samples

    def hear(self, sound: Float32Array) -> None:
        """Add sound, (frames, channels), before or after the vibration of the same frames."""
        self._waiting[0].append(sound)
        self._interleave()

    def write(self, vibration: FloatArray | Float32Array) -> None:
        """Add vibration, (frames, channels)."""
        self._waiting[1].append(vibration.astype(np.float32))
        self._interleave()

    def _interleave(self) -> None:
        while all(self._waiting):
            frames = min(len(blocks[0]) for blocks in self._waiting)
            parts = [blocks.popleft() for blocks in self._waiting]
            super().write(np.hstack([part[:frames] for part in parts]))
            for blocks, part in zip(self._waiting, parts, strict=True):
                if frames < len(part):
                    blocks.appendleft(part[frames:])


class _HapticPages(LibsndfileTarget):
    """Rewrites Ogg pages with the haptic comment, a constant serial number and new checksums."""

    def __init__(self, path: Path, haptic_channels: int) -> None:
        super().__init__(path)
        self._comment = f"ANDROID_HAPTIC={haptic_channels}".encode()
        self._pending = b""
        self._packets: list[bytes] = []  # header packets
        self._open = b""  # the incomplete header packet
        self._sequence = 0

    def _store(self, content: bytes) -> None:
        self._position += len(content)
        self._size = self._position
        self._pending += content
        while (page := self._next_page()) is not None:
            self._take(*page)

    def commit(self) -> None:
        if self._pending or len(self._packets) < HEADERS:
            self.file.abort()
            raise InternalError("the Vorbis encoder wrote an incomplete stream")
        super().commit()

    def _next_page(self) -> tuple[int, int, bytes, bytes] | None:
        """Return flags, position, lacing and body of the next page; None if it is incomplete."""
        head = _PAGE_HEAD.size
        if len(self._pending) < head:
            return None
        mark, _, flags, position, _, _, _, segments = _PAGE_HEAD.unpack_from(self._pending)
        if mark != b"OggS":
            raise InternalError("the Vorbis encoder wrote no Ogg page")
        lacing = self._pending[head : head + segments]
        end = head + segments + sum(lacing)
        if len(lacing) < segments or len(self._pending) < end:
            return None
        body, self._pending = self._pending[head + segments : end], self._pending[end:]
        return flags, position, lacing, body

    def _take(self, flags: int, position: int, lacing: bytes, body: bytes) -> None:
        if len(self._packets) >= HEADERS:
            self._write(flags, position, lacing, body)
            return
        first = 0
        for length in lacing:
            self._open += body[first : first + length]
            first += length
            if length < 255:
                self._packets.append(self._open)
                self._open = b""
        if len(self._packets) == 1:
            self._write(flags, position, lacing, body)
        if len(self._packets) < HEADERS:
            return
        comment, setup = with_comment(self._packets[1], self._comment), self._packets[2]
        lacing = b"".join(
            b"\xff" * (len(packet) // 255) + bytes([len(packet) % 255])
            for packet in (comment, setup)
        )
        body = comment + setup
        continued = 0
        while lacing:
            part, lacing = lacing[:255], lacing[255:]
            length = sum(part)
            # If no packet ends on a page, the page's position is -1.
            self._write(continued, 0 if min(part) < 255 else -1, part, body[:length])
            continued, body = int(part[-1] == 255), body[length:]

    def _write(self, flags: int, position: int, lacing: bytes, body: bytes) -> None:
        def page(checksum: int) -> bytes:
            numbers = (b"OggS", 0, flags, position, SERIAL, self._sequence, checksum, len(lacing))
            return _PAGE_HEAD.pack(*numbers) + lacing + body

        self.file.write(page(ogg_checksum(page(0))))
        self._sequence += 1


def with_comment(packet: bytes, comment: bytes) -> bytes:
    """Return a Vorbis comment packet with `comment` added at its end."""
    vendor_end = 11 + int.from_bytes(packet[7:11], "little")
    count = int.from_bytes(packet[vendor_end : vendor_end + 4], "little")
    entries = packet[vendor_end + 4 :].removesuffix(b"\x01")
    added = struct.pack("<I", len(comment)) + comment
    return packet[:vendor_end] + struct.pack("<I", count + 1) + entries + added + b"\x01"


def ogg_checksum(page: bytes) -> int:
    """Return the CRC-32 of an Ogg page: zlib's polynomial, not reflected, with start value 0."""
    reversed_bits = zlib.crc32(page.translate(_BITS_REVERSED), 0xFFFF_FFFF) ^ 0xFFFF_FFFF
    return int(f"{reversed_bits:032b}"[::-1], 2)
