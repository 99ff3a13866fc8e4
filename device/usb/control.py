"""A device opened with PyUSB: its descriptors, and its own volume, mute and samplerate.

Opening a device does not affect its driver or sound card. Volume, mute and samplerate need a device
that no kernel driver holds. Usually a driver does; then ALSA's mixer or the sound server sets the
volume, and `take_over` detaches the driver for a moment. Requests take milliseconds, or 0.5 s if
the device does not answer.
"""

from __future__ import annotations

import errno
import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from typing import Any

from device.errors import NoLibusbError, NoUsbDeviceError, UsbAccessError, not_installed
from device.usb import requests
from device.usb.descriptors import PlaybackFormat, RateRange, parse_whole, playback_formats
from device.usb.descriptors.audio_class import FeatureControl
from device.usb.requests import Request, VolumeRange
from device.usb.sysfs import UsbAudioDevice
from device.volume_limit import MAX_VOLUME_DB

_TIMEOUT_MS = 500  # of one request; devices answer within some ms or never

# types and lengths: USB 2.0, tables 9-5, 9-8 and 9-10
_DEVICE, _DEVICE_BYTES = 1, 18
_CONFIGURATION, _CONFIGURATION_BYTES = 2, 9


@cache
def libusb() -> Any:
    """Return PyUSB's backend, chosen once for a process. NoLibusbError: there is none."""
    try:
        from usb.backend import libusb1
    except ImportError:
        raise NoLibusbError(not_installed("PyUSB", "live")) from None
    backend = libusb1.get_backend()
    if backend is None:
        raise NoLibusbError(
            "no libusb: PyUSB is here, but not the library libusb-1.0; install it: "
            "sudo apt install libusb-1.0-0, or sudo dnf install libusb1"
        )
    return backend


def open_device(device: UsbAudioDevice) -> Any:
    """Return PyUSB's usb.core.Device of a device from `find_devices`.

    The first request opens it; usb.util.dispose_resources closes it.

    NoLibusbError: libusb is missing. NoUsbDeviceError: it does not see the device.
    """
    backend = libusb()
    import usb.core

    try:
        handle = usb.core.find(backend=backend, bus=device.bus, address=device.address)
    except usb.core.USBError as error:
        raise _refusal(device, error) from None
    ids = (int(device.vendor_id, 16), int(device.product_id, 16))
    if handle is None or (handle.idVendor, handle.idProduct) != ids:
        raise NoUsbDeviceError(
            f"libusb does not see {device.label!r} at {device.node}, which the kernel shows; plug "
            "it in again; in a container, plug it in before the program starts, and pass on "
            "/dev/bus/usb"
        )
    return handle


def read_descriptors(device: UsbAudioDevice) -> bytes:
    """Return the device descriptor and all configurations, from /sys or else from the device.

    NoLibusbError, NoUsbDeviceError, UsbAccessError: both fail.
    """
    if device.descriptors:
        return device.descriptors
    handle = open_device(device)
    import usb.core
    import usb.util
    from usb.control import get_descriptor

    try:
        blocks = [bytes(get_descriptor(handle, _DEVICE_BYTES, _DEVICE, 0))]
        for index in range(handle.bNumConfigurations):
            head = bytes(get_descriptor(handle, _CONFIGURATION_BYTES, _CONFIGURATION, index))
            length = int.from_bytes(head[2:4], "little")  # wTotalLength
            blocks.append(bytes(get_descriptor(handle, length, _CONFIGURATION, index)))
    except usb.core.USBError as error:
        raise _refusal(device, error) from None
    finally:
        usb.util.dispose_resources(handle)
    return b"".join(blocks)


