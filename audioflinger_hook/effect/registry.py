"""Libraries of effects: the bundled library and the libraries of other installed packages."""

import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from importlib.metadata import EntryPoint, distributions
from pathlib import Path
from uuid import UUID

from audioflinger_hook.effect.control import error_text
from audioflinger_hook.effect.haptic import CUSHION
from audioflinger_hook.effect.interface import (
    KINDS,
    Command,
    EffectDescriptor,
    EffectEngine,
    EffectFlag,
    EffectLibrary,
    Parameter,
    VendorCommand,
)
from device.errors import InternalError, NotFoundError, UsageError

__all__ = ["EffectLibrary", "EffectRegistry"]

ENTRY_POINTS = "audioflinger_hook.effects"  # group of entry points, each an `EffectLibrary`


class EffectRegistry:
    """All known effects, by UUID. problems: one text for each unusable library or package."""

    def __init__(self, libraries: Iterable[EffectLibrary] = ()) -> None:
        self.problems: list[str] = []
        self._libraries: dict[str, EffectLibrary] = {}
        self._effects: dict[UUID, tuple[EffectDescriptor, Callable[[], EffectEngine]]] = {}
        for library in libraries:
            self.add(library)

    @classmethod
    def installed(cls) -> "EffectRegistry":
        """Return a registry of the bundled library and the libraries of installed packages."""
        registry = cls([CUSHION])
        found, problems = _entry_points(tuple((place, _changed_ns(place)) for place in sys.path))
        registry.problems += problems
        for owner, entry in found:
            try:
                library: object = entry.load()
                if not isinstance(library, EffectLibrary):
                    raise UsageError(
                        f"{entry.value} is of type {type(library).__name__}; "
                        "an EffectLibrary is needed"
                    )
                registry.add(library)
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                registry.problems.append(
                    f"effect library {entry.name!r} of package {owner!r} is left out: "
                    f"{error_text(error)}"
                )
        return registry

    @property
    def libraries(self) -> tuple[str, ...]:
        """Names of all libraries."""
        return tuple(self._libraries)

    @property
    def descriptors(self) -> tuple[EffectDescriptor, ...]:
        """Descriptors of all effects."""
        return tuple(descriptor for descriptor, _ in self._effects.values())

    def add(self, library: EffectLibrary) -> None:
        """Add a library. UsageError: its name or an effect is invalid, or exists already."""
        if type(library.name) is not str or not library.name:
            raise UsageError(f"effect library name {library.name!r} is not a name")
        if library.name in self._libraries:
            raise UsageError(f"effect library {library.name!r} exists already; rename it")
        found: dict[UUID, tuple[EffectDescriptor, Callable[[], EffectEngine]]] = {}
        for descriptor, factory in library.effects:
            problem = descriptor_problem(descriptor)
            if not callable(factory):
                problem = problem or f"{factory!r} does not make an engine"
            if problem:
                raise UsageError(f"effect library {library.name!r}: {problem}")
            if taken := found.get(descriptor.uuid) or self._effects.get(descriptor.uuid):
                raise UsageError(
                    f"effect library {library.name!r}: UUID {descriptor.uuid} of effect "
                    f"{descriptor.name!r} is that of effect {taken[0].name!r}; make a new one"
                )
            found[descriptor.uuid] = (descriptor, factory)
        self._libraries[library.name] = library
        self._effects |= found

    def uuids(self, library: str) -> frozenset[UUID]:
        """Return the UUIDs of a library's effects; empty for an unknown library."""
        if library not in self._libraries:
            return frozenset()
        return frozenset(descriptor.uuid for descriptor, _ in self._libraries[library].effects)

    def create(self, uuid: UUID) -> EffectEngine:
        """Return a new engine of the effect with this implementation UUID.

        NotFoundError: no effect has this UUID.
        InternalError: the library cannot create the engine, or creates an engine of another effect.
        """
        if uuid not in self._effects:
            known = ", ".join(f"{d.uuid} ({d.name})" for d in self.descriptors)
            raise NotFoundError(f"no effect has UUID {uuid}; known effects: {known}")
        descriptor, factory = self._effects[uuid]
        try:
            engine = factory()
            made = engine.descriptor
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise InternalError(
                f"effect {descriptor.name!r} cannot be made: {error_text(error)}; "
                "remove the package that brings it"
            ) from error
        if made is not descriptor and made != descriptor:
            raise InternalError(f"effect {descriptor.name!r}: its library made another effect")
        return engine


def _changed_ns(place: str) -> int:
    try:
        return Path(place or ".").stat().st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=1)  # a new search for each of many short files would be slow
def _entry_points(
    _path: tuple[tuple[str, int], ...],
) -> tuple[list[tuple[str, EntryPoint]], list[str]]:
    """Return (package, entry point) pairs, and problems as texts. _path: only a cache key."""
    found: dict[str, list[EntryPoint]] = {}
    problems: list[str] = []
    for distribution in distributions():
        try:
            if entries := [e for e in distribution.entry_points if e.group == ENTRY_POINTS]:
                # If packages have equal names, the first on the path is used, as for imports.
                found.setdefault(distribution.name, entries)
        except Exception as error:
            place = getattr(distribution, "_path", "an unknown place")
            problems.append(f"package {place} cannot be searched for effects: {error_text(error)}")
    return [(owner, entry) for owner, entries in found.items() for entry in entries], problems


def descriptor_problem(descriptor: object) -> str:
    """Return the first mistake in a descriptor, or "" for a valid descriptor."""
    if type(descriptor) is not EffectDescriptor:
        return f"{type(descriptor).__name__} is not an EffectDescriptor"
    if type(descriptor.uuid) is not UUID or type(descriptor.type_uuid) is not UUID:
        return f"effect {descriptor.name!r} has an invalid UUID"
    if type(descriptor.name) is not str or not descriptor.name:
        return f"effect {descriptor.uuid} has no name"
    if not isinstance(descriptor.flags, EffectFlag):
        return f"effect {descriptor.name!r} has invalid flags"
    names = []
    for parameter in descriptor.parameters:
        if type(parameter) is not Parameter or parameter.kind not in KINDS:
            return f"effect {descriptor.name!r} has an invalid parameter"
        if parameter.default is not None and not parameter.accepts(parameter.default):
            return f"effect {descriptor.name!r}: default of {parameter} is out of its range"
        names.append(parameter.name)
    if len(set(names)) != len(names):
        return f"effect {descriptor.name!r} has two parameters of the same name"
    for vendor in descriptor.vendor_commands:
        if type(vendor) is not VendorCommand or vendor.code <= Command.FIRST_PROPRIETARY - 1:
            return (
                f"effect {descriptor.name!r} has a vendor command "
                f"below {int(Command.FIRST_PROPRIETARY):#x}"
            )
    return ""
