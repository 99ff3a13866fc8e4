"""Bytes from the hex dumps that people send: xxd, hexdump -C, od -t x1, lsusb, C arrays, plain.

Comments begin with #, // or ; and end with the line, or stand between /* and */. A column of
text at the right is left out. Words before a colon are comments too, unless they are an address.
"""

from __future__ import annotations

import re

from device.usb.descriptors.problems import DescriptorError

_COMMENT = re.compile(r"/\*.*?(?:\*/|$)|(?:#|//|;|\|).*")
"""A comment, or the text that hexdump -C shows behind a bar: whichever begins first."""

_ADDRESS_COLON = re.compile(r"\s*([0-9a-fA-F]{4,16}):(?=\s|$)")
_FILLERS = re.compile(r"[{},\[\]]|\\x|\b0[xX](?=[0-9a-fA-F])")
_DIGITS = re.compile(r"[0-9a-fA-F]+")
_OCTAL = re.compile(r"[0-7]+")
_ALLOWED = "pairs of hexadecimal digits, as of xxd, hexdump -C or lsusb"
_OD_ADDRESS_DIGITS = 7
_ADDRESS_DIGITS = range(6, 17)
_SHOWN = 40


def parse_hex(text: str) -> bytes:
    """Return the bytes of a hex dump.

    Parameters
    ----------
    text : str
        The dump; its addresses must be continuous, so that a missing line is noticed.

    Raises
    ------
    DescriptorError
        A line holds something else, the dump has a gap, or it is empty.
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
                if address != base + len(found):
                    raise ValueError(f"address 0x{address:x} instead of 0x{base + len(found):x}")
        except ValueError as error:
            raise DescriptorError(
                f"hex dump, line {number}: {error}; allowed: {_ALLOWED}"
            ) from None
        found += bytes.fromhex(digits)
    if not found:
        raise DescriptorError(f"hex dump: it has no bytes; allowed: {_ALLOWED}")
    return bytes(found)


def _without_comments(line: str, in_comment: bool) -> tuple[str, bool]:
    """The line without comments, and whether a comment continues on the next line."""
    if in_comment:
        _, end, line = line.partition("*/")
        if not end:
            return "", True
    goes_on = any(
        comment[0].startswith("/*") and (len(comment[0]) < 4 or not comment[0].endswith("*/"))
        for comment in _COMMENT.finditer(line)
    )
    return _COMMENT.sub(" ", line), goes_on


def _line(content: str, with_addresses: bool) -> tuple[int | None, str]:
    """The address and the digits of a line without a colon after its address."""
    label, colon, words = content.partition(":")
    if not colon or all(_DIGITS.fullmatch(word) for word in label.split()):
        words = content
    tokens = _FILLERS.sub(" ", words).split()
    if tokens == ["*"]:
        raise ValueError("'*' marks omitted lines; dump without omissions")
    lengths = {len(token) for token in tokens[1:]}
    first = tokens[0] if tokens else ""
    if len(first) == _OD_ADDRESS_DIGITS and lengths == {4}:
        raise ValueError(f"{_shown(content.strip())} shows words whose bytes are swapped")
    if len(first) in _ADDRESS_DIGITS and (lengths == {2} or (with_addresses and not lengths)):
        return _address(first), _digits(tokens[1:])
    return None, _digits(tokens)


def _address(digits: str) -> int:
    """The number before a line's bytes; od counts in octal."""
    octal = len(digits) == _OD_ADDRESS_DIGITS
    if not (_OCTAL if octal else _DIGITS).fullmatch(digits):
        raise ValueError(f"{_shown(digits)} is not {'an octal' if octal else 'an'} address")
    return int(digits, 8 if octal else 16)


def _shown(text: str) -> str:
    """A word of the dump for a message; a long word is cut."""
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}...")


def _digits(tokens: list[str]) -> str:
    for token in tokens:
        if not _DIGITS.fullmatch(token) or len(token) % 2:
            raise ValueError(f"{_shown(token)} is not hexadecimal, two digits a byte")
    return "".join(tokens)
