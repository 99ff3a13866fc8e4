"""Taking a device from its driver for a moment, and giving it back whatever happens.

Without the driver, the sound card is gone for all programs. A second process, guardian.py, gives
the device back when this one closes a pipe or ends. Signals to this one's group do not reach it.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from device.alsa import find_playback
from device.alsa.cards import find_owner
from device.errors import NotFoundError, UsbAccessError
from device.usb.control import ControlState, UsbControl, held_by, open_device, playback_of
from device.usb.sysfs import ROOT, UsbAudioDevice, find_devices

_RETURNS_S = 5.0  # longest wait for the card; the kernel takes tenths of a second
_POLL_S = 0.02


@contextmanager
def take_over(device: UsbAudioDevice, *, root: Path = ROOT) -> Iterator[UsbControl]:
    """Return a device's controls for this context; afterwards its driver has it again.

    A device without a driver is only opened. At the end all settings are restored. This takes some
    tenths of a second, so it is for the main thread of a command.

    UsbAccessError: the device plays, may not be opened, or its card did not come back.
    NoLibusbError, NoUsbDeviceError: libusb is missing, or does not see the device.
    """
    _refuse_busy(device, root)
    playback, handle = playback_of(device), open_device(device)
    control = UsbControl(device, playback, handle)
    numbers = [each.number for each in device.interfaces if each.driver in held_by(device)]
    guardian = _Guardian(device, root)
    # Before a driver is detached, so that the process attaches it again in every case.
    guardian.guard(ControlState(), numbers)
    try:
        # All interfaces: even the query fails if the device may not be opened.
        for interface in device.interfaces:
            _detach(device, handle, interface.number)
        guardian.guard(control.state(), numbers)
        yield control
    finally:
        control.close()
        trouble = guardian.give_back()
    if trouble:
        raise UsbAccessError(trouble)
    if numbers and device.cards:
        _await_card(device, root)


class _Guardian:
    """The second process, which restores the newest state that `guard` sent."""

    def __init__(self, device: UsbAudioDevice, root: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "device.usb.guardian"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
            cwd=Path(__file__).resolve().parents[2],
        )
        self._place = {"root": str(root), "port": device.port, "address": device.address}

    def guard(self, state: ControlState, interfaces: list[int]) -> None:
        """Send the state and interfaces to restore, in place of those sent before."""
        assert self._process.stdin is not None
        restored = {**self._place, "state": asdict(state), "interfaces": interfaces}
        self._process.stdin.write(json.dumps(restored) + "\n")
        self._process.stdin.flush()

    def give_back(self) -> str:
        """Let the process give the device back; return the problem, "" if there is none."""
        try:
            output, _ = self._process.communicate(timeout=_RETURNS_S + 5.0)
        except subprocess.TimeoutExpired:
            return "the device could not be given back to its driver; plug it in again"
        return output.strip()


def _refuse_busy(device: UsbAudioDevice, root: Path) -> None:
    for card in device.cards:
        for number in card.playback:
            try:
                user = find_owner(find_playback(f"{card.number},{number}", root / "proc/asound"))
            except NotFoundError:
                continue  # it was unplugged
            if user is not None:
                raise UsbAccessError(
                    f"{device.label!r} is in use by {user}; end that program, then take it over"
                )


def _detach(device: UsbAudioDevice, handle: Any, number: int) -> None:
    import usb.core

    try:
        if handle.is_kernel_driver_active(number):
            handle.detach_kernel_driver(number)
    except usb.core.USBError as error:
        raise UsbAccessError(
            f"{device.label!r} at {device.node} cannot be opened, or taken from its driver "
            f"({error}); `cushion install-service --udev` prints a rule that gives the permission"
        ) from None


def _await_card(device: UsbAudioDevice, root: Path) -> None:
    """Wait until the device's sound card is back, under any number."""
    nap = threading.Event()
    for _ in range(round(_RETURNS_S / _POLL_S)):
        if any(each.port == device.port and each.cards for each in find_devices(root).devices):
            return
        nap.wait(_POLL_S)
    raise UsbAccessError(f"the sound card of {device.label!r} did not come back; plug it in again")
