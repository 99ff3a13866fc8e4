"""The formats that a USB card offers.

Read from /proc/asound/cardN/streamM. Unknown lines are skipped, and interfaces without channels or
rates are left out.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from device.alsa.cards import AlsaDevice, read_hw_params, read_text

_NUMBER = re.compile(r"\d+")
_MOMENTARY = re.compile(r"(\d+) Hz \(0x([0-9a-f]{1,8})\.([0-9a-f]{4})\)")


@dataclass(frozen=True)
class Rates:
    """Sample rates in Hz: single ones, sorted and unique, or a range from least to most."""

    single: tuple[int, ...] = ()
    least: int = 0
    most: int = 0

    def __contains__(self, samplerate: int) -> bool:
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
    bits: int = 0
    sync: str = "NONE"

    def __str__(self) -> str:
        return f"{'/'.join(self.formats)} with {self.channels} channels at {self.rates}"


@dataclass(frozen=True)
class UsbStream:
    """What a USB card offers in one direction."""

    formats: tuple[UsbFormat, ...]
    measured_hz: float | None = None  # asked for by the feedback endpoint while it plays


@dataclass(frozen=True)
class MeasuredRate:
    """The rate of a device's own clock, by the host's. nominal_hz: as it was opened."""

    nominal_hz: int
    measured_hz: float

    @property
    def ppm(self) -> float:
        """How much faster than nominal it runs."""
        return 1e6 * (self.measured_hz / self.nominal_hz - 1.0)


def measure_rate(device: AlsaDevice) -> MeasuredRate | None:
    """Return the rate of a USB device that plays now; None if it does not say it."""
    stream, opened = read_usb_stream(device), read_hw_params(device)
    if stream is None or stream.measured_hz is None or not opened:
        return None
    return MeasuredRate(opened[0].samplerate, stream.measured_hz)


def read_usb_stream(device: AlsaDevice) -> UsbStream | None:
    """Return what a USB playback or capture device offers; None for other cards."""
    text = read_text(device.card.folder / f"stream{device.device}")
    return parse_usb_stream(text, f"{device.kind.capitalize()}:") if text else None


def parse_usb_stream(text: str, side: str = "Playback:") -> UsbStream:
    """Parse one side of a stream file; `formats` is empty if the side is missing.

    side: "Playback:" or "Capture:".
    """
    blocks: list[dict[str, str]] = []
    now: dict[str, str] = {}
    for line in _lines_of(text, side):
        if line.startswith("Interface ") and "=" not in line:
            blocks.append({"Interface": line.removeprefix("Interface ")})
        elif blocks and line.startswith("Altset ") and "=" not in line:
            blocks[-1]["Altset"] = line.removeprefix("Altset ")
        else:
            name, _, value = line.replace("=", ":", 1).partition(":")
            (blocks[-1] if blocks else now)[name.strip()] = value.strip()
    formats = tuple(found for block in blocks if (found := _format(block)))
    return UsbStream(formats, _measured_hz(now))


def _measured_hz(now: dict[str, str]) -> float | None:
    """Return the present rate, reported as whole Hz, then as frames in 1 ms or 125 us.

    Without a feedback endpoint it is only what the host assumes, so None.
    """
    match = _MOMENTARY.match(now.get("Momentary freq", ""))
    if match is None or "Feedback Format" not in now:
        return None
    whole_hz = float(match[1])
    frames = int(match[2], 16) + int(match[3], 16) / 65_536.0
    found_hz = (frames * per_second for per_second in (1_000.0, 8_000.0))
    return next((hz for hz in found_hz if abs(hz - whole_hz) <= 1.0), whole_hz) or None


def _lines_of(text: str, side: str) -> Iterator[str]:
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
    match = _NUMBER.search(text)
    return int(match[0]) if match else 0
