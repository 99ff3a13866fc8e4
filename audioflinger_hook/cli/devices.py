"""`cushion devices`: lists sinks, USB devices, sound cards, and applications that play sound."""

import argparse
import json
from collections.abc import Iterable
from contextlib import closing
from dataclasses import asdict
from typing import Any

from audioflinger_hook.cli.outputs import OWN_SINKS, advice_for
from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.cli.usb import mixer_of, volume_now
from audioflinger_hook.cli.usb_formats import format_text, formats_of
from audioflinger_hook.service.one_line import one_line
from device.alsa import list_cards
from device.alsa.cards import list_devices, why_blocked
from device.errors import CushionError
from device.server import PulseConnection, ServerSnapshot
from device.server.app_rules import is_application
from device.server.identity import identity_of
from device.stream import filter_stderr
from device.usb import Found, UsbAudioDevice, find_devices, identify
from device.usb.descriptors import parse_whole, playback_formats
from device.usb.mapping import device_of_sink, hw_names


def run(options: argparse.Namespace) -> int:
    """List the devices. If the sound server or access to USB is missing, print a warning."""
    filter_stderr()
    snapshot = None
    try:
        with closing(PulseConnection()) as connection:
            snapshot = connection.latest
    except CushionError as error:
        warn(str(error))
    usb = find_devices()
    if usb.reason is not None:
        warn(str(usb.reason))
    document = _server(snapshot) | {
        "usb": [_usb(device, usb, snapshot) for device in usb.devices],
        "cards": [
            {
                "device": f"hw:{card.id or card.number},{playback.device}",
                "number": card.number,
                "name": playback.name,
                "in_use": why_blocked(playback),
            }
            for card in list_cards()
            for playback in list_devices(card)
        ],
    }
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        _show(document)
    return 0


def _usb(device: UsbAudioDevice, found: Found, snapshot: ServerSnapshot | None) -> dict[str, Any]:
    """Return a USB device's properties from its descriptors, its driver and the sound server."""
    configuration, trouble = None, None
    try:
        configuration = parse_whole(device.descriptors).active(device.configuration)
    except CushionError as error:
        trouble = str(error)
    units = playback_formats(configuration) if configuration else ()
    sinks = snapshot.sinks if snapshot else ()
    return {
        "device": str(identify(device, found.devices)),
        "manufacturer": device.manufacturer,
        "product": device.product,
        "serial": device.serial,
        "port": device.port,
        "plays": device.plays,
        "audio_class": configuration.uac if configuration else None,
        "formats": formats_of(configuration, device),
        "volume": any(each.volume_channels for each in units),
        "mute": any(each.mute_channels for each in units),
        "mixer": mixer_of(device),
        "speed_mbit_s": device.speed,
        "max_power_ma": device.max_power_ma,
        "drivers": sorted({each.driver for each in device.interfaces if each.driver}),
        "hw": list(hw_names(device)),
        "sinks": [one.name for one in sinks if device_of_sink(one, found.devices) == device],
        "problem": trouble,
    }


def _server(snapshot: ServerSnapshot | None) -> dict[str, Any]:
    if snapshot is None:
        return {"server": None, "default_sink": None, "sinks": [], "applications": []}
    names = {sink.index: sink.name for sink in snapshot.sinks}
    return {
        "server": f"{snapshot.kind} {snapshot.version}",
        "default_sink": snapshot.default_sink or None,
        "sinks": [
            {
                "name": sink.name,
                "device": f"sink:{sink.name}",
                "description": sink.description,
                "monitor": sink.monitor,
                "samplerate": sink.samplerate,
                "channels": sink.channels,
                "default": sink.name == snapshot.default_sink,
                "weakened": sink.weakened,
                "identity": asdict(identity_of(sink)),
                "advice": advice_for(sink),
            }
            for sink in snapshot.sinks
            if sink.name not in OWN_SINKS
        ],
        "applications": [
            {
                "name": stream.application,
                "binary": stream.binary,
                "role": stream.role,
                "media": stream.media,
                "process_id": stream.process_id,
                "sink": names.get(stream.device_index) if stream.device_index is not None else None,
                "paused": stream.corked,
            }
            for stream in snapshot.sink_inputs
            if is_application(stream)
        ],
    }


def _show(document: dict[str, Any]) -> None:
    """Print the lists. The full name of each device is on a separate line, for copying."""
    if document["server"]:
        _section(document["server"], map(_sink_lines, document["sinks"]))
    _section("USB", map(_usb_lines, document["usb"]))
    cards = document["cards"]
    named = ([one["device"], one["name"] + ", in use" * bool(one["in_use"])] for one in cards)
    _section("sound cards", named)
    playing = []
    for one in document["applications"]:
        what = ", ".join(filter(None, (one["binary"], one["role"])))
        playing.append([one["name"], f"{what or 'unknown'}, to {one['sink'] or 'nothing'}"])
    _section("playing", playing)


def _section(title: str, blocks: Iterable[list[str]]) -> None:
    for number, (name, *details) in enumerate(blocks):
        if number == 0:
            print(one_line(title))
        # `one_line` would shorten the name, which users copy.
        print(f"  {''.join(sign if sign.isprintable() else '?' for sign in name)}")
        for detail in details:
            print(f"    {one_line(detail, 4_096)}")


def _sink_lines(sink: dict[str, Any]) -> list[str]:
    what = f"{sink['description']}, {sink['samplerate']} Hz, {sink['channels']} channels"
    facts = (what, "the default" if sink["default"] else "", sink["weakened"])
    return [*filter(None, (sink["device"], ", ".join(filter(None, facts)), sink["advice"]))]


def _usb_lines(device: dict[str, Any]) -> list[str]:
    name = f"{device['manufacturer']} {device['product']}".strip()
    audio_class = f"class {device['audio_class']}" if device["audio_class"] else "unknown class"
    lines = [device["device"], ", ".join(filter(None, (name, audio_class)))]
    lines += [f"plays {format_text(each, units='kHz')}" for each in device["formats"]]
    if not device["plays"]:
        lines.append("plays nothing")
    if volume := volume_now(device["mixer"]):
        lines.append(f"volume {volume}")
    others = [*(f"sink:{name}" for name in device["sinks"]), *device["hw"]]
    return lines + [f"is also {other}" for other in others]
