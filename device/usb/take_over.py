"""Taking a device away from its driver for a moment, and giving it back whatever happens.

While the driver is gone so is the sound card, for everybody. A second process, the guardian, gives
the device back: it waits until this process closes a pipe, or ends in any way, restores what was
set, and attaches the driver again. Signals to this process's group do not reach it.
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
from device.alsa.use import find_owner
from device.errors import NotFoundError, UsbAccessError
from device.usb.control import ControlState, UsbControl, held_by, playback_of
from device.usb.pyusb_access import open_device
from device.usb.sysfs import ROOT, UsbAudioDevice, find_devices

RETURNS_S = 5.0
"""Within this the card is back after it was given back; the kernel takes tenths of a second."""
_POLL_S = 0.02


@contextmanager
def take_over(device: UsbAudioDevice, *, root: Path = ROOT) -> Iterator[UsbControl]:
    """Hold a device's controls within this context; its driver has it before and afterwards.

    Without a driver it is just opened. What was set within is set back in the end. For the main
    thread of a command: it takes some tenths of a second.

    UsbAccessError: something plays on it, it may not be opened, or in the end its card did not
    come back.
    NoLibusbError, NoUsbDeviceError: libusb is missing, or does not see it.
    """
    _refuse_busy(device, root)
    playback, handle = playback_of(device), open_device(device)
    control = UsbControl(device, playback, handle)
    numbers = [each.number for each in device.interfaces if each.driver in held_by(device)]
    guardian = _Guardian(device, root)
    try:
        # Of all interfaces, as the question alone shows whether the device may be opened.
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
    """The second process. `guard` tells it what to restore."""

    def __init__(self, device: UsbAudioDevice, root: Path) -> None:
        numbers = [each.number for each in device.interfaces if each.driver in held_by(device)]
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
        # Sent before a driver is detached: from now on the process would attach it again.
        self.guard(ControlState(), numbers)

    def guard(self, state: ControlState, interfaces: list[int]) -> None:
        """Send the state and interfaces to restore, in place of those sent before."""
        assert self._process.stdin is not None
        restored = {**self._place, "state": asdict(state), "interfaces": interfaces}
        self._process.stdin.write(json.dumps(restored) + "\n")
        self._process.stdin.flush()

    def give_back(self) -> str:
        """Let the process give the device back; return the problem, "" if there is none."""
        try:
            output, _ = self._process.communicate(timeout=RETURNS_S + 5.0)
        except subprocess.TimeoutExpired:
            return "the device does not let itself be given back; plug it in again"
        return output.strip()


def _refuse_busy(device: UsbAudioDevice, root: Path) -> None:
    for card in device.cards:
        for number in card.playback:
            try:
                user = find_owner(find_playback(f"{card.number},{number}", root / "proc/asound"))
            except NotFoundError:
                continue  # it went meanwhile
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
    for _ in range(round(RETURNS_S / _POLL_S)):
        for other in find_devices(root).devices:
            if other.port == device.port and other.cards:
                return
        nap.wait(_POLL_S)
    raise UsbAccessError(f"the sound card of {device.label!r} did not come back; plug it in again")
