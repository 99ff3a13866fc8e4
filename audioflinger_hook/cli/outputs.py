"""The outputs that vibration could go to, the likely ones first. Pure functions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from device.alsa.cards import AlsaDevice
from device.server import ServerSnapshot
from device.server.forwarding import SINK
from device.server.identity import identity_of
from device.server.snapshot import Sink
from device.stream.pcms import FALLBACK_SINK
from device.usb import UsbAudioDevice, identify
from device.usb.identity import coil_channels
from device.usb.mapping import device_of_sink

OWN_SINKS = (SINK, FALLBACK_SINK)  # sinks that this program makes

COILS, USB, SURROUND, OTHER, CARD, SOUND = range(6)
"""Ranks of outputs: voice coils, a USB card, four or more channels, another sink, a card that no
server uses, and the sink that plays the sound."""


@dataclass(frozen=True)
class Output:
    """One output."""

    address: str  # for `--device`
    description: str
    rank: int  # a likely one first
    note: str  # why it is likely or not
    positions: tuple[str, ...] = ()  # of its channels, empty if unknown
    has_coils: bool = False  # whether its channels with coils are known

    @property
    def is_likely(self) -> bool:
        """Whether it has what drives a shaker."""
        return self.rank <= SURROUND

    @property
    def plays_the_sound(self) -> bool:
        """Whether the computer's sound plays there, so that vibration would be heard."""
        return self.rank == SOUND


def list_outputs(
    snapshot: ServerSnapshot,
    devices: Sequence[UsbAudioDevice],
    playbacks: Iterable[AlsaDevice],
) -> list[Output]:
    """Return every output but our own sinks, from sinks, USB devices and all sound cards."""
    sinks = [sink for sink in snapshot.sinks if sink.name not in OWN_SINKS]
    found = [_of_sink(sink, snapshot, devices) for sink in sinks]
    served = {identity_of(sink).alsa_card for sink in sinks}
    found += [
        Output(
            f"hw:{playback.card.id},{playback.device}",
            f"{playback.card.name}, {playback.name}",
            CARD,
            "a card that the sound server does not use",
        )
        for playback in playbacks
        if str(playback.card.number) not in served
    ]
    return sorted(found, key=lambda output: output.rank)


def advice_for(sink: Sink) -> str:
    """Return how to play to some of four or more channels, "" for a sink with fewer."""
    if has_coils(sink):
        if sink.channels < 4:
            return "its voice coils need a profile with 4 channels; see the sound settings"
        return "vibration goes to its voice coils, channels 3 and 4; it needs no [[actuator]]"
    if len(sink.positions) < 4:
        return ""
    pair = ", ".join(f'"{name}"' for name in shaker_pair(sink.positions))
    return f"to use two of its channels alone, write: [[actuator]] channels = [{pair}]"


def shaker_pair(positions: Sequence[str]) -> tuple[str, ...]:
    """Return the two of four or more channels that are most likely free for shakers."""
    sides = ("side-left", "side-right")
    return sides if set(sides) <= set(positions) else tuple(positions[2:4])


def has_coils(sink: Sink) -> bool:
    """Whether it is known which channels of a sink drive coils."""
    known = identity_of(sink)
    return known.bus == "usb" and bool(coil_channels(known.vendor_id, known.product_id))


def _of_sink(sink: Sink, snapshot: ServerSnapshot, devices: Sequence[UsbAudioDevice]) -> Output:
    coils = has_coils(sink)
    if sink.name == snapshot.default_sink:
        rank, note = SOUND, "plays the computer's sound: vibration would be heard there"
    elif coils:
        rank, note = COILS, f"a controller with voice coils; {advice_for(sink)}"
    elif identity_of(sink).bus == "usb":
        rank, note = USB, "a USB sound card"
    elif sink.channels >= 4:
        rank, note = SURROUND, f"a card with {sink.channels} channels"
    else:
        rank, note = OTHER, "another output"
    if sink.weakened:
        note += f"; now {sink.weakened}: change that in the sound settings first"
    address = _usb_address(sink, devices)
    if any(one != sink and _usb_address(one, devices) == address for one in snapshot.sinks):
        address = ""  # its other sinks have the same address
    address = address or f"sink:{sink.name}"
    return Output(address, sink.description, rank, note, sink.positions, coils)


def _usb_address(sink: Sink, devices: Sequence[UsbAudioDevice]) -> str:
    """Return the address of a sink's USB device, which survives unplugging; "" for others."""
    device = device_of_sink(sink, devices)
    return str(identify(device, devices)) if device else ""
