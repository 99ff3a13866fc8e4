"""Descriptors built field by field from the specifications, with every count and length right."""

from __future__ import annotations

from collections.abc import Sequence

AUDIO, HID, IAD = 0x01, 0x03, 0xEF
UAC1, UAC2, UAC3 = 0x00, 0x20, 0x30

STREAMING_TERMINAL, MICROPHONE, SPEAKER, HEADPHONES, HEADSET = 0x0101, 0x0201, 0x0301, 0x0302, 0x402

MUTE_1, VOLUME_1 = 0x01, 0x02
MUTE_2, VOLUME_2 = 0x03, 0x0C
"""Both readable and writable; VOLUME_2_READ can only be read."""
VOLUME_2_READ = 0x04

ISOCHRONOUS = 0x01
ASYNCHRONOUS, ADAPTIVE, SYNCHRONOUS = 0x04, 0x08, 0x0C
FEEDBACK, IMPLICIT = 0x10, 0x20


def le(number: int, length: int) -> bytes:
    return number.to_bytes(length, "little")


def descriptor(descriptor_type: int, body: bytes, extra: bytes = b"") -> bytes:
    """bLength and bDescriptorType come before the body; extra bytes are counted in."""
    return bytes([2 + len(body) + len(extra), descriptor_type]) + body + extra


def device(
    vendor: int = 0x1209,
    product: int = 0x0001,
    device_class: int = 0,
    usb: int = 0x0200,
    configurations: int = 1,
) -> bytes:
    body = le(usb, 2) + bytes([device_class, 0, 0, 64])
    return descriptor(
        1, body + le(vendor, 2) + le(product, 2) + le(0x0123, 2) + bytes([1, 2, 3, configurations])
    )


def configuration(*parts: bytes, attributes: int = 0x80, units_of_2_ma: int = 50) -> bytes:
    """wTotalLength and bNumInterfaces are counted."""
    body = b"".join(parts)
    numbers = {block[2] for block in split(body) if block[1] == 4}
    return configuration_of(body, len(numbers), attributes, units_of_2_ma)


def configuration_of(
    body: bytes, interfaces: int, attributes: int = 0x80, units_of_2_ma: int = 50
) -> bytes:
    """A configuration of any bytes, descriptors or not."""
    total = le(9 + len(body), 2)
    return descriptor(2, total + bytes([interfaces, 1, 0, attributes, units_of_2_ma])) + body


def split(raw: bytes) -> list[bytes]:
    """The descriptors of well-formed bytes."""
    found = []
    while raw:
        found.append(raw[: raw[0]])
        raw = raw[raw[0] :]
    return found


def numbered(configuration: bytes, value: int) -> bytes:
    """A configuration with another number."""
    return configuration[:5] + bytes([value]) + configuration[6:]


def association(first: int, count: int, protocol: int = UAC2, subclass: int = 0) -> bytes:
    return descriptor(0x0B, bytes([first, count, AUDIO, subclass, protocol, 0]))


def interface(
    number: int, alternate: int, kind: tuple[int, int, int], *parts: bytes, extra: bytes = b""
) -> bytes:
    """bNumEndpoints is counted. kind: class, subclass, protocol."""
    endpoints = sum(block[1] == 5 for part in parts for block in split(part))
    head = descriptor(4, bytes([number, alternate, endpoints, *kind, 0]), extra)
    return head + b"".join(parts)


def control(number: int, protocol: int, *parts: bytes) -> bytes:
    return interface(number, 0, (AUDIO, 1, protocol), *parts)


def streaming(number: int, alternate: int, protocol: int, *parts: bytes) -> bytes:
    return interface(number, alternate, (AUDIO, 2, protocol), *parts)


def class_specific(subtype: int, body: bytes, extra: bytes = b"") -> bytes:
    return descriptor(0x24, bytes([subtype]) + body, extra)


def endpoint(address: int, attributes: int, packet: int, interval: int = 1) -> bytes:
    return descriptor(5, bytes([address, attributes]) + le(packet, 2) + bytes([interval]))


def audio_endpoint_1(
    address: int, attributes: int, packet: int, refresh: int = 0, synch: int = 0
) -> bytes:
    """The 9 bytes of USB Audio 1.0."""
    body = bytes([address, attributes]) + le(packet, 2) + bytes([1, refresh, synch])
    return descriptor(5, body)


# ------------------------------------------------------------------------------- USB Audio 1.0


def header_1(interfaces: Sequence[int], *parts: bytes) -> bytes:
    """The header with what follows it, of which wTotalLength counts all."""
    body = b"".join(parts)
    total = 8 + len(interfaces) + len(body)
    fields = le(0x0100, 2) + le(total, 2) + bytes([len(interfaces), *interfaces])
    return class_specific(1, fields) + body


def input_1(number: int, terminal: int, channels: int, config: int, associated: int = 0) -> bytes:
    head = bytes([number]) + le(terminal, 2) + bytes([associated, channels])
    return class_specific(2, head + le(config, 2) + bytes(2))


def output_1(number: int, terminal: int, source: int, associated: int = 0) -> bytes:
    return class_specific(3, bytes([number]) + le(terminal, 2) + bytes([associated, source, 0]))


