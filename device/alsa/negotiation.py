"""The best of a card's formats, rates and channel counts. Pure functions."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

from device.alsa.usb_stream import Rates, UsbFormat, UsbStream
from device.errors import NotFoundError
from device.stream.sample_format import SampleFormat

MIN_HZ, MAX_HZ = 8_000, 192_000
"""Rates to play at. Rates under USUAL_MIN_HZ suffice, but are taken only if no other is offered."""

USUAL_MIN_HZ = 44_100

CHANNELS_MAX = 32  # the limit of every stream

PREFERRED = (SampleFormat.S32, SampleFormat.S24_3, SampleFormat.S16)
"""Supported formats, by preference at equal resolution: whole words cost least.

8 bits are too coarse for weak vibration.
"""

_USUAL_HZ = (44_100, 48_000, 88_200, 96_000, 176_400, 192_000)


@dataclass(frozen=True)
class CardSetup:
    """Format, rate in Hz and channels to open a card with."""

    sample_format: SampleFormat
    samplerate: int
    channels: int


UNKNOWN = (UsbFormat(0, 0, ("S32_LE", "S16_LE"), 2, Rates((44_100, 48_000))),)
"""What nearly all cards support; assumed for cards that are not USB, which report nothing."""


def list_offers(stream: UsbStream | None) -> tuple[UsbFormat, ...]:
    """Return the formats that a card offers by its stream file; `UNKNOWN` for None."""
    return UNKNOWN if stream is None else stream.formats


def choose_setup(
    offers: Sequence[UsbFormat],
    samplerate: int,
    actuators: int,
    least_channels: int | None = None,
    without: Container[SampleFormat] = (),
) -> CardSetup:
    """Return the best setting: by rate, then by channels, then by resolution.

    The mix's own rate is best, then its smallest multiple, the next higher rate, the highest rate.
    More channels than needed are taken where fewer are not offered.

    offers: from `list_offers`. samplerate: of the mix, in Hz. actuators: channels that are needed.
    least_channels: settings with fewer are taken only if no other exists. None stands for 2, since
    nearly every DAC has two outputs, and a single signal drives both. without: formats that turned
    out to be unsupported.

    NotFoundError: nothing suits; the message lists the offers.
    """
    wished = max(actuators, 2 if least_channels is None else least_channels)
    found: list[tuple[tuple[int, ...], CardSetup]] = []
    for offer in offers:
        names = offer.formats
        formats = [one for one in PREFERRED if one.value in names and one not in without]
        if not actuators <= offer.channels <= CHANNELS_MAX or not formats:
            continue
        for rate in _rates_to_try(offer.rates, samplerate):
            for one in formats:
                bits = min(offer.bits or one.bits, one.bits)
                rank = (
                    *_rate_rank(rate, samplerate),
                    int(offer.channels < wished),
                    offer.channels if offer.channels >= wished else -offer.channels,
                    -bits,
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


def _rates_to_try(rates: Rates, samplerate: int) -> list[int]:
    """Return all supported rates that may be best."""
    multiples = range(samplerate, MAX_HZ + 1, samplerate)
    candidates = {*rates.single, *multiples, *_USUAL_HZ, rates.least, rates.most}
    return [rate for rate in candidates if rate in rates and MIN_HZ <= rate <= MAX_HZ]


def _rate_rank(rate: int, samplerate: int) -> tuple[int, int]:
    """Return the rank of a rate; the lowest is best."""
    if rate < USUAL_MIN_HZ:
        return 4, -rate
    if rate == samplerate:
        return 0, 0
    if rate % samplerate == 0:
        return 1, rate
    return (2, rate) if rate > samplerate else (3, -rate)
