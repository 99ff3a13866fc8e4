"""A device opened with PyUSB: its descriptors, and its own volume, mute and samplerate.

Opening a device does not affect its driver or sound card. Volume, mute and samplerate are available
only while no kernel driver is attached. Otherwise set the volume in ALSA's mixer or on the sound
server, or detach the driver with `take_over`. A request without an answer fails after 0.5 s.
"""

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
from device.usb.descriptors.blocks import CONFIGURATION, DEVICE, LEAST_BYTES
from device.usb.requests import Request, VolumeRange
from device.usb.sysfs import UsbAudioDevice
from device.volume_limit import MAX_VOLUME_DB

_TIMEOUT_MS = 500  # of one request


@cache
def libusb() -> Any:
    """Return PyUSB's backend libusb. NoLibusbError: PyUSB or the library libusb is missing."""
    try:
        from usb.backend import libusb1
    except ImportError:
        raise NoLibusbError(not_installed("PyUSB", "live")) from None
    if (backend := libusb1.get_backend()) is None:
        raise NoLibusbError(
            "no libusb: PyUSB is here, but not the library libusb-1.0; install it: "
            "sudo apt install libusb-1.0-0, or sudo dnf install libusb1"
        )
    return backend


def open_device(device: UsbAudioDevice) -> Any:
    """Return PyUSB's usb.core.Device for a device from `find_devices`.

    The first request opens it; usb.util.dispose_resources closes it. NoLibusbError: PyUSB or libusb
    is missing. NoUsbDeviceError: libusb does not see the device. UsbAccessError: libusb fails.
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

    NoLibusbError, NoUsbDeviceError, UsbAccessError: both sources fail.
    """
    if device.descriptors:
        return device.descriptors
    handle = open_device(device)
    import usb.core
    import usb.util
    from usb.control import get_descriptor

    try:
        blocks = [bytes(get_descriptor(handle, LEAST_BYTES[DEVICE], DEVICE, 0))]
        for index in range(handle.bNumConfigurations):
            head = bytes(get_descriptor(handle, LEAST_BYTES[CONFIGURATION], CONFIGURATION, index))
            length = int.from_bytes(head[2:4], "little")  # wTotalLength
            blocks.append(bytes(get_descriptor(handle, length, CONFIGURATION, index)))
    except usb.core.USBError as error:
        raise _refusal(device, error) from None
    finally:
        usb.util.dispose_resources(handle)
    return b"".join(blocks)


def _refusal(device: UsbAudioDevice, error: Any) -> UsbAccessError | NoUsbDeviceError:
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
    """Settings of a device, stored so that they can be restored.

    volumes, mutes: (channel, value) pairs; channel 0 is the master; volumes are in 1/256 dB.
    samplerate: Hz, None if the device does not report it.
    """

    volumes: tuple[tuple[int, int], ...] = ()
    mutes: tuple[tuple[int, bool], ...] = ()
    samplerate: int | None = None


def playback_of(device: UsbAudioDevice) -> PlaybackFormat:
    """Return a playback format, preferably with settable volume and mute, else volume, else mute.

    UsbAccessError: no playback format. Other errors: see `read_descriptors` and `parse_whole`.
    """
    configuration = parse_whole(read_descriptors(device)).active(device.configuration)
    formats = playback_formats(configuration) if configuration else ()
    if not formats:
        raise UsbAccessError(f"{device.label!r} plays no sound according to its descriptors")
    return max(formats, key=lambda one: (bool(one.volume_channels), bool(one.mute_channels)))


