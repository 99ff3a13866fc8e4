"""How a device takes samples; little endian, as every format of a USB device is."""

from __future__ import annotations

from enum import Enum


class SampleFormat(Enum):
    """A sample format; the value is ALSA's name for it."""

    FLOAT32 = "FLOAT_LE"
    S16 = "S16_LE"
    S24_3 = "S24_3LE"
    """24 bits in three bytes."""
    S32 = "S32_LE"

    @property
    def bytes_per_sample(self) -> int:
        """Bytes of one sample: 4, 2, 3, 4."""
        return _BYTES[self]

    @property
    def bits(self) -> int:
        """Bits of resolution: 16, 24, 32; 25 of a float, 24 and a sign."""
        return 25 if self is SampleFormat.FLOAT32 else 8 * self.bytes_per_sample

    @property
    def full_scale(self) -> float:
        """The steps of 1.0: 2^15, 2^23, 2^31; 1 for float."""
        return 1.0 if self is SampleFormat.FLOAT32 else 2.0 ** (self.bits - 1)


_BYTES = {
    SampleFormat.FLOAT32: 4,
    SampleFormat.S16: 2,
    SampleFormat.S24_3: 3,
    SampleFormat.S32: 4,
}
