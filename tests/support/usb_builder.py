"""Descriptors built field by field from the specifications, with every count and length right."""

from collections.abc import Sequence

AUDIO, HID, IAD = 0x01, 0x03, 0xEF
UAC1, UAC2, UAC3 = 0x00, 0x20, 0x30

STREAMING_TERMINAL, MICROPHONE, SPEAKER, HEADPHONES, HEADSET = 0x0101, 0x0201, 0x0301, 0x0302, 0x402

MUTE_1, VOLUME_1 = 0x01, 0x02
MUTE_2, VOLUME_2 = 0x03, 0x0C
"""Both readable and writable; VOLUME_2_READ can only be read."""
VOLUME_2_READ = 0x04

ISOCHRONOUS = 0x01
ASYNCHRONOUS, ADAPTIVE, SYNCHRONOUS, FEEDBACK = 0x05, 0x09, 0x0D, 0x11
"""All of them isochronous."""
IMPLICIT = 0x20


def le(number: int, length: int) -> bytes:
    return number.to_bytes(length, "little")


def descriptor(descriptor_type: int, *fields: int | bytes) -> bytes:
    """bLength and bDescriptorType come before the fields; a number is one byte."""
    body = b"".join(bytes([field]) if isinstance(field, int) else field for field in fields)
    return bytes([2 + len(body), descriptor_type]) + body


def device(
    vendor: int = 0x1209, product: int = 1, device_class: int = 0, configurations: int = 1
) -> bytes:
    ids = le(vendor, 2) + le(product, 2) + le(0x0123, 2)
    return descriptor(1, le(0x0200, 2), device_class, 0, 0, 64, ids, 1, 2, 3, configurations)


def configuration(*parts: bytes, attributes: int = 0x80, units_of_2_ma: int = 50) -> bytes:
    """wTotalLength and bNumInterfaces are counted."""
    body = b"".join(parts)
    numbers = {block[2] for block in split(body) if block[1] == 4}
    return configuration_of(body, len(numbers), attributes, units_of_2_ma)


def configuration_of(
    body: bytes, interfaces: int, attributes: int = 0x80, units_of_2_ma: int = 50
) -> bytes:
    return descriptor(2, le(9 + len(body), 2), interfaces, 1, 0, attributes, units_of_2_ma) + body


def split(raw: bytes) -> list[bytes]:
    found = []
    while raw:
        found.append(raw[: raw[0]])
        raw = raw[raw[0] :]
    return found


def numbered(configuration: bytes, value: int) -> bytes:
    return configuration[:5] + bytes([value]) + configuration[6:]


def association(first: int, count: int, protocol: int = UAC2, subclass: int = 0) -> bytes:
    return descriptor(0x0B, first, count, AUDIO, subclass, protocol, 0)


def interface(
    number: int, alternate: int, kind: tuple[int, int, int], *parts: bytes, extra: bytes = b""
) -> bytes:
    """bNumEndpoints is counted. kind: class, subclass, protocol."""
    endpoints = sum(block[1] == 5 for part in parts for block in split(part))
    return descriptor(4, number, alternate, endpoints, *kind, 0, extra) + b"".join(parts)


def control(number: int, protocol: int, *parts: bytes) -> bytes:
    return interface(number, 0, (AUDIO, 1, protocol), *parts)


def streaming(number: int, alternate: int, protocol: int, *parts: bytes) -> bytes:
    return interface(number, alternate, (AUDIO, 2, protocol), *parts)


def stream(number: int, protocol: int, *parts: bytes) -> bytes:
    """An interface that is silent at first, and its alternate setting 1."""
    silent = streaming(number, 0, protocol)
    end = stream_endpoint_1() if protocol == UAC1 else stream_endpoint_2()
    return silent + streaming(number, 1, protocol, *parts, end)


def class_specific(*fields: int | bytes) -> bytes:
    """The first field is the subtype."""
    return descriptor(0x24, *fields)


def listed(numbers: Sequence[int], size: int = 1) -> bytes:
    return b"".join(le(number, size) for number in numbers)


