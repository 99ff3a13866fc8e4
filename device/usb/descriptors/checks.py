"""Where a configuration contradicts itself: counts, lengths, ids, channels.

Every check looks at each descriptor once, so the time grows with their number and not faster.
"""

from __future__ import annotations

from collections import Counter

from device.usb.descriptors.blocks import Descriptor
from device.usb.descriptors.configuration import UAC_OF_PROTOCOL, Configuration, Interface
from device.usb.descriptors.entities import (
    ClockEntity,
    Entity,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
    SampleRateConverter,
)
from device.usb.descriptors.problems import Findings, listed
from device.usb.descriptors.standard import Endpoint, Transfer
from device.usb.descriptors.streaming import OtherFormat, StreamFormat
from device.usb.descriptors.topology import Topology, topologies


def check(configuration: Configuration, findings: Findings) -> None:
    """Note every contradiction; raises at the first in strict mode."""
    numbers = frozenset(interface.number for interface in configuration.interfaces)
    _check_counts(configuration, numbers, findings)
    functions = topologies(configuration)
    for interface in configuration.interfaces:
        function = functions.get(interface.number)
        if interface.is_control and interface.uac != 3:
            _check_control(interface, numbers, findings)
            if function and function.control is interface:
                _Function(function, findings).check()
        elif interface.is_streaming and interface.uac != 3:
            _check_streaming(interface, function, findings)


def _check_counts(
    configuration: Configuration, numbers: frozenset[int], findings: Findings
) -> None:
    header = configuration.header
    if header.interfaces != len(numbers):
        findings.note(0, header.title, f"bNumInterfaces is {header.interfaces}", f"{len(numbers)}")
    settings: set[tuple[int, int]] = set()
    for interface in configuration.interfaces:
        where = (interface.offset, interface.title)
        if (interface.number, interface.alternate) in settings:
            findings.note(*where, "it is there already", "each alternate setting once")
        settings.add((interface.number, interface.alternate))
        if interface.endpoint_count != len(interface.endpoints):
            found = f"bNumEndpoints is {interface.endpoint_count}"
            findings.note(*where, found, f"{len(interface.endpoints)}, as many as follow")
    for association in configuration.associations:
        count = association.interfaces
        spanned = range(association.first, association.first + count)
        if not count or not numbers.issuperset(spanned):
            found = f"bInterfaceCount is {count} from interface {association.first} on"
            allowed = f"interfaces that are there: {listed(numbers)}"
            findings.note(association.offset, association.title, found, allowed)


def _check_control(interface: Interface, numbers: frozenset[int], findings: Findings) -> None:
    header = interface.header
    if header is None:
        found = "no audio control header that can be read"
        findings.note(interface.offset, interface.title, found, "one")
        return
    release = header.release >> 8
    if interface.protocol in UAC_OF_PROTOCOL and release != interface.uac:
        findings.note(
            header.offset,
            header.title,
            f"bcdADC is 0x{header.release:04x} in an interface of USB Audio {interface.uac}.0",
            f"0x{interface.uac:02x}00",
        )
    missing = next((number for number in header.interfaces if number not in numbers), None)
    if missing is not None:
        found = f"bInCollection lists interface {missing}"
        allowed = f"interfaces that are there: {listed(numbers)}"
        findings.note(header.offset, header.title, found, allowed)
    class_specific = sum(len(d.raw) for d in interface.descriptors if d.raw[1] == header.raw[1])
    if header.total_bytes != class_specific:
        allowed = f"{class_specific}, the bytes that follow it included"
        findings.note(header.offset, header.title, f"wTotalLength is {header.total_bytes}", allowed)


