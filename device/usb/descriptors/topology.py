"""Finds paths of sound and clocks in an audio function; a search visits each entity only once."""

from functools import cache, cached_property

from device.usb.descriptors import audio_class
from device.usb.descriptors.configuration import Configuration, Interface

_ASSOCIATIONS_MAX = 256  # number of possible interface numbers; each is in one association

# upper byte of output and bidirectional terminal types: loudspeakers, headphones, headsets
_LISTENED_TERMINALS = (0x03, 0x04)


class Topology:
    """One audio function: its control interface, and its entities and terminals by id."""

    def __init__(self, control: Interface) -> None:
        self.control = control
        self.entities: dict[int, audio_class.Entity] = {}
        for entity in control.entities:
            self.entities.setdefault(entity.id, entity)
        self.terminals = {
            entity.id: entity
            for entity in self.entities.values()
            if entity.kind in (audio_class.INPUT, audio_class.OUTPUT)
        }
        self.output = cache(self._output)
        self.clock_sources = cache(self._clock_sources)

    def _output(self, terminal_id: int) -> tuple[tuple[int, ...], audio_class.Entity | None]:
        """Return the path from an input terminal to an output terminal, and a feature unit on it.

        The path contains the ids of all entities, both terminals included; () if there is none.
        Loudspeakers and headphones have priority over other outputs; then the shortest path is
        chosen. Feature units with a settable volume have priority, then those with a settable mute.
        """
        path = [terminal_id]
        while (following := self._next.get(path[-1])) is not None:
            path.append(following)
        if len(path) == 1:
            return (), None
        reached = (self.entities.get(each) for each in path)
        units = [entity for entity in reached if entity and entity.kind == audio_class.FEATURE]
        wanted = (audio_class.FeatureControl.VOLUME, audio_class.FeatureControl.MUTE)
        settable = (unit for control in wanted for unit in units if unit.settable(control))
        return tuple(path), next(settable, units[0] if units else None)

    @cached_property
    def _next(self) -> dict[int, int]:
        """The id of the next entity towards an output, keyed by the id of each entity."""
        outputs = [
            entity
            for entity in self.entities.values()
            if entity.kind == audio_class.OUTPUT
            and entity.terminal_type != audio_class.USB_STREAMING
        ]
        listened = [o for o in outputs if o.terminal_type >> 8 in _LISTENED_TERMINALS]
        following: dict[int, int] = {}
        reached: set[int] = set()
        for ends in (listened, outputs):
            queue = [output.id for output in ends if output.id not in reached]
            reached.update(queue)
            for here in queue:
                entity = self.entities.get(here)
                for source in entity.source_ids if entity else ():
                    if source not in reached:
                        reached.add(source)
                        following[source] = here
                        queue.append(source)
        return following

    def _clock_sources(self, clock_id: int) -> tuple[int, ...]:
        """Return the ids of the sources of a clock; a clock selector may have several sources."""
        seen, queue, found = {clock_id}, [clock_id], []
        for here in queue:
            if (clock := self.entities.get(here)) and clock.kind == audio_class.CLOCK_SOURCE:
                found.append(here)
            if clock and clock.kind in audio_class.CLOCKS:
                unseen = set(clock.source_ids) - seen
                queue += unseen
                seen |= unseen
        return tuple(sorted(found))


def topologies(configuration: Configuration) -> dict[int, Topology]:
    """Return the audio function of every control and streaming interface, by interface number.

    A streaming interface belongs to the control interface in its association. Outside associations
    it belongs to the control interface of the same version whose header lists it (1.0). All other
    streaming interfaces belong to the previous control interface, or else to the first.
    """
    functions: dict[int, Topology] = {}
    for interface in configuration.interfaces:
        if interface.is_control and interface.number not in functions:
            functions[interface.number] = Topology(interface)
    owners = dict(functions)
    for spanned in configuration.associations[:_ASSOCIATIONS_MAX]:
        if first := next((functions[n] for n in spanned if n in functions), None):
            for number in spanned:
                owners.setdefault(number, first)
    versions = {i.number: i.uac for i in configuration.interfaces if i.is_streaming}
    for function in functions.values():
        for number in function.control.listed or ():
            # The header of a MIDI function may wrongly list an interface of another function.
            if versions.get(number) == function.control.uac:
                owners.setdefault(number, function)
    latest = next(iter(functions.values()), None)
    for interface in configuration.interfaces:
        if interface.is_control:
            latest = functions[interface.number]
        elif interface.is_streaming and latest:
            owners.setdefault(interface.number, latest)
    return owners