def counted(numbers: Sequence[int], size: int = 1) -> bytes:
    """How many they are, and they."""
    return bytes([len(numbers)]) + listed(numbers, size)


def endpoint(
    address: int, attributes: int, packet: int, interval: int = 1, extra: bytes = b""
) -> bytes:
    return descriptor(5, address, attributes, le(packet, 2), interval, extra)


def audio_endpoint_1(
    address: int, attributes: int, packet: int, refresh: int = 0, synch: int = 0, interval: int = 1
) -> bytes:
    """The 9 bytes of USB Audio 1.0."""
    return endpoint(address, attributes, packet, interval, bytes([refresh, synch]))


def header_1(interfaces: Sequence[int], *parts: bytes) -> bytes:
    """The header with what follows it, of which wTotalLength counts all."""
    body = b"".join(parts)
    total = 8 + len(interfaces) + len(body)
    return class_specific(1, le(0x0100, 2), le(total, 2), counted(interfaces)) + body


def input_1(number: int, terminal: int, channels: int, config: int) -> bytes:
    return class_specific(2, number, le(terminal, 2), 0, channels, le(config, 2), 0, 0)


def output_1(number: int, terminal: int, source: int) -> bytes:
    return class_specific(3, number, le(terminal, 2), 0, source, 0)


def selector_1(number: int, sources: Sequence[int]) -> bytes:
    return class_specific(5, number, counted(sources), 0)


def feature_1(number: int, source: int, controls: Sequence[int], size: int = 1) -> bytes:
    """controls: the master's bit map first."""
    return class_specific(6, number, source, size, listed(controls, size), 0)


def processing_1(
    number: int, kind: int, sources: Sequence[int], channels: int, subtype: int = 7
) -> bytes:
    end = (channels, le(0, 2), 0, 1, 1, 0)
    return class_specific(subtype, number, le(kind, 2), counted(sources), *end)


def general_1(terminal: int, tag: int = 1) -> bytes:
    return class_specific(1, terminal, 1, le(tag, 2))


def format_1(channels: int, subslot: int, bits: int, rates: Sequence[int]) -> bytes:
    return class_specific(2, 1, channels, subslot, bits, counted(rates, 3))


def format_1_range(channels: int, subslot: int, bits: int, lowest: int, highest: int) -> bytes:
    return class_specific(2, 1, channels, subslot, bits, 0, le(lowest, 3), le(highest, 3))


def stream_endpoint_1(extra: bytes = b"") -> bytes:
    return descriptor(0x25, 1, 1, 1, le(2, 2), extra)


def header_2(*parts: bytes) -> bytes:
    body = b"".join(parts)
    return class_specific(1, le(0x0200, 2), 8, le(9 + len(body), 2), 0) + body


def clock_source(number: int, attributes: int = 3, controls: int = 7) -> bytes:
    return class_specific(0x0A, number, attributes, controls, 0, 0)


def clock_selector(number: int, sources: Sequence[int]) -> bytes:
    return class_specific(0x0B, number, counted(sources), 3, 0)


def input_2(number: int, terminal: int, clock: int, channels: int, config: int) -> bytes:
    end = (channels, le(config, 4), bytes(4))
    return class_specific(2, number, le(terminal, 2), 0, clock, *end)


def output_2(number: int, terminal: int, source: int, clock: int) -> bytes:
    return class_specific(3, number, le(terminal, 2), 0, source, clock, 0, 0, 0)


def selector_2(number: int, sources: Sequence[int]) -> bytes:
    return class_specific(5, number, counted(sources), 3, 0)


def feature_2(number: int, source: int, controls: Sequence[int]) -> bytes:
    return class_specific(6, number, source, listed(controls, 4), 0)


def general_2(terminal: int, channels: int, config: int, formats: int = 1) -> bytes:
    return class_specific(1, terminal, 0, 1, le(formats, 4), channels, le(config, 4), 0)


def format_2(subslot: int, bits: int) -> bytes:
    return class_specific(2, 1, subslot, bits)


def stream_endpoint_2() -> bytes:
    return descriptor(0x25, 1, 0, 0, 0, 0, 0)
