"""Bytes from files that people send: raw, the text of lsusb -v, our own description, a hex dump.

lsusb shows every field by its name, whose prefix says its size, or in hexadecimal with all digits.
"""

from __future__ import annotations

import re

from device.usb.descriptors.blocks import (
    ASSOCIATION,
    CONFIGURATION,
    DEVICE,
    ENDPOINT,
    INTERFACE,
    DescriptorError,
)
from device.usb.descriptors.hexdump import parse_hex

_DUMP_BYTES = 32
_RAW_TYPES = (b"\x01", b"\x02")
"""Second byte of a device's or configuration's descriptor, which no text has there."""

_OUR_BYTES = re.compile(r"^bytes:\n((?:[0-9a-f]{4,}: .*(?:\n|$))+)", re.MULTILINE)

_OF_LSUSB = re.compile(r"^[ \t]*bLength[ \t]+\d+[ \t]*$", re.MULTILINE)
_OUTSIDE = re.compile(r"\s*(?:Device Qualifier|Binary Object Store|Device Status|Hub Descriptor)\b")
_INSIDE = re.compile(r"\s*(Device|Configuration) Descriptor:")
_FIELD = re.compile(
    r"\s*(?P<name>(?:[a-z]{1,3})[A-Z]\w*|MaxPower)\s*(?:[(\[]\s*\d+[)\]])?\s+"
    r"(?P<value>0x[0-9a-fA-F]+|\d+)(?P<places>\.\d\d)?\b|\s*MaxPower\s+(?P<power>\d+)mA"
)
_PAIRS = r"(?P<pairs>(?:[0-9a-fA-F]{2}(?:\s+|$))+)"
_UNKNOWN = re.compile(rf"\s*\*\* ?(?:UNRECOGNIZED|UNRECOGNISED).*?:\s*{_PAIRS}$")
_LONELY = re.compile(rf"\s*{_PAIRS}$")
_JUNK = re.compile(
    r"\s*(?:Warning: )?[Jj]unk at (?:end of descriptor|descriptor end)[^:]*:(?P<more>.*)"
)

_BYTES_OF_PREFIX = {"w": 2, "wa": 2, "t": 3, "d": 4, "dw": 4, "id": 2, "bcd": 2}
_LEAST_BYTES = {DEVICE: 18, CONFIGURATION: 9, INTERFACE: 9, ENDPOINT: 7, ASSOCIATION: 8}
_SUPER_SPEED = 0x0300


def hex_lines(raw: bytes) -> list[str]:
    """Return bytes as the lines of a dump that `parse_dump` can read.

    Parameters
    ----------
    raw : bytes
        Any bytes.
    """
    starts = range(0, len(raw), _DUMP_BYTES)
    return [f"{at:04x}: {raw[at : at + _DUMP_BYTES].hex(' ')}" for at in starts]


def parse_dump(content: bytes) -> tuple[bytes, ...]:
    """Return the bytes of each device in a dump; a hex dump or a raw file has one.

    Parameters
    ----------
    content : bytes
        A file such as /sys/.../descriptors, or text.

    Raises
    ------
    DescriptorError
        The content has another form, or a line of the text is wrong.
    """
    if content[1:2] in _RAW_TYPES:
        return (content,)
    text = content.decode("utf-8", errors="replace").removeprefix("\N{BOM}")
    text = text.replace("\r\n", "\n")
    if _OF_LSUSB.search(text):
        return _devices_of_lsusb(text)
    ours = _OUR_BYTES.findall(text)
    return tuple(parse_hex(part) for part in ours or [text])


def _devices_of_lsusb(text: str) -> tuple[bytes, ...]:
    found: list[_Lsusb] = []
    inside = True
    for number, line in enumerate(text.splitlines(), 1):
        if _OUTSIDE.match(line):
            inside = False
        elif match := _INSIDE.match(line):
            inside = True
            if match[1] == "Device":
                found.append(_Lsusb())
        elif inside:
            if not found:
                found.append(_Lsusb())
            found[-1].take(line, number)
    devices = tuple(raw for one in found if (raw := one.end()))
    if not devices:
        raise DescriptorError("lsusb text: it has no descriptors; send the text of lsusb -v")
    return devices


class _Lsusb:
    """Collects the descriptors of one device, line by line."""

    def __init__(self) -> None:
        self._raw = bytearray()
        self._open = bytearray()
        self._line = 0
        self._in_junk = False
        self._ma_per_unit = 2

    def take(self, line: str, number: int) -> None:
        """Read one line; lines that only explain are ignored."""
        if match := _UNKNOWN.match(line):
            self._close()
            self._raw += bytes.fromhex(match["pairs"])
            return
        if match := _JUNK.match(line):
            self._in_junk = True
            line = match["more"]
        if self._in_junk and (match := _LONELY.match(line)):
            self._open += bytes.fromhex(match["pairs"])
            return
        self._in_junk = self._in_junk and not line.strip()
        if match := _FIELD.match(line):
            if match["name"] == "bLength":
                self._close()
                self._line = number
            if match["name"] == "bLength" or self._open:
                self._open += self._bytes(match)

    def end(self) -> bytes:
        """Return all bytes."""
        self._close()
        return bytes(self._raw)

    def _bytes(self, match: re.Match[str]) -> bytes:
        if match["power"]:
            return bytes([min(255, int(match["power"]) // self._ma_per_unit)])
        name, value, places = match["name"], match["value"], match["places"]
        if places:  # binary-coded decimal
            number, size = int(value + places[1:], 16), 2
        elif value.startswith("0x"):
            number, size = int(value, 16), (len(value) - 1) // 2
        else:
            prefix = re.match("[a-z]+", name)
            number, size = int(value), _BYTES_OF_PREFIX.get(prefix[0] if prefix else "", 1)
        if name == "bcdUSB" and number >= _SUPER_SPEED:
            self._ma_per_unit = 8
        return (number & (1 << 8 * size) - 1).to_bytes(size, "little")

    def _close(self) -> None:
        """End a descriptor; bytes at its end that lsusb does not show become 0."""
        if self._open:
            shown, length = len(self._open), self._open[0]
            least = _LEAST_BYTES.get(self._open[1] if shown > 1 else 0, 2)
            if shown < least:
                raise DescriptorError(
                    f"lsusb text, line {self._line}: {shown} of {least} bytes are shown of the "
                    "descriptor that begins here; send /sys/bus/usb/devices/PORT/descriptors"
                )
            length = max(2, length)
            self._raw += (self._open + bytes(length))[:length]
        self._open = bytearray()
        self._in_junk = False
