"""A device's descriptors as a tree of text, lsusb -v in short, and as a dump for bug reports."""

from __future__ import annotations

from collections.abc import Iterator

from device.usb.descriptors.blocks import Descriptor, OtherDescriptor
from device.usb.descriptors.configuration import Configuration, Interface
from device.usb.descriptors.entities import (
    Access,
    ClockEntity,
    ClockSource,
    ControlHeader,
    EffectUnit,
    Entity,
    FeatureControl,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
    SampleRateConverter,
)
from device.usb.descriptors.names import class_name, position_names, terminal_name
from device.usb.descriptors.standard import (
    DeviceDescriptor,
    Endpoint,
    InterfaceAssociation,
    Transfer,
)
from device.usb.descriptors.streaming import (
    AudioEndpoint,
    OtherFormat,
    RateRange,
    StreamFormat,
    StreamGeneral,
    StreamGeneral3,
)

INDENT = "  "
_DUMP_BYTES = 32
_HIGH_SPEED_MBIT_S = 480.0
_LOCK_DELAY_UNITS = {1: "ms", 2: "samples"}


def describe(
    device: DeviceDescriptor | None, configuration: Configuration, speed_mbit_s: float = 0.0
) -> str:
    """Return the description of a configuration as lines of text: the tree and the problems.

    Unknown descriptors are in the tree in hex.

    Parameters
    ----------
    device : DeviceDescriptor or None
        The device, if it is known.
    configuration : Configuration
        The decoded configuration.
    speed_mbit_s : float
        Speed of the device on its bus, 0 if unknown.
    """
    lines = [_device(device)] if device else []
    at_full_speed = is_full_speed(device, configuration, speed_mbit_s)
    lines += _configuration(configuration, at_full_speed)
    lines += [f"problem: {problem}" for problem in configuration.problems]
    return "\n".join(lines)


def hex_lines(raw: bytes) -> list[str]:
    """Return bytes as the lines of a dump that `parse_hex` can read.

    Parameters
    ----------
    raw : bytes
        Any bytes.
    """
    starts = range(0, len(raw), _DUMP_BYTES)
    return [f"{at:04x}: {raw[at : at + _DUMP_BYTES].hex(' ')}" for at in starts]


def is_full_speed(
    device: DeviceDescriptor | None, configuration: Configuration, speed_mbit_s: float
) -> bool | None:
    """Whether the device counts intervals in ms, as at full and low speed; None if unknown.

    If its speed is unknown, its descriptors show it (USB 2.0, 5.5.3 to 5.8.3). Only at full speed a
    device is older than 2.0 or has short bulk packets. Only above it are packets that long.
    """
    if speed_mbit_s:
        return speed_mbit_s < _HIGH_SPEED_MBIT_S
    if configuration.is_super_speed:
        return False
    if device is not None and device.usb < 0x0200:
        return True
    for endpoint in (one for i in configuration.interfaces for one in i.endpoints):
        if endpoint.transfer is Transfer.BULK:
            return endpoint.max_packet < 512
        longest = 1_023 if endpoint.transfer is Transfer.ISOCHRONOUS else 64
        if endpoint.packet_bytes > longest:
            return False
    return None


def _device(device: DeviceDescriptor) -> str:
    return (
        f"device {device.vendor_id:04x}:{device.product_id:04x}: release {_bcd(device.release)}, "
        f"USB {_bcd(device.usb)}, {class_name(device.device_class, 0)}"
    )


def _configuration(configuration: Configuration, full_speed: bool | None) -> Iterator[str]:
    header = configuration.header
    power = "self" if header.self_powered else "bus"
    yield (
        f"configuration {header.value}: {power} powered, {header.max_power_ma} mA, "
        f"{header.total_bytes} bytes"
    )
    in_order: list[Interface | Descriptor] = [
        *configuration.interfaces,
        *configuration.associations,
        *configuration.others,
    ]
    for descriptor in sorted(in_order, key=lambda item: item.offset):
        if isinstance(descriptor, Interface):
            yield from _interface(descriptor, full_speed)
        else:
            yield INDENT + _line(descriptor)


def _interface(interface: Interface, full_speed: bool | None) -> Iterator[str]:
    name = class_name(interface.interface_class, interface.subclass)
    uac = interface.uac
    version = f", USB Audio {uac}.0" if uac else ""
    yield f"{INDENT}{interface.title}: {name}{version}"
    for descriptor in interface.descriptors:
        yield 2 * INDENT + _line(descriptor)
    for endpoint in interface.endpoints:
        line = _line(endpoint)
        if interval := _interval(endpoint, full_speed):
            line += f" ({interval})"
        yield 2 * INDENT + line
        for descriptor in endpoint.descriptors:
            yield 3 * INDENT + _line(descriptor)


def _line(descriptor: Descriptor) -> str:
    """One descriptor as one line, without the descriptors that belong to it."""
    if isinstance(descriptor, OtherDescriptor | OtherFormat):
        details = descriptor.raw.hex(" ")
    elif isinstance(descriptor, Entity):
        details = ", ".join(_entity(descriptor))
    else:
        details = ", ".join(_details(descriptor))
    return f"{descriptor.title}: {details}"


