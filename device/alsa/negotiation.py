"""How to open a card: the one of its formats, rates and channel counts that suits best. Pure."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

from device.alsa.usb_stream import Rates, UsbStream
from device.errors import NotFoundError
from device.stream.sample_format import SampleFormat

MIN_HZ, MAX_HZ = 44_100, 192_000
"""Rates that are played at. Below, vibration of every kind would pass, but hardly a card is."""

CHANNELS_MAX = 32
"""As of every stream."""

PREFERRED = (SampleFormat.S32, SampleFormat.S24_3, SampleFormat.S16)
"""Where the resolution is the same: whole words are the least work."""

_USUAL_HZ = (44_100, 48_000, 88_200, 96_000, 176_400, 192_000)


@dataclass(frozen=True)
class Offer:
    """What a card can do in one setting.

    formats: those of `PREFERRED` that it takes. bits: its resolution, 0 if it is not told.
    """

    formats: tuple[SampleFormat, ...]
    channels: int
    rates: Rates
    bits: int = 0

    def __str__(self) -> str:
        names = "/".join(one.value for one in self.formats) or "no format that is played"
        return f"{names} with {self.channels} channels at {self.rates}"


@dataclass(frozen=True)
class CardSetup:
    """How a card is opened. samplerate: Hz."""

    sample_format: SampleFormat
    samplerate: int
    channels: int


UNKNOWN = (Offer((SampleFormat.S32, SampleFormat.S16), 2, Rates((44_100, 48_000))),)
"""Of a card that tells nothing before it is opened, as those that are not USB: what nearly all do.
"""


def list_offers(stream: UsbStream | None) -> tuple[Offer, ...]:
    """What a card offers by its stream file, `UNKNOWN` for None."""
    if stream is None:
        return UNKNOWN
    return tuple(
        Offer(
            tuple(one for one in PREFERRED if one.value in found.formats),
            found.channels,
            found.rates,
            found.bits,
        )
        for found in stream.formats
    )


def choose_setup(
    offers: Sequence[Offer],
    samplerate: int,
    actuators: int,
    least_channels: int | None = None,
    without: Container[SampleFormat] = (),
) -> CardSetup:
    """The setting that suits best: by rate, then by channels, then by resolution.

    samplerate: of the mix, Hz. Best is just that; then its smallest multiple, then the next one
    above, then the highest one. actuators: as many channels are needed; least_channels: where so
    many can be had, fewer are not taken: 2 by default, since nearly every DAC has two outputs, and
    a single signal goes to both. More channels than needed are taken where there are no fewer.
    without: formats that turned out not to be there.

    Raises
    ------
    NotFoundError
        Nothing suits; says what there is.
    """
    wished = max(actuators, 2 if least_channels is None else least_channels)
    found: list[tuple[tuple[int, ...], CardSetup]] = []
    for offer in offers:
        formats = [one for one in offer.formats if one not in without]
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
    """Every rate that may turn out the best."""
    multiples = range(samplerate, MAX_HZ + 1, samplerate)
    candidates = {*rates.single, *multiples, *_USUAL_HZ, rates.least, rates.most}
    return [rate for rate in candidates if rate in rates and MIN_HZ <= rate <= MAX_HZ]


def _rate_rank(rate: int, samplerate: int) -> tuple[int, int]:
    """How well a rate suits; less is better."""
    if rate == samplerate:
        return 0, 0
    if rate % samplerate == 0:
        return 1, rate
    return (2, rate) if rate > samplerate else (3, -rate)
