"""Reads descriptors from users' files: raw bytes, text of lsusb -v or this program, hex dumps.

lsusb prints each field's name and value. The prefix of the name, such as w for 2 bytes, tells the
size of a decimal value. The number of digits of a hexadecimal value tells its size.

Accepted hex dumps: xxd, hexdump -C, od -t x1, lsusb, C arrays and plain bytes. Comments begin
with #, // or ; and end with the line, or are between /* and */. A text column at the right is
ignored. Words before a colon are comments, too, unless they are an address.
"""

import re

from device.usb.descriptors.blocks import LEAST_BYTES, DescriptorError

_DUMP_BYTES = 32
_RAW_TYPES = (b"\x01", b"\x02")  # second byte of a device or configuration, never of a text

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
_SUPER_SPEED = 0x0300

# a comment, or the text that hexdump -C prints after a bar, whichever begins first
_COMMENT = re.compile(r"/\*.*?(?:\*/|$)|(?:#|//|;|\|).*")

_ADDRESS_COLON = re.compile(r"\s*([0-9a-fA-F]{4,16}):(?=\s|$)")
_FILLERS = re.compile(r"[{},\[\]]|\\x|\b0[xX](?=[0-9a-fA-F])")
_DIGITS = re.compile(r"[0-9a-fA-F]+")
_OCTAL = re.compile(r"[0-7]+")
_NEEDED = "needed: two hexadecimal digits a byte, as of xxd, hexdump -C or lsusb"
_OD_ADDRESS_DIGITS = 7
_ADDRESS_DIGITS = range(6, 17)
_SHOWN = 40


def hex_lines(raw: bytes) -> list[str]:
    """Return bytes as the lines of a hex dump that `parse_dump` can read. raw: any bytes."""
    starts = range(0, len(raw), _DUMP_BYTES)
    return [f"{at:04x}: {raw[at : at + _DUMP_BYTES].hex(' ')}" for at in starts]


def parse_dump(content: bytes) -> tuple[bytes, ...]:
    """Return the bytes of each device in a file. content: raw bytes (one device) or text.

    DescriptorError: the content has another form, or a line of the text is malformed.
    """
    if content[1:2] in _RAW_TYPES:
        return (content,)
    text = content.decode("utf-8", errors="replace").removeprefix("\N{BOM}")
    text = text.replace("\r\n", "\n")
    if not _OF_LSUSB.search(text):
        return tuple(parse_hex(part) for part in _OUR_BYTES.findall(text) or [text])
    found = [_Lsusb()]
    inside = True
    for number, line in enumerate(text.splitlines(), 1):
        if _OUTSIDE.match(line):
            inside = False
        elif match := _INSIDE.match(line):
            inside = True
            if match[1] == "Device":
                found.append(_Lsusb())
        elif inside:
            found[-1].take(line, number)
    devices = tuple(raw for one in found if (raw := one.end()))
    if not devices:
        raise DescriptorError("lsusb text: it has no descriptors; send the text of lsusb -v")
    return devices


class _Lsusb:
    """Collects the descriptors of one device from lines of lsusb."""

    def __init__(self) -> None:
        self._raw = bytearray()
        self._open = bytearray()
        self._line = 0
        self._in_junk = False
        self._ma_per_unit = 2

    def take(self, line: str, number: int) -> None:
        """Read one line; lines without descriptor fields or bytes are ignored."""
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
        """Return all bytes of the device."""
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
        """End the current descriptor; bytes that lsusb does not show become 0."""
        if self._open:
            shown, length = len(self._open), self._open[0]
            least = LEAST_BYTES.get(self._open[1] if shown > 1 else 0, 2)
            if shown < least:
                raise DescriptorError(
                    f"lsusb text, line {self._line}: {shown} of {least} bytes are shown of the "
                    "descriptor that begins here; send /sys/bus/usb/devices/PORT/descriptors"
                )
            self._raw += (self._open + bytes(length))[: max(2, length)]
        self._open = bytearray()
        self._in_junk = False


def parse_hex(text: str) -> bytes:
    """Return the bytes of a hex dump. DescriptorError: the dump is empty or invalid."""
    found = bytearray()
    base: int | None = None
    in_comment = False
    for number, line in enumerate(text.splitlines(), 1):
        try:
            colon = None if in_comment else _ADDRESS_COLON.match(line)
            if colon:
                # Two spaces separate the bytes from xxd's text column.
                column = re.split(r"\s{2,}", line[colon.end() :].strip(), maxsplit=1)[0]
                digits = _digits(column.split())
                address: int | None = int(colon[1], 16)
            else:
                content, in_comment = _without_comments(line, in_comment)
                address, digits = _line(content, base is not None)
            if address is not None:
                base = address - len(found) if base is None else base
                if address != (wanted := base + len(found)):
                    raise ValueError(
                        f"the address is 0x{address:x} instead of 0x{wanted:x}; bytes before it "
                        f"are {'missing' if address > wanted else 'too many'}"
                    )
        except ValueError as error:
            raise DescriptorError(f"hex dump, line {number}: {error}") from None
        found += bytes.fromhex(digits)
    if not found:
        raise DescriptorError(f"hex dump: it has no bytes; {_NEEDED}")
    return bytes(found)


def _without_comments(line: str, in_comment: bool) -> tuple[str, bool]:
    """Return the line without comments, and whether a comment continues on the next line."""
    if in_comment:
        _, end, line = line.partition("*/")
        if not end:
            return "", True
    continues = any(
        comment[0].startswith("/*") and (len(comment[0]) < 4 or not comment[0].endswith("*/"))
        for comment in _COMMENT.finditer(line)
    )
    return _COMMENT.sub(" ", line), continues


def _line(content: str, with_addresses: bool) -> tuple[int | None, str]:
    """Return a line's address, None without one, and the digits of its bytes."""
    label, colon, words = content.partition(":")
    if not colon or all(_DIGITS.fullmatch(word) for word in label.split()):
        words = content
    tokens = _FILLERS.sub(" ", words).split()
    if tokens == ["*"]:
        raise ValueError("'*' marks omitted lines; dump all of them (hexdump -v, od -v)")
    lengths = {len(token) for token in tokens[1:]}
    first = tokens[0] if tokens else ""
    if len(first) == _OD_ADDRESS_DIGITS and lengths == {4}:
        raise ValueError(f"{_shown(content.strip())} shows swapped bytes; use od -t x1")
    if len(first) in _ADDRESS_DIGITS and (lengths == {2} or (with_addresses and not lengths)):
        octal = len(first) == _OD_ADDRESS_DIGITS
        if not (_OCTAL if octal else _DIGITS).fullmatch(first):
            raise ValueError(f"{_shown(first)} is not {'an octal' if octal else 'an'} address")
        return int(first, 8 if octal else 16), _digits(tokens[1:])
    return None, _digits(tokens)


def _shown(text: str) -> str:
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")


def _digits(tokens: list[str]) -> str:
    for token in tokens:
        if not _DIGITS.fullmatch(token) or len(token) % 2:
            raise ValueError(f"{_shown(token)} is no byte; {_NEEDED}")
    return "".join(tokens)