class UsbControl:
    """The controls of one open device. Only one thread may use them, never an audio thread.

    handle: PyUSB's device, which `close` releases. volume_channels, mute_channels: channels with
    settable volume or mute; channel 0 is the master. Volumes are in dB.
    Methods raise UsbAccessError if the device refuses a request, does not answer or has no such
    control. They raise NoUsbDeviceError if the device was unplugged.
    """

    def __init__(self, device: UsbAudioDevice, playback: PlaybackFormat, handle: Any) -> None:
        self._device, self._playback, self._handle = device, playback, handle
        self.volume_channels, self.mute_channels = playback.volume_channels, playback.mute_channels

    def volume_db(self, channel: int) -> float:
        """Return a channel's volume; -inf is silence."""
        return requests.from_volume_units(self._units(channel))

    def volume_range(self, channel: int) -> VolumeRange:
        """Return the range of a channel's volume."""
        playback, volume = self._playback, FeatureControl.VOLUME
        what: tuple[requests.What, ...] = ("lowest", "highest", "step")
        what = what if playback.uac == 1 else ("range",)
        asked = (requests.feature(playback, volume, channel, each) for each in what)
        return requests.volume_range(*map(self._ask, asked))

    def set_volume_db(
        self, channel: int, wanted_db: float, limit_db: float = MAX_VOLUME_DB
    ) -> float:
        """Set a channel to the lowest of wanted_db, limit_db and 0 dB; return the volume read back.

        If wanted_db is below the range, the lowest volume is set; -inf sets silence.
        UsbAccessError: the device then reports a higher or a much lower volume.
        """
        wanted_units, step_db = requests.SILENCE_UNITS, 0.0
        if wanted_db != -math.inf:
            offered = self.volume_range(channel)
            wanted_units = requests.volume_units(offered.allowed(wanted_db, limit_db))
            step_db = offered.step_db
        self._set_units(channel, wanted_units)
        found_db, set_db = self.volume_db(channel), requests.from_volume_units(wanted_units)
        # Devices may round to other steps than they report, but must not end up louder.
        if not set_db - max(step_db, 1.0) <= found_db <= set_db:
            raise UsbAccessError(
                f"{self._device.label!r} takes {set_db:g} dB for channel {channel} but then "
                f"reports {found_db:g} dB; set the level in the config, or at the amplifier"
            )
        return found_db

    def muted(self, channel: int) -> bool:
        """Whether a channel is muted."""
        asked = requests.feature(self._playback, FeatureControl.MUTE, channel)
        return bool(requests.number(self._ask(asked), asked.length))

    def set_muted(self, channel: int, muted: bool) -> None:
        """Mute or unmute a channel. UsbAccessError: the channel's mute keeps its former state."""
        self._ask(requests.set_feature(self._playback, FeatureControl.MUTE, channel, int(muted)))
        if self.muted(channel) is not muted:
            raise UsbAccessError(f"{self._device.label!r} takes a mute and does not change it")

    def samplerate(self) -> int:
        """Return the samplerate in Hz."""
        asked = requests.samplerate(self._playback)
        return requests.number(self._ask(asked), asked.length)

    def samplerates(self) -> tuple[RateRange, ...]:
        """Return the sample rates that the clock of a USB Audio 2.0 device offers."""
        return requests.samplerate_ranges(self._ask(requests.samplerate(self._playback, "range")))

    def set_samplerate(self, hertz: int) -> None:
        """Set the samplerate in Hz. UsbAccessError: the device then reports another rate."""
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
        """Restore the settings that differ from a stored state, with volumes of at most 0 dB."""
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
        asked = requests.feature(self._playback, FeatureControl.VOLUME, channel)
        return requests.number(self._ask(asked), 2, "volume", signed=True)

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
    """Return the controls of a device without an attached driver.

    UsbAccessError: a driver is attached, or it cannot play sound. Other errors: see `open_device`.
    """
    if drivers := held_by(device):
        raise UsbAccessError(
            f"{device.label!r} belongs to the driver {', '.join(drivers)}; set its volume in the "
            "sound settings or with alsamixer, or use --take-over to detach the driver for a moment"
        )
    return UsbControl(device, playback_of(device), open_device(device))


def held_by(device: UsbAudioDevice) -> tuple[str, ...]:
    """Return the names of the kernel drivers attached to a device's audio interfaces."""
    drivers = dict.fromkeys(interface.driver for interface in device.interfaces)
    return tuple(name for name in drivers if name not in ("", "usbfs"))
