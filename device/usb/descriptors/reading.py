"""Bytes to a `Configuration` or a `WholeDevice`: which reader each descriptor gets."""

from __future__ import annotations

from dataclasses import dataclass, replace

from device.usb.descriptors.blocks import Block, Descriptor, blocks
from device.usb.descriptors.checks import check
from device.usb.descriptors.configuration import (
    AUDIO,
    MIDI,
    Configuration,
    Interface,
    read_interface,
)
from device.usb.descriptors.control import CONTROL_READERS
from device.usb.descriptors.names import class_name, midi_name, uac3_name
from device.usb.descriptors.playback import playback_formats
from device.usb.descriptors.problems import DescriptorError, Findings
from device.usb.descriptors.standard import (
    ASSOCIATION,
    CONFIGURATION,
    DEVICE,
    ENDPOINT,
    INTERFACE,
    ConfigurationHeader,
    DeviceDescriptor,
    Endpoint,
    InterfaceAssociation,
    parse_device,
    read_association,
    read_endpoint,
    read_header,
)
from device.usb.descriptors.streaming import ENDPOINT_READERS, STREAMING_READERS

CS_DEVICE, CS_INTERFACE, CS_ENDPOINT = 0x21, 0x24, 0x25
_OF_ENDPOINTS = (CS_ENDPOINT, 0x30, 0x31)

_HID = 0x03

_MAX_POWER, _MA_PER_UNIT_SUPER_SPEED = 8, 8
"""USB 3.2, 9.6.3: bMaxPower is in units of 8 mA where the device runs in Gen X mode."""

BYTES_MAX = 0xFFFF
"""Largest value of wTotalLength; longer bytes are no configuration."""


def parse_configuration(raw: bytes, *, strict: bool = False) -> Configuration:
    """Return the decoded bytes of one configuration.

    Overlong and unknown descriptors are no problems; they keep their bytes. Time and memory grow
    linearly with the number of bytes.

    Parameters
    ----------
    raw : bytes
        The configuration descriptor and all that follows it.
    strict : bool
        Whether a deviation from the specifications raises; else `problems` lists it.

    Raises
    ------
    DescriptorError
        The bytes do not begin with a configuration descriptor; in strict mode, any problem.
    """
    raw = bytes(raw)
    findings = Findings(strict)
    header = read_header(raw[:BYTES_MAX])
    end = _end(raw, header, findings)
    tree = _Tree()
    at = len(header.raw)
    for block in blocks(raw[:end], at, findings):
        tree.take(block)
        at = block.offset + len(block.raw)
    tree.close()
    configuration = Configuration(
        header=header,
        associations=tuple(tree.associations),
        interfaces=tuple(tree.interfaces),
        others=tuple(tree.others),
        rest=raw[at:BYTES_MAX],
        problems=(),
    )
    if configuration.is_super_speed:
        units = header.raw[_MAX_POWER]
        header = replace(header, max_power_ma=_MA_PER_UNIT_SUPER_SPEED * units)
        configuration = replace(configuration, header=header)
    check(configuration, findings)
    return replace(configuration, problems=findings.problems())


def _end(raw: bytes, header: ConfigurationHeader, findings: Findings) -> int:
    """End of the configuration: all bytes, unless another one begins at wTotalLength."""
    total, end = header.total_bytes, min(len(raw), BYTES_MAX)
    if total == len(raw):
        return end
    if total >= len(header.raw) and raw[total : total + 2] == raw[:2]:
        findings.note(
            0,
            "configuration",
            f"wTotalLength is {total}, where the next configuration of {len(raw)} bytes begins",
            "the bytes of one configuration",
        )
        return total
    findings.note(
        0, "configuration", f"wTotalLength is {total}", f"{len(raw)}, as many as there are"
    )
    return end


