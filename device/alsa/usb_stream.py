"""The formats that a USB card offers.

Read from /proc/asound/cardN/streamM. Unknown lines are skipped, and interfaces without channels or
rates are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from device.alsa.cards import CaptureDevice, PlaybackDevice, read_text

_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class Rates:
    """Sample rates in Hz: single ones, sorted and unique, or a range from least to most."""

    single: tuple[int, ...] = ()
    least: int = 0
    most: int = 0

    def __contains__(self, samplerate: object) -> bool:
        if not isinstance(samplerate, int):
            return False
        return samplerate in self.single or 0 < self.least <= samplerate <= self.most

    def __str__(self) -> str:
        if self.least:
            return f"{self.least} to {self.most} Hz"
        return f"{', '.join(map(str, self.single))} Hz"


@dataclass(frozen=True)
class UsbFormat:
    """One alternate setting of the streaming interface, as the kernel reports it.

    formats: ALSA's names, including those that we do not play. bits: resolution, 0 if unknown.
    sync: of the endpoint: ASYNC (the device's clock), ADAPTIVE (follows the host), SYNC (the bus
    clock) or NONE.
    """

    interface: int
    altsetting: int
    formats: tuple[str, ...]
    channels: int
    rates: Rates
    bits: int
    sync: str


@dataclass(frozen=True)
class UsbStream:
    """What a USB card offers in one direction."""

    formats: tuple[UsbFormat, ...]


def read_usb_stream(device: PlaybackDevice) -> UsbStream | None:
    """Return what a USB playback or capture device offers; None for other cards."""
    text = read_text(device.card.folder / f"stream{device.device}")
    side = "Capture:" if isinstance(device, CaptureDevice) else "Playback:"
    return parse_usb_stream(text, side) if text else None


def parse_usb_stream(text: str, side: str = "Playback:") -> UsbStream:
    """Parse one side of a stream file; `formats` is empty if the side is missing.

    side: "Playback:" or "Capture:".
    """
    blocks: list[dict[str, str]] = []
    for line in _lines_of(text, side):
        if line.startswith("Interface ") and "=" not in line:
            blocks.append({"Interface": line.removeprefix("Interface ")})
        elif not blocks:
            continue  # the present state of the stream
        elif line.startswith("Altset ") and "=" not in line:
            blocks[-1]["Altset"] = line.removeprefix("Altset ")
        else:
            name, _, value = line.replace("=", ":", 1).partition(":")
            blocks[-1][name.strip()] = value.strip()
    return UsbStream(tuple(found for block in blocks if (found := _format(block))))


def _lines_of(text: str, side: str) -> Iterator[str]:
    """Yield the lines of one side, stripped."""
    inside = False
    for line in map(str.strip, text.splitlines()):
        if line in ("Playback:", "Capture:"):
            inside = line == side
        elif inside and line:
            yield line


def _format(block: dict[str, str]) -> UsbFormat | None:
    channels, rates = _first(block.get("Channels", "")), _rates(block.get("Rates", ""))
    if not channels or not (rates.single or rates.least):
        return None
    sync = re.findall(r"\((\w+)\)", block.get("Endpoint", ""))
    return UsbFormat(
        interface=_first(block["Interface"]),
        altsetting=_first(block.get("Altset", "")),
        formats=tuple(block.get("Format", "").split()),
        channels=channels,
        rates=rates,
        bits=_first(block.get("Bits", "")),
        sync=sync[-1] if sync else "NONE",
    )


def _rates(text: str) -> Rates:
    numbers = sorted({int(digits) for digits in _NUMBER.findall(text)} - {0})
    if numbers and "continuous" in text:
        return Rates(least=numbers[0], most=numbers[-1])
    return Rates(tuple(numbers))


def _first(text: str) -> int:
    """Return the first number in the text, or 0."""
    match = _NUMBER.search(text)
    return int(match.group()) if match else 0