def _details(descriptor: Descriptor) -> Iterator[str]:
    match descriptor:
        case InterfaceAssociation():
            last = descriptor.first + descriptor.interfaces - 1
            yield f"interfaces {descriptor.first} to {last}"
            yield class_name(descriptor.function_class, descriptor.subclass)
        case ControlHeader():
            yield f"release {_bcd(descriptor.release)}"
            if descriptor.interfaces:
                yield f"interfaces {_ids(descriptor.interfaces)}"
        case Endpoint():
            yield from _endpoint(descriptor)
        case StreamGeneral():
            yield f"terminal {descriptor.terminal_link}"
            yield " or ".join(descriptor.encodings) or "no format"
            if descriptor.channels is not None:
                yield _channels(descriptor.channels, descriptor.channel_config or 0)
        case StreamGeneral3():
            yield f"terminal {descriptor.terminal_link}"
            yield " or ".join(descriptor.encodings) or "no format"
            yield f"channels of cluster {descriptor.cluster}"
            yield f"{descriptor.bits} bits in {descriptor.subslot_bytes} bytes"
        case StreamFormat():
            if descriptor.channels is not None:
                yield _channels(descriptor.channels, 0)
            yield f"{descriptor.bits} bits in {descriptor.subslot_bytes} bytes"
            if descriptor.samplerates is not None:
                yield _rates(descriptor.samplerates)
        case AudioEndpoint():
            yield f"attributes 0x{descriptor.attributes:02x}"
            if descriptor.samplerate_settable:
                yield "samplerate can be set"
            unit = _LOCK_DELAY_UNITS.get(descriptor.lock_delay_unit)
            if unit:
                yield f"locks within {descriptor.lock_delay} {unit}"
        case _:
            yield descriptor.raw.hex(" ")


def _entity(entity: Entity) -> Iterator[str]:
    if entity.source_ids:
        yield f"from {_ids(entity.source_ids)}"
    match entity:
        case InputTerminal():
            yield terminal_name(entity.terminal_type)
            yield _channels(entity.channels, entity.channel_config)
            if entity.clock_id is not None:
                yield f"clock {entity.clock_id}"
        case OutputTerminal():
            yield terminal_name(entity.terminal_type)
            if entity.clock_id is not None:
                yield f"clock {entity.clock_id}"
        case FeatureUnit():
            yield from _features(entity)
        case ProcessingUnit():
            yield f"type 0x{entity.process_type:04x}"
            yield _channels(entity.channels, entity.channel_config)
        case EffectUnit():
            yield f"type 0x{entity.effect_type:04x}"
        case MixerUnit():
            yield _channels(entity.channels, entity.channel_config)
        case SampleRateConverter():
            yield f"clock {entity.clock_in_id} to clock {entity.clock_out_id}"
        case ClockSource():
            yield entity.clock_kind.name.lower()
            yield f"samplerate {entity.frequency.name.lower().replace('_', '-')}"
            if entity.follows_usb_frames:
                yield "follows USB frames"
        case ClockEntity():
            yield f"controls 0x{entity.controls:02x}"


def _features(unit: FeatureUnit) -> Iterator[str]:
    for control in FeatureControl:
        for access, words in ((Access.READ_WRITE, ""), (Access.READ_ONLY, " (read only)")):
            channels = [c for c in range(len(unit.controls)) if unit.access(c, control) is access]
            if channels:
                named = ", ".join(str(channel) if channel else "master" for channel in channels)
                yield f"{control.name.lower().replace('_', ' ')} of {named}{words}"


def _endpoint(endpoint: Endpoint) -> Iterator[str]:
    yield "to the host" if endpoint.to_host else "to the device"
    yield endpoint.transfer.name.lower()
    if endpoint.transfer is Transfer.ISOCHRONOUS:
        yield endpoint.synchronisation.name.lower().replace("none", "not synchronised")
        yield endpoint.usage.name.lower().replace("_", " ")
    yield f"{endpoint.packet_bytes} bytes"
    if endpoint.synch_address:
        yield f"feedback by 0x{endpoint.synch_address:02x}"
    yield f"interval {endpoint.interval}"


def _interval(endpoint: Endpoint, full_speed: bool | None) -> str:
    """An endpoint's interval in time, "" without one; both that are possible if it is unknown."""
    slow_us, quick_us = endpoint.interval_us(True), endpoint.interval_us(False)
    if slow_us is None or quick_us is None:
        return ""
    if full_speed is None:
        return f"{quick_us} us, or {slow_us} us at full speed"
    return f"{slow_us if full_speed else quick_us} us"


def _bcd(number: int) -> str:
    """A version such as 2.01 from 0x0201; digits that are none stay hexadecimal."""
    return f"{number >> 8:x}.{number & 0xFF:02x}"


def _channels(channels: int, channel_config: int) -> str:
    positions = position_names(channel_config)
    words = "1 channel" if channels == 1 else f"{channels} channels"
    return f"{words} ({' '.join(positions)})" if positions else words


def _ids(ids: tuple[int, ...]) -> str:
    return ", ".join(str(number) for number in ids)


def _rates(rates: tuple[int, ...] | RateRange) -> str:
    if isinstance(rates, RateRange):
        return f"{rates.lowest} to {rates.highest} Hz"
    return f"{_ids(rates)} Hz" if rates else "no samplerate"
