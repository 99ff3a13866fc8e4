"""The formats, rates and channel counts that a card offers, and the choice among them.

The offers of device M of a USB card N are read from /proc/asound/cardN/streamM. Unknown lines,
and interfaces without channels or rates, are skipped.
"""

import re
from collections.abc import Container, Sequence
from dataclasses import dataclass

from device.alsa.cards import AlsaDevice, read_hw_params, read_text
from device.errors import NotFoundError
from device.stream.sample_format import SampleFormat

MIN_HZ, MAX_HZ = 8_000, 192_000  # range of playback rates
USUAL_MIN_HZ = 44_100  # lower rates are used only if no other rate is offered
CHANNELS_MAX = 32  # largest number of channels of a stream

# Supported formats, by preference at equal resolution; 8 bits are too coarse for vibration.
PREFERRED = (SampleFormat.S32, SampleFormat.S24_3, SampleFormat.S16)

_USUAL_HZ = (44_100, 48_000, 88_200, 96_000, 176_400, 192_000)

_NUMBER = re.compile(r"\d+")
_MOMENTARY = re.compile(r"(\d+) Hz \(0x([0-9a-f]{1,8})\.([0-9a-f]{4})\)")


@dataclass(frozen=True)
class Rates:
    """Sample rates in Hz: either the rates `single`, sorted, or a range from `least` to `most`."""

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
    """One alternate setting of a USB streaming interface, as the kernel reports it."""

    interface: int
    altsetting: int
    formats: tuple[str, ...]  # names in ALSA, including unsupported formats
    channels: int
    rates: Rates
    bits: int = 0  # resolution, 0 if unknown
    sync: str = "NONE"  # or ASYNC (the device's clock), ADAPTIVE (the host's) or SYNC (the bus's)

    def __str__(self) -> str:
        return f"{'/'.join(self.formats)} with {self.channels} channels at {self.rates}"


@dataclass(frozen=True)
class UsbStream:
    """What a device of a USB card offers, for either playback or capture."""

    formats: tuple[UsbFormat, ...]
    measured_hz: float | None = None  # rate that the feedback endpoint requests during playback


@dataclass(frozen=True)
class MeasuredRate:
    """A device's rate, measured with the host's clock. nominal_hz: the rate that was requested."""

    nominal_hz: int
    measured_hz: float

    @property
    def ppm(self) -> float:
        """Deviation of the measured rate from the nominal rate in ppm."""
        return 1e6 * (self.measured_hz / self.nominal_hz - 1.0)


def measure_rate(device: AlsaDevice) -> MeasuredRate | None:
    """Return the measured rate of a USB device that is playing; None if it is not reported."""
    stream, opened = read_usb_stream(device), read_hw_params(device)
    if stream is None or stream.measured_hz is None or not opened:
        return None
    return MeasuredRate(opened[0].samplerate, stream.measured_hz)


def read_usb_stream(device: AlsaDevice) -> UsbStream | None:
    """Return what a USB playback or capture device offers; None if the card is not on USB."""
    text = read_text(device.card.folder / f"stream{device.device}")
    return parse_usb_stream(text, f"{device.kind.capitalize()}:") if text else None


def parse_usb_stream(text: str, side: str = "Playback:") -> UsbStream:
    """Parse the section `side` of a stream file; without this section there are no formats."""
    blocks: list[dict[str, str]] = []
    now: dict[str, str] = {}
    inside = False
    for line in map(str.strip, text.splitlines()):
        if line in ("Playback:", "Capture:"):
            inside = line == side
        elif not inside or not line:
            continue
        elif line.startswith("Interface ") and "=" not in line:
            blocks.append({"Interface": line.removeprefix("Interface ")})
        elif blocks and line.startswith("Altset ") and "=" not in line:
            blocks[-1]["Altset"] = line.removeprefix("Altset ")
        else:
            name, _, value = line.replace("=", ":", 1).partition(":")
            (blocks[-1] if blocks else now)[name.strip()] = value.strip()
    formats = tuple(found for block in blocks if (found := _format(block)))
    return UsbStream(formats, _measured_hz(now))