def _refusal(device: UsbAudioDevice, error: Any) -> UsbAccessError | NoUsbDeviceError:
    """Return the error to raise for an error of PyUSB."""
    what = f"{device.label!r} at {device.node}"
    if error.errno in (errno.ENODEV, errno.ENOENT):
        return NoUsbDeviceError(f"{what} was pulled out; plug it in again")
    if error.errno in (errno.EACCES, errno.EPERM):
        return UsbAccessError(
            f"no permission to open {what} (errno {error.errno}); `cushion install-service --udev` "
            'prints a udev rule (TAG+="uaccess") that gives the permission to the person at the '
            "machine; install it and plug the device in again"
        )
    if error.errno == errno.EBUSY:
        return UsbAccessError(f"{what} is held by a driver or another program (errno EBUSY)")
    if error.errno == errno.ETIMEDOUT:
        return UsbAccessError(f"{what} does not answer within {_TIMEOUT_MS} ms; plug it in again")
    return UsbAccessError(f"{what} does not answer correctly ({error}); plug it in again")


@dataclass(frozen=True)
class ControlState:
    """Settings of a device, to restore them.

    volumes, mutes: (channel, value) pairs; channel 0 is the master; volumes are in 1/256 dB.
    samplerate: Hz, None if the device does not report it.
    """

    volumes: tuple[tuple[int, int], ...] = ()
    mutes: tuple[tuple[int, bool], ...] = ()
    samplerate: int | None = None


def playback_of(device: UsbAudioDevice) -> PlaybackFormat:
    """Return the first playback format whose volume, or else mute, can be set, or else the first.

    UsbAccessError: the device has no playback format, or its descriptors cannot be read.
    """
    configuration = parse_whole(read_descriptors(device)).active(device.configuration)
    formats = playback_formats(configuration) if configuration else ()
    if not formats:
        raise UsbAccessError(f"{device.label!r} plays no sound according to its descriptors")
    return max(formats, key=lambda one: (bool(one.volume_channels), bool(one.mute_channels)))


