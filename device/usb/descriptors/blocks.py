"""Splits bytes into descriptors, and collects the error texts about them.

A descriptor begins with its length and its type, bLength and bDescriptorType (USB 2.0, 9.5).
Numbers are little-endian.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from device.errors import UsageError
from device.values import counted

PROBLEMS_MAX = 200  # number of kept error texts of one configuration, enough for a bug report

DEVICE, CONFIGURATION, INTERFACE, ENDPOINT, ASSOCIATION = 0x01, 0x02, 0x04, 0x05, 0x0B
CS_INTERFACE, CS_ENDPOINT = 0x24, 0x25

# USB 2.0, tables 9-8, 9-10, 9-12 and 9-13; associations: USB 2.0 ECN
LEAST_BYTES = {DEVICE: 18, CONFIGURATION: 9, INTERFACE: 9, ENDPOINT: 7, ASSOCIATION: 8}

_NAMES = {
    DEVICE: "device",
    CONFIGURATION: "configuration",
    0x03: "string",
    INTERFACE: "interface",
    ENDPOINT: "endpoint",
    ASSOCIATION: "interface association",
    0x0F: "binary object store",
    0x21: "class-specific device",
    CS_INTERFACE: "class-specific interface",
    CS_ENDPOINT: "class-specific endpoint",
    0x30: "SuperSpeed endpoint companion",
}


class DescriptorError(UsageError):
    """The bytes contain no readable descriptor, or the dump is malformed."""


class Findings:
    """Collects the errors in a configuration. begins_at: its first byte's position in the dump."""

    def __init__(self, begins_at: int = 0) -> None:
        self._begins_at = begins_at
        self._found: list[tuple[int, str]] = []
        self._count = 0

    def note(self, offset: int, name: str, problem: str) -> None:
        """Add an error in the descriptor at `offset`, in bytes from the configuration's start."""
        self._count += 1
        if len(self._found) < PROBLEMS_MAX:
            at = self._begins_at + offset
            self._found.append((offset, f"at 0x{at:04x}, {name}: {problem}"))

    def problems(self) -> tuple[str, ...]:
        """Return the errors sorted by position, one line each; a last line counts the rest."""
        found = [text for _, text in sorted(self._found, key=lambda problem: problem[0])]
        more = self._count - len(found)
        return (*found, counted(more, "more problems")) if more else tuple(found)


@dataclass(slots=True)
class Block:
    """The bytes of one descriptor."""

    offset: int  # bytes from the start of the configuration
    raw: bytes  # 2 bytes or more; bytes beyond the standard length are ignored
    name: str  # in error texts
    findings: Findings

    @property
    def type(self) -> int:
        """The bDescriptorType."""
        return self.raw[1]

    @property
    def subtype(self) -> int:
        """The bDescriptorSubtype of a class-specific descriptor, 0 (undefined) if missing."""
        return self.raw[2] if len(self.raw) > 2 else 0

    def number(self, at: int, length: int) -> int:
        """Return the unsigned integer of `length` bytes at position `at` of the descriptor."""
        return int.from_bytes(self.raw[at : at + length], "little")

    def note(self, problem: str) -> None:
        """Add an error in this descriptor."""
        self.findings.note(self.offset, self.name, problem)

    def holds(self, length: int) -> bool:
        """Return whether the descriptor has at least `length` bytes; if not, add an error."""
        if len(self.raw) >= length:
            return True
        self.note(f"it has {len(self.raw)} bytes, but needs {length}; it is ignored")
        return False


def _type_name(descriptor_type: int) -> str:
    return _NAMES.get(descriptor_type) or f"descriptor of type 0x{descriptor_type:02x}"


def blocks(raw: bytes, at: int, findings: Findings) -> Iterator[Block]:
    """Yield the descriptors from position `at` on; stop before an invalid bLength."""
    end = len(raw)
    while at < end:
        length, left = raw[at], end - at
        if length < 2 or left < 2:
            problem = f"bLength is {length}, so the last {counted(left, 'bytes')} cannot be read"
            findings.note(at, "descriptor", problem)
            return
        if length > left:
            problem = f"bLength is {length}, but the dump ends after {left} bytes"
            findings.note(at, _type_name(raw[at + 1]), problem)
        yield Block(at, raw[at : at + length], _type_name(raw[at + 1]), findings)
        at += length


def listed(numbers: Iterable[int], most: int = 16) -> str:
    """Return numbers as text: "1, 2 or 5", "none", or the lowest `most` numbers and "..."."""
    words = [str(number) for number in sorted(numbers)]
    if len(words) > most:
        return f"{', '.join(words[:most])} ..."
    return " or ".join(filter(None, (", ".join(words[:-1]), *words[-1:]))) or "none"