def _measured_hz(now: dict[str, str]) -> float | None:
    """Return the rate in Hz that the feedback endpoint requests; None without such an endpoint."""
    match = _MOMENTARY.match(now.get("Momentary freq", ""))
    if match is None or "Feedback Format" not in now:
        return None
    whole_hz = float(match[1])
    frames = int(match[2], 16) + int(match[3], 16) / 65_536.0
    found_hz = (frames * per_second for per_second in (1_000.0, 8_000.0))
    return next((hz for hz in found_hz if abs(hz - whole_hz) <= 1.0), whole_hz) or None


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


@dataclass(frozen=True)
class CardSetup:
    """Format, rate in Hz and channel count for opening a card."""

    sample_format: SampleFormat
    samplerate: int
    channels: int


# Assumed for cards that are not on USB: they report no formats, but nearly all support these.
ASSUMED = (UsbFormat(0, 0, ("S32_LE", "S16_LE"), 2, Rates((44_100, 48_000))),)


def list_offers(device: AlsaDevice) -> tuple[UsbFormat, ...]:
    """Return the formats that a card offers; `ASSUMED` if it is not a USB card."""
    stream = read_usb_stream(device)
    return ASSUMED if stream is None else stream.formats


def choose_setup(
    offers: Sequence[UsbFormat],
    samplerate: int,
    actuators: int,
    least_channels: int | None = None,
    without: Container[SampleFormat] = (),
) -> CardSetup:
    """Return the best setup: compare the rates first, then channel counts, then resolutions.

    Rates in order of preference: `samplerate`, its smallest multiple, the next higher rate, the
    highest lower rate. A rate below `USUAL_MIN_HZ` is chosen only if no other rate is offered. The
    best channel count is the smallest that is at least `actuators` and `least_channels`.
    offers: from `list_offers`. samplerate: wanted rate in Hz. actuators: number of needed channels.
    least_channels: fewer channels are chosen only if no offer at the best rate has as many. None
    means 2, since nearly every DAC has two outputs. without: formats that must not be chosen.
    NotFoundError: no offer is suitable; the message lists the offers.
    """
    wished = max(actuators, 2 if least_channels is None else least_channels)
    found: list[tuple[tuple[int, ...], CardSetup]] = []
    for offer in offers:
        formats = [one for one in PREFERRED if one.value in offer.formats and one not in without]
        if not actuators <= offer.channels <= CHANNELS_MAX or not formats:
            continue
        rates, multiples = offer.rates, range(samplerate, MAX_HZ + 1, samplerate)
        for rate in {*rates.single, *multiples, *_USUAL_HZ, rates.least, rates.most}:
            if rate not in rates or not MIN_HZ <= rate <= MAX_HZ:
                continue
            for one in formats:
                rank = (
                    *_rate_rank(rate, samplerate),
                    int(offer.channels < wished),
                    offer.channels if offer.channels >= wished else -offer.channels,
                    -min(offer.bits or one.bits, one.bits),
                    PREFERRED.index(one),
                )
                found.append((rank, CardSetup(one, rate, offer.channels)))
    if not found:
        there = "; ".join(map(str, offers)) or "nothing"
        raise NotFoundError(
            f"the card cannot be opened with {actuators} to {CHANNELS_MAX} channels at {MIN_HZ} "
            f"to {MAX_HZ} Hz in {', '.join(one.value for one in PREFERRED)}; it offers {there}"
        )
    return min(found, key=lambda ranked: ranked[0])[1]


def _rate_rank(rate: int, samplerate: int) -> tuple[int, int]:
    """Return the rank of a rate; the lowest rank is best."""
    if rate < USUAL_MIN_HZ:
        return 4, -rate
    if rate == samplerate:
        return 0, 0
    if rate % samplerate == 0:
        return 1, rate
    return (2, rate) if rate > samplerate else (3, -rate)
