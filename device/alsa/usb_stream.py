"""The formats that a USB card offers, and its own clock while it plays.

Read from /proc/asound/cardN/streamM. Unknown lines are skipped, and interfaces without channels or
rates are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from device.alsa.cards import CaptureDevice, PlaybackDevice, read_text

_NUMBER = re.compile(r"\d+")
_FIXED_POINT = re.compile(r"\(0x([0-9a-f]+)\.([0-9a-f]{4})\)")


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
    """What a USB card offers in one direction, and its present state.

    running: whether the stream runs. altsetting: in use; None while it does not run.
    momentary_hz: the rate by the device's own feedback, in steps of 0.12 Hz (full speed: 0.02 Hz);
    0.0 if unknown. feedback_format: of that feedback, such as "16.16"; "" if unknown.
    """

    formats: tuple[UsbFormat, ...]
    running: bool = False
    altsetting: int | None = None
    momentary_hz: float = 0.0
    feedback_format: str = ""


def read_usb_stream(playback: PlaybackDevice) -> UsbStream | None:
    """Return what a USB playback device offers; None for other cards."""
    text = read_text(playback.card.folder / f"stream{playback.device}")
    return parse_usb_stream(text) if text else None


def read_usb_capture_stream(capture: CaptureDevice) -> UsbStream | None:
    """Return what a USB capture device offers; None for other cards."""
    text = read_text(capture.card.folder / f"stream{capture.device}")
    return parse_usb_stream(text, "Capture:") if text else None


def parse_usb_stream(text: str, side: str = "Playback:") -> UsbStream:
    """Parse one side of a stream file; `formats` is empty if the side is missing.

    side: "Playback:" or "Capture:".
    """
    status: dict[str, str] = {}
    blocks: list[dict[str, str]] = []
    for line in _lines_of(text, side):
        if line.startswith("Interface ") and "=" not in line:
            blocks.append({"Interface": line.removeprefix("Interface ")})
        elif line.startswith("Altset ") and "=" not in line:
            if blocks:
                blocks[-1]["Altset"] = line.removeprefix("Altset ")
        else:
            name, _, value = line.replace("=", ":", 1).partition(":")
            (blocks[-1] if blocks else status)[name.strip()] = value.strip()
    return UsbStream(
        formats=tuple(found for block in blocks if (found := _format(block))),
        running=status.get("Status") == "Running",
        altsetting=_first(status["Altset"]) if "Altset" in status else None,
        momentary_hz=_momentary_hz(status.get("Momentary freq", "")),
        feedback_format=status.get("Feedback Format", ""),
    )


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


def _momentary_hz(text: str) -> float:
    """Parse "48000 Hz (0x6.0000)": the fixed-point number is more precise than the whole Hz."""
    hz = float(_first(text))
    match = _FIXED_POINT.search(text)
    if match is None:
        return hz
    frames = int(match[1], 16) + int(match[2], 16) / 65_536
    return min((frames * 1000.0, frames * 8000.0), key=lambda exact: abs(exact - hz))


def _first(text: str) -> int:
    """Return the first number in the text, or 0."""
    match = _NUMBER.search(text)
    return int(match.group()) if match else 0
