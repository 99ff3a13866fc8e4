"""Lists outputs that can play vibration, the most suitable first. The functions do no I/O."""

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

OWN_SINKS = (SINK, FALLBACK_SINK)  # sinks that this program creates

COILS, USB, SURROUND, OTHER, CARD, SOUND = range(6)
"""Ranks: voice coils, USB card, card with four or more channels, other sink, card without a server,
and the sink that plays the sound.
"""


@dataclass(frozen=True)
class Output:
    """A possible output for vibration."""

    address: str  # address for `--device`
    description: str
    rank: int  # a lower rank is more suitable
    note: str  # reason for the rank
    positions: tuple[str, ...] = ()  # positions of the channels; empty if unknown
    has_coils: bool = False  # whether the channels that drive coils are known


def list_outputs(
    snapshot: ServerSnapshot, devices: Sequence[UsbAudioDevice], playbacks: Iterable[AlsaDevice]
) -> list[Output]:
    """Return all sinks except this program's own, and all sound cards that no sink uses."""
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
    """Return advice on which channels of a sink can drive actuators; "" for none."""
    if has_coils(sink):
        if sink.channels < 4:
            return "its voice coils need a profile with 4 channels; see the sound settings"
        return "vibration goes to its voice coils, channels 3 and 4; it needs no [[actuator]]"
    if len(sink.positions) < 4:
        return ""
    pair = ", ".join(f'"{name}"' for name in shaker_pair(sink.positions))
    return f"to use two of its channels alone, write: [[actuator]] channels = [{pair}]"


def shaker_pair(positions: Sequence[str]) -> tuple[str, ...]:
    """Return two of at least four channels: the side channels, else the third and the fourth."""
    sides = ("side-left", "side-right")
    return sides if set(sides) <= set(positions) else tuple(positions[2:4])


def has_coils(sink: Sink) -> bool:
    """Return whether a sink belongs to a USB device whose channels for voice coils are known."""
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
        address = ""  # several sinks of one device share this address
    address = address or f"sink:{sink.name}"
    return Output(address, sink.description, rank, note, sink.positions, coils)


def _usb_address(sink: Sink, devices: Sequence[UsbAudioDevice]) -> str:
    """Return the address `usb:...` of a sink's USB device; "" for other sinks."""
    device = device_of_sink(sink, devices)
    return str(identify(device, devices)) if device else ""
