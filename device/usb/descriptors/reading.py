"""Decodes bytes as a `Configuration` or a `WholeDevice`, and lists the errors in them."""

import struct
from dataclasses import dataclass, replace
from itertools import chain

from device.usb.descriptors import configuration
from device.usb.descriptors.audio_class import read_entity, read_format, read_general, read_header
from device.usb.descriptors.blocks import (
    ASSOCIATION,
    CONFIGURATION,
    CS_INTERFACE,
    DEVICE,
    ENDPOINT,
    INTERFACE,
    LEAST_BYTES,
    Block,
    DescriptorError,
    Findings,
    blocks,
)
from device.usb.descriptors.checks import check
from device.usb.descriptors.playback import playback_formats
from device.values import counted

_BYTES_MAX = 0xFFFF  # largest wTotalLength; later bytes are not read


@dataclass(frozen=True, slots=True)
class WholeDevice:
    """A device and its configurations, in the device's order.

    device: its descriptor; None if the bytes begin with a configuration. configurations: all that
    are readable. rest: undecoded bytes at the end. raw: all bytes.
    """

    device: configuration.DeviceDescriptor | None
    configurations: tuple[configuration.Configuration, ...]
    rest: bytes
    raw: bytes

    @property
    def problem(self) -> str:
        """One line on unreadable configurations and undecoded bytes; "" if there are none."""
        found, wanted = len(self.configurations), self.device.configurations if self.device else 0
        problems = []
        if found < wanted:
            problems.append(f"{found} of {counted(wanted, 'configurations')} can be read")
        if self.rest:
            at = len(self.raw) - len(self.rest)
            left = counted(len(self.rest), "bytes")
            problems.append(f"from 0x{at:04x} on, {left} cannot be read")
        return "; ".join(problems)

    def active(self, value: int | None) -> configuration.Configuration | None:
        """Return the configuration of this value, else the first that can play, else the first."""
        selected = (one for one in self.configurations if one.value == value)
        playing = (one for one in self.configurations if playback_formats(one))
        return next(chain(selected, playing, self.configurations), None)


def parse_configuration(raw: bytes, begins_at: int = 0) -> configuration.Configuration:
    """Return the configuration at the start of the bytes.

    raw: the configuration descriptor and all descriptors that belong to it. begins_at: position of
    the first byte in the dump, for error texts. Unknown descriptors are no errors; neither are
    extra bytes beyond a descriptor's standard length.
    DescriptorError: the bytes do not begin with a configuration descriptor.
    """
    least = LEAST_BYTES[CONFIGURATION]
    if len(raw) < least or raw[0] < least or raw[1] != CONFIGURATION:
        raise DescriptorError(
            f"no configuration at 0x{begins_at:04x}: {counted(len(raw), 'bytes')} there, "
            f"{raw[:2].hex(' ') or 'none'} first; needed: {least} or more, 09 02 "
            "first, as in /sys/bus/usb/devices/PORT/descriptors"
        )
    findings = Findings(begins_at)
    if (total := int.from_bytes(raw[2:4], "little")) != len(raw):
        difference = f"{abs(total - len(raw))} {'missing' if total > len(raw) else 'too many'}"
        problem = f"it has {len(raw)} bytes, but wTotalLength is {total}: {difference}"
        findings.note(0, "configuration", problem)
    associations: list[range] = []
    interfaces: list[configuration.Interface] = []
    group: list[Block] = []
    for block in blocks(raw[:_BYTES_MAX], raw[0], findings):
        if block.type in (INTERFACE, ASSOCIATION):
            interfaces += _interface(group)
            group = []
        if block.type == ASSOCIATION and block.holds(LEAST_BYTES[ASSOCIATION]):
            associations.append(range(block.raw[2], block.raw[2] + block.raw[3]))
        group.append(block)
    interfaces += _interface(group)
    found = configuration.Configuration(
        raw[5], raw[4], tuple(associations), tuple(interfaces), (), bytes(raw)
    )
    check(found, findings)
    return replace(found, problems=findings.problems())


