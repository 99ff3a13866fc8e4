"""What a USB card offers for playback, and its own clock while it plays.

Read from /proc/asound/cardN/streamM, forgivingly: a line that is not understood is passed over, an
interface without channels or rates is left out.
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
    """Samplerates in Hz: single ones, or all from least to most. Rising, without repetition."""

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
    """One alternate setting of the streaming interface, as the kernel tells it.

    formats: ALSA's names, also of those that we do not play. bits: the resolution behind them, 0
    if it is not told. sync: of the endpoint: ASYNC (the device's clock), ADAPTIVE (follows ours),
    SYNC (the bus's) or NONE.
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
    """What a USB card plays, and what it is doing.

    running: whether it plays now. altsetting: the one in use, None while it does not.
    momentary_hz: its rate as its own feedback tells it, in Hz, on a grain of 0.12 Hz (full speed:
    0.02 Hz); 0.0 if unknown. feedback_format: of that feedback, as in "16.16"; "" if unknown.
    """

    formats: tuple[UsbFormat, ...]
    running: bool = False
    altsetting: int | None = None
    momentary_hz: float = 0.0
    feedback_format: str = ""


def read_usb_stream(playback: PlaybackDevice) -> UsbStream | None:
    """What is told of this device, None if it is not a USB card's. Any thread."""
    text = read_text(playback.card.folder / f"stream{playback.device}")
    return parse_usb_stream(text) if text else None


def read_usb_capture_stream(capture: CaptureDevice) -> UsbStream | None:
    """What a USB card offers to record, None if it is none. Any thread."""
    text = read_text(capture.card.folder / f"stream{capture.device}")
    return parse_usb_stream(text, "Capture:") if text else None


def parse_usb_stream(text: str, side: str = "Playback:") -> UsbStream:
    """What the text says of that side; without any `formats` if it says nothing. Any thread.

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
    """The lines below "Playback:" or "Capture:", up to the other one, stripped."""
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
    """From "48000 Hz (0x6.0000)": frames a (micro)frame of USB, more exactly than the whole Hz."""
    hz = float(_first(text))
    match = _FIXED_POINT.search(text)
    if match is None:
        return hz
    frames = int(match[1], 16) + int(match[2], 16) / 65_536
    return min((frames * 1000.0, frames * 8000.0), key=lambda exact: abs(exact - hz))


def _first(text: str) -> int:
    """The first number in the text, 0 if there is none."""
    match = _NUMBER.search(text)
    return int(match.group()) if match else 0
