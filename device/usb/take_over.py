"""Detaching a device's kernel driver for a short time, and attaching it again in every case.

Without the driver, no program can use the sound card. A second process, guardian.py, attaches the
driver again when this process closes a pipe or ends. The second process has its own session.
Therefore it does not receive signals to this process's group.
"""

import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from device.alsa import find_playback
from device.alsa.cards import find_owner
from device.errors import NotFoundError, UsbAccessError
from device.usb.control import ControlState, UsbControl, held_by, open_device, playback_of
from device.usb.sysfs import ROOT, UsbAudioDevice, find_devices

_RETURNS_S = 5.0  # longest wait for the card
_POLL_S = 0.02


@contextmanager
def take_over(device: UsbAudioDevice, *, root: Path = ROOT) -> Iterator[UsbControl]:
    """Provide a device's controls inside this context; at its end attach the driver again.

    A device without a driver is only opened. At the end the former settings are restored; a volume
    above 0 dB becomes 0 dB. The context waits for the kernel: use it only in a command's main
    thread. UsbAccessError: the device is in use or not accessible, or its card did not come back.
    NoLibusbError: PyUSB or libusb is missing. NoUsbDeviceError: libusb does not see the device.
    """
    _refuse_busy(device, root)
    playback, handle = playback_of(device), open_device(device)
    import usb.core

    control = UsbControl(device, playback, handle)
    numbers = [each.number for each in device.interfaces if each.driver in held_by(device)]
    guardian = _Guardian(device, root)
    # This must precede the detachment, so that the driver is attached again in every case.
    guardian.guard(ControlState(), numbers)
    try:
        # Query all interfaces, even without a driver: this fails if the device may not be opened.
        for interface in device.interfaces:
            try:
                if handle.is_kernel_driver_active(interface.number):
                    handle.detach_kernel_driver(interface.number)
            except usb.core.USBError as error:
                raise UsbAccessError(
                    f"{device.label!r} at {device.node} cannot be opened, or taken from its driver "
                    f"({error}); `cushion install-service --udev` prints a rule that gives the "
                    "permission"
                ) from None
        guardian.guard(control.state(), numbers)
        yield control
    finally:
        control.close()
        trouble = guardian.give_back()
    if trouble:
        raise UsbAccessError(trouble)
    if numbers and device.cards:
        nap = threading.Event()
        for _ in range(round(_RETURNS_S / _POLL_S)):  # the card's number may differ then
            if any(each.port == device.port and each.cards for each in find_devices(root).devices):
                return
            nap.wait(_POLL_S)
        raise UsbAccessError(
            f"the sound card of {device.label!r} did not come back; plug it in again"
        )


class _Guardian:
    """The second process, which restores the settings of the last call of `guard`."""

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
        """Send the settings to restore, and the interfaces that get their driver back."""
        assert self._process.stdin is not None
        restored = {**self._place, "state": asdict(state), "interfaces": interfaces}
        self._process.stdin.write(json.dumps(restored) + "\n")
        self._process.stdin.flush()

    def give_back(self) -> str:
        """Let the process restore settings and driver; return its error text, "" for success."""
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
                continue  # the device was unplugged
            if user is not None:
                raise UsbAccessError(
                    f"{device.label!r} is in use by {user}; end that program, then take it over"
                )
