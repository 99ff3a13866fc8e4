"""Finds the contradictions that damaged dumps or faulty firmware cause in a configuration."""

from device.usb.descriptors.audio_class import CLOCKS, INPUT, OUTPUT, Entity
from device.usb.descriptors.blocks import Findings, listed
from device.usb.descriptors.configuration import Configuration, Interface, Transfer
from device.usb.descriptors.topology import Topology, topologies
from device.values import counted


def check(configuration: Configuration, findings: Findings) -> None:
    """Add the contradictions in a configuration to the findings."""
    _check_counts(configuration, findings)
    functions = topologies(configuration)
    for interface in configuration.interfaces:
        function = functions.get(interface.number)
        if interface.uac not in (1, 2):
            continue
        if interface.is_streaming:
            _check_streaming(interface, function, findings)
        elif interface.listed is None:
            findings.note(interface.offset, interface.title, "it has no audio control header")
        if function and function.control is interface:
            _check_function(function, findings)


def _check_counts(configuration: Configuration, findings: Findings) -> None:
    numbers = {interface.number for interface in configuration.interfaces}
    if configuration.interface_count != len(numbers):
        problem = f"bNumInterfaces is {configuration.interface_count}, but it has {len(numbers)}"
        findings.note(0, "configuration", problem)
    for spanned in configuration.associations:
        if not spanned or not numbers.issuperset(spanned):
            span = counted(len(spanned), "interfaces")
            problem = f"an association has {span} from {spanned.start} on; possible: "
            findings.note(0, "configuration", problem + listed(numbers))
    settings: set[tuple[int, int]] = set()
    for interface in configuration.interfaces:
        where = (interface.offset, interface.title)
        if (interface.number, interface.alternate) in settings:
            findings.note(*where, "it occurs twice")
        settings.add((interface.number, interface.alternate))
        count, wanted = len(interface.endpoints), interface.endpoint_count
        if count != wanted:
            findings.note(*where, f"bNumEndpoints is {wanted}, but it has {count}")
        if missing := sorted(set(interface.listed or ()) - numbers):
            findings.note(*where, f"its header lists interface {missing[0]}, which is missing")


def _check_function(function: Topology, findings: Findings) -> None:
    """Add errors for duplicate ids, and for references to missing ids."""
    entities = function.entities
    clocks = {entity.id for entity in entities.values() if entity.kind in CLOCKS}
    outputs = {entity.id for entity in entities.values() if entity.kind == OUTPUT}
    sources = set(entities) - clocks - outputs

    def note(entity: Entity, problem: str) -> None:
        findings.note(entity.offset, f"{entity.kind} {entity.id}", problem)

    for entity in function.control.entities:
        if entities[entity.id] is not entity:
            note(entity, "its id occurs twice")
            continue
        possible = clocks if entity.kind in CLOCKS else sources
        for source in [each for each in entity.source_ids if each not in possible][:1]:
            note(entity, f"source {source} is missing; possible: {listed(possible)}")
        for clock in [each for each in entity.clock_ids if each not in clocks][:1]:
            note(entity, f"clock {clock} is missing; possible: {listed(clocks)}")


def _check_streaming(interface: Interface, function: Topology | None, findings: Findings) -> None:
    where = (interface.offset, interface.title)
    addresses = {endpoint.address for endpoint in interface.endpoints}
    for endpoint in interface.endpoints:
        at, synch = (endpoint.offset, f"endpoint 0x{endpoint.address:02x}"), endpoint.synch_address
        if endpoint.transfer is not Transfer.ISOCHRONOUS:
            kind = endpoint.transfer.name.lower()
            findings.note(*at, f"it is {kind}, but sound needs isochronous")
        if synch and not addresses & {synch, synch | 0x80}:
            findings.note(*at, f"its feedback endpoint 0x{synch:02x} is missing")
    general, stream_format = interface.general, interface.format
    for part, name in ((general, "general"), (stream_format, "format")):
        if part is None and interface.endpoints:
            findings.note(*where, f"its {name} descriptor is missing, so it cannot be played")
    if general is None:
        return
    terminals = function.terminals if function else {}
    if (terminal := terminals.get(general.terminal_link)) is None:
        problem = f"bTerminalLink is {general.terminal_link}; terminals: {listed(terminals)}"
        findings.note(general.offset, "streaming general", problem)
    elif function and terminal.kind == INPUT:
        channels = general.channels or (stream_format.channels if stream_format else 0) or 0
        if channels > terminal.channels:
            problem = f"it has {channels} channels, but its terminal has {terminal.channels}"
            findings.note(*where, problem)
        if not function.output(terminal.id)[0]:
            problem = f"no path leads from terminal {terminal.id} to an output"
            findings.note(*where, f"{problem}, so its volume and mute are unknown")