def parse_device(raw: bytes) -> configuration.DeviceDescriptor:
    """Return the device descriptor at the start of the bytes. DescriptorError: there is none."""
    least = LEAST_BYTES[DEVICE]
    if len(raw) < least or raw[0] < least or raw[1] != DEVICE:
        raise DescriptorError(
            f"no device descriptor: {counted(len(raw), 'bytes')} there, "
            f"{raw[:2].hex(' ') or 'none'} first; needed: {least} or more, 12 01 first"
        )
    return configuration.DeviceDescriptor(*struct.unpack_from("<2xH4xHHH3xB", raw))


def _interface(group: list[Block]) -> list[configuration.Interface]:
    """Return the alternate setting that a group of descriptors describes, in a list, or []."""
    if not group or group[0].type != INTERFACE or not group[0].holds(LEAST_BYTES[INTERFACE]):
        for block in group:
            if block.type == ENDPOINT:
                block.note("it belongs to no interface; it is ignored")
        return []
    head, *others = group
    interface = configuration.Interface(head.offset, *head.raw[2:8])
    head.name = interface.title
    uac = interface.uac
    if uac and interface.protocol not in configuration.UAC_OF_PROTOCOL:
        known = "0x00 (1.0), 0x20 (2.0) and 0x30 (3.0)"
        head.note(f"bInterfaceProtocol is 0x{interface.protocol:02x}, read as 1.0; known: {known}")
    endpoints = tuple(
        _endpoint(block)
        for block in others
        if block.type == ENDPOINT and block.holds(LEAST_BYTES[ENDPOINT])
    )
    interface = replace(interface, endpoints=endpoints)
    own = [block for block in others if block.type == CS_INTERFACE]
    if interface.is_control and uac < 3:
        headers = [read_header(block, uac) for block in own if block.subtype == 1]
        entities = (read_entity(block, uac) for block in own if block.subtype != 1)
        listed = headers[0] if headers else None
        return [replace(interface, entities=tuple(filter(None, entities)), listed=listed)]
    if interface.is_streaming:
        generals = [read_general(block, uac) for block in own if block.subtype == 1]
        formats = [read_format(block, uac) for block in own if block.subtype == 2 and uac < 3]
        general = next(filter(None, generals), None)
        # the first format of type I, or else the first format
        found = max(filter(None, formats), key=lambda each: each.subslot_bytes > 0, default=None)
        interface = replace(interface, general=general, format=found)
    return [interface]


def _endpoint(block: Block) -> configuration.Endpoint:
    raw, attributes, max_packet = block.raw, block.raw[3], block.number(4, 2)
    return configuration.Endpoint(
        block.offset,
        address=raw[2],
        transfer=configuration.Transfer(attributes & 3),
        synchronisation=configuration.Synchronisation(attributes >> 2 & 3),
        usage=configuration.Usage(attributes >> 4 & 3),
        # packet size times transactions (USB 2.0, 9.6.6)
        packet_bytes=(max_packet & 0x7FF) * (1 + (max_packet >> 11 & 3)),
        interval=raw[6],
        synch_address=raw[8] if len(raw) > 8 else 0,
    )


def parse_whole(raw: bytes) -> WholeDevice:
    """Return the device that /sys/.../descriptors or a dump contains.

    raw: the bytes. DescriptorError: raw begins with neither a device nor a configuration.
    """
    raw = bytes(raw)
    device = parse_device(raw) if raw[1:2] == bytes([DEVICE]) else None
    at = raw[0] if device else 0
    configurations: list[configuration.Configuration] = []
    while at < len(raw):
        end = at + int.from_bytes(raw[at + 2 : at + 4], "little")
        if end < at + LEAST_BYTES[CONFIGURATION] or raw[end : end + 2] != raw[at : at + 2]:
            end = len(raw)
        try:
            configurations.append(parse_configuration(raw[at:end], at))
        except DescriptorError:
            if not configurations and device is None:
                raise
            break
        at = end
    return WholeDevice(device, tuple(configurations), raw[at:], raw)
