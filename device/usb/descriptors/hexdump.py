"""Bytes from hex dumps: xxd, hexdump -C, od -t x1, lsusb, C arrays, plain.

Comments begin with #, // or ; and end with the line, or are between /* and */. A column of text at
the right is ignored. Words before a colon are comments, too, unless they are an address.
"""

from __future__ import annotations

import re

from device.usb.descriptors.blocks import DescriptorError

_COMMENT = re.compile(r"/\*.*?(?:\*/|$)|(?:#|//|;|\|).*")
"""A comment, or the text that hexdump -C shows behind a bar: whichever begins first."""

_ADDRESS_COLON = re.compile(r"\s*([0-9a-fA-F]{4,16}):(?=\s|$)")
_FILLERS = re.compile(r"[{},\[\]]|\\x|\b0[xX](?=[0-9a-fA-F])")
_DIGITS = re.compile(r"[0-9a-fA-F]+")
_OCTAL = re.compile(r"[0-7]+")
_NEEDED = "needed: two hexadecimal digits a byte, as of xxd, hexdump -C or lsusb"
_OD_ADDRESS_DIGITS = 7
_ADDRESS_DIGITS = range(6, 17)
_SHOWN = 40


def parse_hex(text: str) -> bytes:
    """Return the bytes of a hex dump, whose addresses must be continuous.

    DescriptorError: a line contains something else, bytes are missing, or the dump is empty.
    """
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
    """Return the address and the digits of a line without a colon after its address."""
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
        return _address(first), _digits(tokens[1:])
    return None, _digits(tokens)


def _address(digits: str) -> int:
    """Return the number before a line's bytes; od counts in octal."""
    octal = len(digits) == _OD_ADDRESS_DIGITS
    if not (_OCTAL if octal else _DIGITS).fullmatch(digits):
        raise ValueError(f"{_shown(digits)} is not {'an octal' if octal else 'an'} address")
    return int(digits, 8 if octal else 16)


def _shown(text: str) -> str:
    """Return a word of the dump for a message; a long word is cut."""
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")


def _digits(tokens: list[str]) -> str:
    for token in tokens:
        if not _DIGITS.fullmatch(token) or len(token) % 2:
            raise ValueError(f"{_shown(token)} is no byte; {_NEEDED}")
    return "".join(tokens)