def mixer_1(number: int, sources: Sequence[int], channels: int, config: int) -> bytes:
    pins = bytes([number, len(sources), *sources, channels])
    return class_specific(4, pins + le(config, 2) + bytes([0, 0xFF, 0]))


def selector_1(number: int, sources: Sequence[int]) -> bytes:
    return class_specific(5, bytes([number, len(sources), *sources, 0]))


def feature_1(number: int, source: int, controls: Sequence[int], size: int = 1) -> bytes:
    """controls: the master's bit map first."""
    maps = b"".join(le(bits, size) for bits in controls)
    return class_specific(6, bytes([number, source, size]) + maps + bytes(1))


def processing_1(
    number: int, kind: int, sources: Sequence[int], channels: int, subtype: int = 7
) -> bytes:
    pins = bytes([number]) + le(kind, 2) + bytes([len(sources), *sources, channels])
    return class_specific(subtype, pins + le(0, 2) + bytes([0, 1, 1, 0]))


def general_1(terminal: int, tag: int = 1) -> bytes:
    return class_specific(1, bytes([terminal, 1]) + le(tag, 2))


def format_1(channels: int, subslot: int, bits: int, rates: Sequence[int]) -> bytes:
    discrete = bytes([len(rates)]) + b"".join(le(rate, 3) for rate in rates)
    return class_specific(2, bytes([1, channels, subslot, bits]) + discrete)


def format_1_range(channels: int, subslot: int, bits: int, lowest: int, highest: int) -> bytes:
    body = bytes([1, channels, subslot, bits, 0]) + le(lowest, 3) + le(highest, 3)
    return class_specific(2, body)


def stream_endpoint_1(attributes: int = 1, extra: bytes = b"") -> bytes:
    return descriptor(0x25, bytes([1, attributes, 1]) + le(2, 2), extra)


# ------------------------------------------------------------------------------- USB Audio 2.0


def header_2(*parts: bytes) -> bytes:
    body = b"".join(parts)
    return class_specific(1, le(0x0200, 2) + bytes([8]) + le(9 + len(body), 2) + bytes(1)) + body


def clock_source(number: int, attributes: int = 3, controls: int = 7) -> bytes:
    return class_specific(0x0A, bytes([number, attributes, controls, 0, 0]))


def clock_selector(number: int, sources: Sequence[int]) -> bytes:
    return class_specific(0x0B, bytes([number, len(sources), *sources, 3, 0]))


def clock_multiplier(number: int, source: int) -> bytes:
    return class_specific(0x0C, bytes([number, source, 5, 0]))


def input_2(number: int, terminal: int, clock: int, channels: int, config: int) -> bytes:
    head = bytes([number]) + le(terminal, 2) + bytes([0, clock, channels])
    return class_specific(2, head + le(config, 4) + bytes(4))


def output_2(number: int, terminal: int, source: int, clock: int) -> bytes:
    return class_specific(3, bytes([number]) + le(terminal, 2) + bytes([0, source, clock, 0, 0, 0]))


def mixer_2(number: int, sources: Sequence[int], channels: int, config: int) -> bytes:
    pins = bytes([number, len(sources), *sources, channels])
    return class_specific(4, pins + le(config, 4) + bytes([0, 0xF0, 0, 0]))


def selector_2(number: int, sources: Sequence[int]) -> bytes:
    return class_specific(5, bytes([number, len(sources), *sources, 3, 0]))


def feature_2(number: int, source: int, controls: Sequence[int]) -> bytes:
    maps = b"".join(le(bits, 4) for bits in controls)
    return class_specific(6, bytes([number, source]) + maps + bytes(1))


def effect_2(number: int, source: int, channels: int) -> bytes:
    maps = bytes(4 * (channels + 1))
    return class_specific(7, bytes([number]) + le(1, 2) + bytes([source]) + maps + bytes(1))


def processing_2(number: int, sources: Sequence[int], channels: int) -> bytes:
    pins = bytes([number]) + le(1, 2) + bytes([len(sources), *sources, channels])
    return class_specific(8, pins + le(0, 4) + bytes(4))


def extension_2(number: int, sources: Sequence[int], channels: int) -> bytes:
    pins = bytes([number]) + le(0x55, 2) + bytes([len(sources), *sources, channels])
    return class_specific(9, pins + le(0, 4) + bytes(3))


def converter_2(number: int, source: int, clock_in: int, clock_out: int) -> bytes:
    return class_specific(0x0D, bytes([number, source, clock_in, clock_out, 0]))


def general_2(terminal: int, channels: int, config: int, formats: int = 1) -> bytes:
    head = bytes([terminal, 0, 1]) + le(formats, 4)
    return class_specific(1, head + bytes([channels]) + le(config, 4) + bytes(1))


def format_2(subslot: int, bits: int, extra: bytes = b"") -> bytes:
    return class_specific(2, bytes([1, subslot, bits]), extra)


def stream_endpoint_2() -> bytes:
    return descriptor(0x25, bytes([1, 0, 0, 0, 0, 0]))
