"""Which USB audio devices come and go, noticed at the next poll and at little cost.

The caller calls `poll`; there is no thread and no sleep. Polling compares the kernel's lists of
names, and each device's folder and node. A device that was replugged between two polls has the
same name but another node. Devices are read again only after a difference, in some milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from device.usb.sysfs import ROOT, Found, UsbAudioDevice, find_devices, names_in
from device.usb.uevents import Uevents


@dataclass(frozen=True)
class PresenceChange:
    """The differences from the poll before; false where there are none.

    appeared, vanished: a device that was replugged in between is in both. changed: the present
    state of devices that stayed, such as one whose sound card came up. time_s: time of the poll.
    """

    time_s: float
    appeared: tuple[UsbAudioDevice, ...] = ()
    vanished: tuple[UsbAudioDevice, ...] = ()
    changed: tuple[UsbAudioDevice, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.appeared or self.vanished or self.changed)


@dataclass(frozen=True)
class _Traces:
    """All that polling compares: names in two lists, and what the files of devices are."""

    bus: frozenset[str]
    sound: frozenset[str]
    files: tuple[tuple[int, int] | None, ...]


class PresenceWatch:
    """The USB audio devices that are there, as of the last poll.

    root: "/" but for tests. listen: whether to hear the kernel's messages, too, where that is
    possible. One thread uses it; none that plays sound, since reading devices may take long.
    """

    def __init__(self, root: Path = ROOT, *, listen: bool = True) -> None:
        self._root = root
        self._uevents = Uevents.open() if listen else None
        self._found = Found(())
        self._traces = self._look()
        self._read()

    @property
    def found(self) -> Found:
        """What is there, or why nothing is."""
        return self._found

    def fileno(self) -> int | None:
        """Return a descriptor to select on between polls, None where there is none.

        It becomes readable when something may have changed; in many containers it never does, so
        that polling now and then remains necessary.
        """
        return None if self._uevents is None else self._uevents.fileno()

    def is_present(self, device: UsbAudioDevice) -> bool:
        """Whether this very device is still plugged in, as of the last poll.

        Not one of its kind, nor itself pulled and plugged again: streams on it ended then.
        """
        return any(_same_plugging(device, other) for other in self._found.devices)

    def poll(self, now_s: float) -> PresenceChange:
        """Return what changed since the poll before. now_s: of any clock; it is only passed on."""
        reported = self._uevents is not None and self._uevents.drain()
        traces = self._look()
        if traces == self._traces and not reported:
            return PresenceChange(now_s)
        before = self._found.devices
        # taken before the reading, so a change during it is a difference at the next poll
        self._traces = traces
        self._read()
        return replace(_difference(before, self._found.devices), time_s=now_s)

    def close(self) -> None:
        """Close the descriptor; polling goes on to work."""
        if self._uevents is not None:
            self._uevents.close()
            self._uevents = None

    def __enter__(self) -> PresenceWatch:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _read(self) -> None:
        """Read all devices, the second time for certain after their files were looked at.

        So whatever happens to them during or after the reading is a difference at the next poll.
        """
        self._found = find_devices(self._root)
        self._traces = replace(self._traces, files=self._files())
        self._found = find_devices(self._root)

    def _look(self) -> _Traces:
        return _Traces(
            bus=names_in(self._root / "sys/bus/usb/devices"),
            sound=names_in(self._root / "sys/class/sound"),
            files=self._files(),
        )

    def _files(self) -> tuple[tuple[int, int] | None, ...]:
        folder = self._root / "sys/bus/usb/devices"
        return tuple(
            _trace(path)
            for device in self._found.devices
            for path in (folder / device.port, device.node)
        )


def _trace(path: Path) -> tuple[int, int] | None:
    try:
        known = path.stat()
    except OSError:
        return None
    return known.st_ino, known.st_rdev


def _same_plugging(one: UsbAudioDevice, other: UsbAudioDevice) -> bool:
    names = ("port", "bus", "address", "vendor_id", "product_id", "serial")
    return all(getattr(one, name) == getattr(other, name) for name in names)


def _difference(
    before: Iterable[UsbAudioDevice], after: Iterable[UsbAudioDevice]
) -> PresenceChange:
    old, new = tuple(before), tuple(after)
    stayed = {
        device.port: other for device in old for other in new if _same_plugging(device, other)
    }
    return PresenceChange(
        0.0,
        appeared=tuple(device for device in new if device.port not in stayed),
        vanished=tuple(device for device in old if device.port not in stayed),
        changed=tuple(
            stayed[device.port]
            for device in old
            if device.port in stayed and stayed[device.port] != device
        ),
    )