class UsbControl:
    """The controls of one open device, for one thread, which must not be an audio thread.

    handle: PyUSB's device, which `close` releases. volume_channels, mute_channels: those that can
    be set; channel 0 is the master. Volumes are in dB.

    All methods raise UsbAccessError if the device refuses, does not answer or has no such control,
    and NoUsbDeviceError if it was pulled out.
    """

    def __init__(self, device: UsbAudioDevice, playback: PlaybackFormat, handle: Any) -> None:
        self._device = device
        self._playback = playback
        self._handle = handle
        self.volume_channels = playback.volume_channels
        self.mute_channels = playback.mute_channels

    def volume_db(self, channel: int) -> float:
        """Return a volume; -inf is silence."""
        return requests.from_volume_units(self._units(channel))

    def volume_range(self, channel: int) -> VolumeRange:
        """Return the range of a volume."""
        volume = FeatureControl.VOLUME
        if self._playback.uac > 1:
            answer = self._ask(requests.feature(self._playback, volume, channel, "range"))
            return requests.volume_ranges(answer)
        what: tuple[requests.What, ...] = ("lowest", "highest", "step")
        lowest, highest, step = (
            self._ask(requests.feature(self._playback, volume, channel, each)) for each in what
        )
        return requests.volume_range(lowest, highest, step)

    def set_volume_db(
        self, channel: int, wanted_db: float, limit_db: float = MAX_VOLUME_DB
    ) -> float:
        """Set a volume, never above 0 dB nor limit_db; return the volume that is read back.

        A volume below the range becomes its lowest value. UsbAccessError: also if the device keeps
        another volume.
        """
        wanted_units, step_db = requests.SILENCE_UNITS, 0.0
        if wanted_db != -math.inf:
            offered = self.volume_range(channel)
            wanted_units = requests.volume_units(offered.allowed(wanted_db, limit_db))
            step_db = offered.step_db
        self._set_units(channel, wanted_units)
        found_db, set_db = self.volume_db(channel), requests.from_volume_units(wanted_units)
        # Devices round to other steps than they report, but none may end up louder.
        if not set_db - max(step_db, 1.0) <= found_db <= set_db:
            raise UsbAccessError(
                f"{self._device.label!r} takes {set_db:g} dB for channel {channel} but then "
                f"reports {found_db:g} dB; set the level in the config, or at the amplifier"
            )
        return found_db

    def muted(self, channel: int) -> bool:
        """Return whether a channel is muted."""
        asked = requests.feature(self._playback, FeatureControl.MUTE, channel)
        return bool(requests.number(self._ask(asked), asked.length))

    def set_muted(self, channel: int, muted: bool) -> None:
        """Mute or unmute a channel. UsbAccessError: also if the mute does not change."""
        self._ask(requests.set_feature(self._playback, FeatureControl.MUTE, channel, int(muted)))
        if self.muted(channel) is not muted:
            raise UsbAccessError(f"{self._device.label!r} takes a mute and does not change it")

    def samplerate(self) -> int:
        """Return the samplerate in Hz."""
        asked = requests.samplerate(self._playback)
        return requests.number(self._ask(asked), asked.length)

    def samplerates(self) -> tuple[RateRange, ...]:
        """Return the rates in Hz that the clock of a device of 2.0 or 3.0 offers."""
        return requests.samplerate_ranges(self._ask(requests.samplerate(self._playback, "range")))

    def set_samplerate(self, hertz: int) -> None:
        """Set the samplerate in Hz. UsbAccessError: also if the device keeps another one."""
        self._ask(requests.set_samplerate(self._playback, hertz))
        if (found := self.samplerate()) != hertz:
            raise UsbAccessError(
                f"{self._device.label!r} takes {hertz} Hz but then reports {found} Hz"
            )

    def state(self) -> ControlState:
        """Return all settings that the device reports."""
        volumes, mutes, rate = [], [], None
        for channel in self.volume_channels:
            with suppress(UsbAccessError):
                volumes.append((channel, self._units(channel)))
        for channel in self.mute_channels:
            with suppress(UsbAccessError):
                mutes.append((channel, self.muted(channel)))
        with suppress(UsbAccessError):
            rate = self.samplerate()
        return ControlState(tuple(volumes), tuple(mutes), rate)

    def restore(self, state: ControlState) -> None:
        """Set all that differs from a state; a volume above 0 dB becomes 0 dB."""
        now = self.state()
        for channel, units in set(state.volumes) - set(now.volumes):
            loudest = requests.volume_units(MAX_VOLUME_DB)
            self._set_units(channel, min(units, loudest))
        for channel, muted in set(state.mutes) - set(now.mutes):
            self.set_muted(channel, muted)
        if state.samplerate and state.samplerate != now.samplerate:
            self.set_samplerate(state.samplerate)

    def close(self) -> None:
        """Release the device."""
        import usb.util

        usb.util.dispose_resources(self._handle)

    def _units(self, channel: int) -> int:
        return requests.volume(
            self._ask(requests.feature(self._playback, FeatureControl.VOLUME, channel))
        )

    def _set_units(self, channel: int, units: int) -> None:
        self._ask(requests.set_feature(self._playback, FeatureControl.VOLUME, channel, units))

    def _ask(self, request: Request) -> bytes:
        import usb.core

        setup = (request.request_type, request.request, request.value, request.index)
        data = request.length if request.data is None else request.data
        try:
            answer = self._handle.ctrl_transfer(*setup, data, _TIMEOUT_MS)
        except usb.core.USBError as error:
            if error.errno == errno.EPIPE:
                raise UsbAccessError(
                    f"{self._device.label!r} at {self._device.node} refuses the request (it "
                    "stalls); it has no such control"
                ) from None
            raise _refusal(self._device, error) from None
        return b"" if isinstance(answer, int) else bytes(answer)


def open_control(device: UsbAudioDevice) -> UsbControl:
    """Return the controls of a device that no driver holds.

    UsbAccessError: a driver holds it, it may not be opened, or nothing can be played on it.
    NoLibusbError, NoUsbDeviceError: libusb is missing, or does not see it.
    """
    if drivers := held_by(device):
        raise UsbAccessError(
            f"{device.label!r} belongs to the driver {', '.join(drivers)}; set its volume in the "
            "sound settings or with alsamixer, or use --take-over to detach the driver for a moment"
        )
    return UsbControl(device, playback_of(device), open_device(device))


def held_by(device: UsbAudioDevice) -> tuple[str, ...]:
    """Return the drivers of the kernel that hold audio interfaces of a device."""
    drivers = dict.fromkeys(interface.driver for interface in device.interfaces)
    return tuple(name for name in drivers if name not in ("", "usbfs"))
