"""How sound and clocks flow through an audio function, by its entities' source ids.

Ids may point nowhere or in a circle: every walk visits an entity once.
"""

from __future__ import annotations

from collections.abc import Iterator

from device.usb.descriptors.configuration import Configuration, Interface
from device.usb.descriptors.entities import (
    USB_STREAMING,
    ClockEntity,
    ClockSource,
    Entity,
    FeatureControl,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
)

_ASSOCIATIONS_MAX = 256
"""Largest count of interface numbers; each belongs to one association."""

_HEARD_TERMINALS = (0x03, 0x04)
"""The upper byte of output and bidirectional terminal types: loudspeakers, headphones, headsets."""


class Topology:
    """One audio function: its control interface, and its entities by id, of two alike the first."""

    def __init__(self, control: Interface) -> None:
        self.control = control
        self.entities: dict[int, Entity] = {}
        for entity in control.entities:
            self.entities.setdefault(entity.id, entity)
        self.terminals = {
            entity.id: entity
            for entity in self.entities.values()
            if isinstance(entity, InputTerminal | OutputTerminal)
        }
        self._next: dict[int, int] | None = None
        self._paths: dict[int, tuple[int, ...]] = {}
        self._units: dict[int, FeatureUnit | None] = {}
        self._sources: dict[int, tuple[int, ...]] = {}

    def channels(self, entity_id: int) -> int | None:
        """The number of channels that leave an entity; None if it cannot be found."""
        seen: set[int] = set()
        while entity_id not in seen:
            seen.add(entity_id)
            entity = self.entities.get(entity_id)
            if isinstance(entity, InputTerminal | MixerUnit | ProcessingUnit):
                return entity.channels
            if entity is None or not entity.source_ids:
                return None
            entity_id = entity.source_ids[0]
        return None

    def path(self, terminal_id: int) -> tuple[int, ...]:
        """The ids from an input terminal to an output terminal, both included; () without a way.

        Loudspeakers and headphones come before other outputs, then the shorter way.
        """
        known = self._paths.get(terminal_id)
        if known is not None:
            return known
        if self._next is None:
            self._next = self._towards_outputs()
        way = [terminal_id]
        while (following := self._next.get(way[-1])) is not None:
            way.append(following)
        return self._paths.setdefault(terminal_id, tuple(way) if len(way) > 1 else ())

    def feature_unit(self, terminal_id: int) -> FeatureUnit | None:
        """The first on the path whose volume, or else mute, can be set, or else the first."""
        if terminal_id in self._units:
            return self._units[terminal_id]
        on_path = (self.entities.get(number) for number in self.path(terminal_id))
        units = [unit for unit in on_path if isinstance(unit, FeatureUnit)]
        wanted = (FeatureControl.VOLUME, FeatureControl.MUTE)
        settable = (unit for control in wanted for unit in units if unit.settable(control))
        return self._units.setdefault(terminal_id, next(settable, units[0] if units else None))

    def _towards_outputs(self) -> dict[int, int]:
        """The next entity on the way to an output, by id: breadth first, against the flow."""
        outputs = [
            entity
            for entity in self.entities.values()
            if isinstance(entity, OutputTerminal) and entity.terminal_type != USB_STREAMING
        ]
        heard = [o for o in outputs if o.terminal_type >> 8 in _HEARD_TERMINALS]
        following: dict[int, int] = {}
        reached: set[int] = set()
        for ends in (heard, outputs):
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

    def clock_sources(self, clock_id: int) -> tuple[int, ...]:
        """The clock sources that a clock can come from, by id; several behind a selector."""
        known = self._sources.get(clock_id)
        if known is not None:
            return known
        seen, queue, found = {clock_id}, [clock_id], []
        for here in queue:
            clock = self.entities.get(here)
            if isinstance(clock, ClockSource):
                found.append(here)
            if isinstance(clock, ClockEntity):
                unseen = set(clock.source_ids) - seen
                queue += unseen
                seen |= unseen
        return self._sources.setdefault(clock_id, tuple(sorted(found)))

    def circle(self) -> tuple[int, ...]:
        """The ids of one circle, in the direction of `source_ids`; () if there is no circle."""
        done: set[int] = set()
        for start in self.entities:
            way, left = [start], [self._sources_left(start, done)]
            on_way = {start}
            while way:
                following = next(left[-1], None)
                if following is None:
                    on_way.discard(way[-1])
                    done.add(way.pop())
                    left.pop()
                elif following in on_way:
                    return tuple(way[way.index(following) :])
                elif following not in done:
                    way.append(following)
                    on_way.add(following)
                    left.append(self._sources_left(following, done))
        return ()

    def _sources_left(self, entity_id: int, done: set[int]) -> Iterator[int]:
        entity = self.entities.get(entity_id)
        return iter(() if entity is None or entity_id in done else entity.source_ids)


def topologies(configuration: Configuration) -> dict[int, Topology]:
    """The audio function of every control and streaming interface, by interface number.

    The association that spans a streaming interface decides. Where none with a control interface
    does, a header of the same version lists it (1.0). One that no header lists belongs to the
    control interface before it, or else to the first.
    """
    functions: dict[int, Topology] = {}
    for interface in configuration.interfaces:
        if interface.is_control and interface.number not in functions:
            functions[interface.number] = Topology(interface)
    owners = dict(functions)
    if not functions:
        return owners
    for association in configuration.associations[:_ASSOCIATIONS_MAX]:
        spanned = range(association.first, association.first + association.interfaces)
        first = next((functions[n] for n in spanned if n in functions), None)
        if first:
            for number in spanned:
                owners.setdefault(number, first)
    versions = {i.number: i.uac for i in configuration.interfaces if i.is_streaming}
    for function in functions.values():
        header = function.control.header
        for claimed in header.interfaces if header else ():
            # The head of a MIDI function may list an interface of another one by mistake.
            if versions.get(claimed) == function.control.uac:
                owners.setdefault(claimed, function)
    latest = next(iter(functions.values()))
    for interface in configuration.interfaces:
        if interface.is_control:
            latest = functions[interface.number]
        elif interface.is_streaming:
            owners.setdefault(interface.number, latest)
    return owners