class _Function:
    """The entities of one audio function."""

    def __init__(self, function: Topology, findings: Findings) -> None:
        self._function = function
        self._findings = findings
        entities = function.entities.values()
        clocks = {entity.id for entity in entities if isinstance(entity, ClockEntity)}
        ends = {entity.id for entity in entities if isinstance(entity, OutputTerminal)}
        self._clocks = frozenset(clocks)
        self._sources = frozenset(function.entities) - clocks - ends

    def check(self) -> None:
        """Note problems of ids, clocks and channels."""
        for entity in self._function.control.entities:
            if not entity.id:
                self._note(entity, "its id is 0", "1 to 255")
            if self._function.entities[entity.id] is not entity:
                self._note(entity, f"id {entity.id} is taken already", "each id once")
                continue
            self._check_sources(entity)
            self._check_clocks(entity)
            self._check_channels(entity)
        circle = self._function.circle()
        if circle:
            way = " from ".join(str(number) for number in (*circle[:8], circle[0]))
            first = self._function.entities[circle[0]]
            self._note(first, f"its input comes from itself: {way}", "no circle")

    def _check_sources(self, entity: Entity) -> None:
        of_clock = isinstance(entity, ClockEntity)
        allowed = self._clocks if of_clock else self._sources
        wrong = [source for source in entity.source_ids if source not in allowed]
        if wrong:
            what = "clock" if of_clock else "unit or input terminal"
            self._note(entity, f"source id {wrong[0]} is of no {what}", listed(allowed))

    def _check_clocks(self, entity: Entity) -> None:
        ids: tuple[int, ...]
        if isinstance(entity, InputTerminal | OutputTerminal):
            ids = () if entity.clock_id is None else (entity.clock_id,)
        elif isinstance(entity, SampleRateConverter):
            ids = (entity.clock_in_id, entity.clock_out_id)
        else:
            return
        for clock_id in ids:
            if clock_id not in self._clocks:
                self._note(entity, f"clock id {clock_id} is of no clock", listed(self._clocks))

    def _check_channels(self, entity: Entity) -> None:
        if isinstance(entity, InputTerminal | MixerUnit | ProcessingUnit):
            positions = entity.channel_config.bit_count()
            if positions > entity.channels:
                found = f"bNrChannels is {entity.channels}, with {positions} positions"
                self._note(entity, found, f"{positions} or more")
        elif isinstance(entity, FeatureUnit):
            channels = self._function.channels(entity.id)
            maps = len(entity.controls)
            if channels is not None and maps != channels + 1:
                found = f"it has bit maps of {maps} channels, master included"
                self._note(entity, found, f"{channels + 1}, since {channels} come in")

    def _note(self, where: Descriptor, found: str, allowed: str) -> None:
        self._findings.note(where.offset, where.title, found, allowed)


def _check_streaming(interface: Interface, function: Topology | None, findings: Findings) -> None:
    where = (interface.offset, interface.title)
    addresses = Counter(endpoint.address for endpoint in interface.endpoints)
    for endpoint in interface.endpoints:
        _check_endpoint(endpoint, addresses, findings)
    general = interface.general
    if general is None:
        if interface.endpoints:
            findings.note(*where, "it has endpoints and no streaming general", "one")
        return
    formats = sum(isinstance(d, StreamFormat | OtherFormat) for d in interface.descriptors)
    if formats != 1 and general.format_type != 0:
        findings.note(*where, f"it has {formats} format types that can be read", "one")
    terminals = function.terminals if function else {}
    terminal = terminals.get(general.terminal_link)
    if terminal is None:
        found = f"bTerminalLink is {general.terminal_link}, which is of no terminal"
        findings.note(general.offset, general.title, found, listed(terminals))
    stream_format = interface.format
    channels = general.channels
    if channels is None and stream_format:
        channels = stream_format.channels
    if general.channels == 0:
        findings.note(general.offset, general.title, "bNrChannels is 0", "1 to 255")
    if general.channel_config and general.channel_config.bit_count() > (channels or 0):
        positions = general.channel_config.bit_count()
        found = f"bNrChannels is {channels}, with {positions} positions"
        findings.note(general.offset, general.title, found, f"{positions} or more")
    if isinstance(terminal, InputTerminal) and channels and channels > terminal.channels:
        found = f"its stream has {channels} channels, {terminal.title} {terminal.channels}"
        findings.note(*where, found, f"up to {terminal.channels}")


def _check_endpoint(endpoint: Endpoint, addresses: Counter[int], findings: Findings) -> None:
    where = (endpoint.offset, endpoint.title)
    if addresses[endpoint.address] > 1:
        findings.note(*where, "its address is that of another", "each address once")
    if endpoint.transfer is not Transfer.ISOCHRONOUS:
        findings.note(*where, f"it is {endpoint.transfer.name.lower()}", "isochronous")
    synch = endpoint.synch_address
    if synch and synch not in addresses:
        found = f"bSynchAddress is 0x{synch:02x}, which is of no endpoint beside it"
        others = (a for a in addresses if a != endpoint.address)
        allowed = " or ".join(["0x00", *(f"0x{address:02x}" for address in sorted(others))])
        findings.note(*where, found, allowed)
