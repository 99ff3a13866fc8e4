"""`cushion usb set`: volume, mute and samplerate of a device that no driver holds."""

from __future__ import annotations

import argparse
import math
from contextlib import closing

from device.errors import NotFoundError, UsageError
from device.usb import UsbIdentity, find_devices, find_one
from device.usb.control import UsbControl, open_control


def run(options: argparse.Namespace) -> int:
    """Set the options' values, read them back and print them; a mute is lifted last."""
    if options.hex is not None or options.take_over or options.json:
        raise UsageError("usb set goes with neither --hex, --take-over nor --json")
    if options.device is None:
        raise UsageError("usb set needs a device; `cushion devices` lists them")
    if (options.samplerate, options.volume_db, options.mute) == (None, None, None):
        raise UsageError("usb set needs --volume-db, --samplerate or --mute")
    device = find_one(UsbIdentity.parse(options.device), find_devices())
    with closing(open_control(device)) as control:
        if options.mute == "on":
            _set_mute(control, True)
        if options.samplerate is not None:
            control.set_samplerate(options.samplerate)
            print(f"samplerate: {control.samplerate()} Hz")
        if options.volume_db is not None:
            _set_volume(control, options.volume_db)
        if options.mute == "off":
            _set_mute(control, False)
    return 0


def _set_volume(control: UsbControl, wanted_db: float) -> None:
    if not control.volume_channels:
        raise NotFoundError("the device has no volume that can be set; set the level elsewhere")
    for channel in control.volume_channels:
        found_db = control.set_volume_db(channel, wanted_db)
        shown = f"{found_db:+.2f} dB" if math.isfinite(found_db) else "silence"
        print(f"volume of channel {channel}: {shown}")
        if found_db > wanted_db:
            raise NotFoundError(
                f"the lowest volume of channel {channel} is {found_db:g} dB, above the wanted "
                f"{wanted_db:g} dB; it is set to that"
            )


def _set_mute(control: UsbControl, muted: bool) -> None:
    if not control.mute_channels:
        raise NotFoundError("the device has no mute that can be set")
    for channel in control.mute_channels:
        control.set_muted(channel, muted)
        print(f"mute of channel {channel}: {'on' if muted else 'off'}")