class _Tree:
    """Gathers descriptors as they come; knows the interface and the endpoint that are open."""

    def __init__(self) -> None:
        self.associations: list[InterfaceAssociation] = []
        self.interfaces: list[Interface] = []
        self.others: list[Descriptor] = []
        self._interface: Interface | None = None
        self._descriptors: list[Descriptor] = []
        self._endpoints: list[Endpoint] = []
        self._endpoint: Endpoint | None = None
        self._of_endpoint: list[Descriptor] = []
        self._endpoint_lost = False

    def take(self, block: Block) -> None:
        """Read one descriptor and add it to the object that it belongs to."""
        kind = block.type
        if kind == INTERFACE:
            self.close()
            self._interface = read_interface(block)
            if not self._interface:
                self.others.append(block.other())
        elif kind == ENDPOINT:
            self._take_endpoint(block)
        elif kind == ASSOCIATION:
            # It begins a function, so the interface before it has ended.
            self.close()
            association = read_association(block)
            if association:
                self.associations.append(association)
            else:
                self.others.append(block.other())
        elif kind in _OF_ENDPOINTS and not self._endpoint_lost:
            self._of_endpoint.append(self._endpoint_descriptor(block))
        else:
            if kind in (DEVICE, CONFIGURATION):
                block.note("it stands within a configuration", "before all others only")
            self._descriptors.append(self._interface_descriptor(block))

    def close(self) -> None:
        """End the interface that is open."""
        self._close_endpoint()
        if self._interface:
            self.interfaces.append(
                replace(
                    self._interface,
                    descriptors=tuple(self._descriptors),
                    endpoints=tuple(self._endpoints),
                )
            )
        else:
            self.others += self._descriptors
        self._interface = None
        self._descriptors, self._endpoints = [], []
        self._endpoint_lost = False

    def _close_endpoint(self) -> None:
        if self._endpoint:
            self._endpoints.append(replace(self._endpoint, descriptors=tuple(self._of_endpoint)))
        else:
            self._descriptors += self._of_endpoint
        self._endpoint, self._of_endpoint = None, []

    def _take_endpoint(self, block: Block) -> None:
        early: list[Descriptor] = []
        if not self._endpoint:
            early, self._of_endpoint = self._of_endpoint, early
        self._close_endpoint()
        endpoint = read_endpoint(block)
        self._endpoint_lost = endpoint is None
        if endpoint and self._interface:
            self._endpoint, self._of_endpoint = endpoint, early
            return
        if endpoint:
            block.note("it stands outside of any interface", "behind an interface")
        self._descriptors += [*early, endpoint or block.other()]

    def _endpoint_descriptor(self, block: Block) -> Descriptor:
        interface = self._interface
        if block.type != CS_ENDPOINT:
            return block.other()
        uac = interface.uac if interface else None
        if interface and interface.interface_class == AUDIO and interface.subclass == MIDI:
            block.name = "MIDI endpoint"
        elif uac == 3:
            block.name = "UAC3 endpoint"
        elif interface and interface.is_streaming and uac and block.subtype == 1:
            block.name = "audio endpoint"
            if not self._endpoint:
                block.note("it stands before any endpoint", "behind its endpoint")
            return ENDPOINT_READERS[uac](block) or block.other()
        return block.other()

    def _interface_descriptor(self, block: Block) -> Descriptor:
        interface = self._interface
        if interface is None or block.type not in (CS_DEVICE, CS_INTERFACE):
            return block.other()
        if block.type == CS_DEVICE:
            block.name = "HID" if interface.interface_class == _HID else block.name
            return block.other()
        if interface.interface_class == AUDIO:
            return _audio(block, interface)
        name = class_name(interface.interface_class, interface.subclass)
        block.name = f"{name} subtype 0x{block.subtype:02x}"
        return block.other()


def _audio(block: Block, interface: Interface) -> Descriptor:
    """A class-specific descriptor of an audio interface."""
    uac = interface.uac
    if uac is None:
        name = class_name(interface.interface_class, interface.subclass)
        midi = interface.subclass == MIDI
        block.name = midi_name(block.subtype) if midi else f"{name} subtype 0x{block.subtype:02x}"
        return block.other()
    readers = STREAMING_READERS[uac] if interface.is_streaming else CONTROL_READERS.get(uac, {})
    known = readers.get(block.subtype)
    if known is None and uac == 3:
        block.name = uac3_name(interface.is_streaming, block.subtype)
        return block.other()
    if known is None:
        name = class_name(interface.interface_class, interface.subclass)
        block.name = f"UAC{uac} {name} subtype 0x{block.subtype:02x}"
        return block.other()
    block.name, read = known
    return read(block) or block.other()


_DEVICE = 0x01
CONFIGURATION_BYTES = 9


@dataclass(frozen=True, slots=True)
class WholeDevice:
    """A device with all its configurations.

    Attributes
    ----------
    device : DeviceDescriptor or None
        None where the bytes begin with a configuration.
    configurations : tuple of Configuration
        In the device's order.
    rest : bytes
        Undecoded bytes at the end.
    """

    device: DeviceDescriptor | None
    configurations: tuple[Configuration, ...]
    rest: bytes

    def active(self, value: int | None) -> Configuration | None:
        """The configuration that a device is in, by its number; None without any configuration.

        Where the number is unknown, it is the first that plays, or else the first.
        """
        for configuration in self.configurations:
            if configuration.header.value == value:
                return configuration
        playing = (one for one in self.configurations if playback_formats(one))
        return next(playing, self.configurations[0] if self.configurations else None)

    def raw(self) -> bytes:
        """The bytes that it was read from."""
        parts = [configuration.raw() for configuration in self.configurations]
        return b"".join([self.device.raw if self.device else b"", *parts, self.rest])


def parse_whole(raw: bytes) -> WholeDevice:
    """Return the decoded bytes of a device, as forgiving as `parse_configuration`.

    Parameters
    ----------
    raw : bytes
        The content of /sys/.../descriptors, or a dump that begins with a configuration.

    Raises
    ------
    DescriptorError
        They begin neither with a device nor with a configuration descriptor.
    """
    raw = bytes(raw)
    device = parse_device(raw) if raw[1:2] == bytes([_DEVICE]) else None
    rest = raw[len(device.raw) :] if device else raw
    configurations: list[Configuration] = []
    while rest:
        total = int.from_bytes(rest[2:4], "little")
        another = total >= CONFIGURATION_BYTES and rest[total : total + 2] == rest[:2]
        part = rest[:total] if another else rest
        try:
            configurations.append(parse_configuration(part))
        except DescriptorError:
            if not configurations and device is None:
                raise
            break
        rest = rest[len(part) :]
    return WholeDevice(device, tuple(configurations), rest)
