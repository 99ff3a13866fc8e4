"""`cushion devices`: sinks, USB devices and sound cards, and which applications play."""

from __future__ import annotations

import argparse
import json
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.table import Table

from audioflinger_hook.cli.terminal import LineConsole, warn
from audioflinger_hook.cli.usb import mixer_of, volume_now
from device.alsa import find_playback, list_cards
from device.alsa.cards import PROC, PlaybackDevice, list_playbacks
from device.alsa.usb_stream import UsbFormat, read_usb_stream
from device.alsa.use import why_blocked
from device.errors import CushionError, NotFoundError
from device.server import PulseConnection, ServerSnapshot
from device.server.identity import identity_of, is_own_stream
from device.stream import filter_stderr
from device.stream.pcms import FALLBACK_SINK
from device.usb import Found, UsbAudioDevice, find_devices, identify
from device.usb.descriptors import PlaybackFormat, RateRange, parse_whole, playback_formats
from device.usb.mapping import hw_names, sinks_of


def run(options: argparse.Namespace) -> int:
    """List the devices; a missing sound server or USB bus is reported and is no error."""
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
        "cards": [_card(playback) for card in list_cards() for playback in list_playbacks(card)],
    }
    if options.json:
        print(json.dumps(document, indent=2))
    else:
        _show(document)
    return 0


def _usb(device: UsbAudioDevice, found: Found, snapshot: ServerSnapshot | None) -> dict[str, Any]:
    """Return data of a USB device that can be read without a request to the device."""
    whole, trouble = None, None
    try:
        whole = parse_whole(device.descriptors)
    except CushionError as error:
        trouble = str(error)
    configuration = whole.configurations[0] if whole and whole.configurations else None
    formats = playback_formats(configuration) if configuration else ()
    opened = by_setting(device)
    sinks = sinks_of(device, snapshot.sinks, found.devices) if snapshot else ()
    return {
        "device": str(identify(device, found.devices)),
        "manufacturer": device.manufacturer,
        "product": device.product,
        "serial": device.serial,
        "port": device.port,
        "plays": device.plays,
        "audio_class": max((each.uac for each in formats), default=None),
        "formats": [
            {
                "bits": each.bits,
                "channels": each.channels,
                "samplerates": _samplerates(each, opened.get((each.interface, each.alternate))),
                "synchronisation": each.synchronisation.name.lower(),
                "feedback": each.feedback_endpoint is not None,
            }
            for each in formats
        ],
        "volume": any(each.volume_channels for each in formats),
        "mute": any(each.mute_channels for each in formats),
        "mixer": mixer_of(device),
        "speed_mbit_s": device.speed,
        "max_power_ma": device.max_power_ma,
        "drivers": sorted({each.driver for each in device.interfaces if each.driver}),
        "hw": list(hw_names(device)),
        "sinks": [sink.name for sink in sinks],
        "problem": trouble,
    }


def by_setting(device: UsbAudioDevice, root: Path = PROC) -> dict[tuple[int, int], UsbFormat]:
    """Return a device's formats as the driver lists them, by interface and alternate setting.

    The driver knows the sample rates of devices of class 2; their descriptors do not list them.
    """
    found: dict[tuple[int, int], UsbFormat] = {}
    for name in hw_names(device):
        try:
            playback = find_playback(name.removeprefix("hw:"), root)
        except NotFoundError:
            continue  # the device was unplugged in the meantime
        stream = read_usb_stream(playback)
        for each in stream.formats if stream else ():
            found[each.interface, each.altsetting] = each
    return found


def _samplerates(
    playback: PlaybackFormat, offered: UsbFormat | None
) -> list[int] | dict[str, int] | None:
    """Return rates in Hz, or their range; None if only the device's clock knows them."""
    rates = playback.samplerates
    if isinstance(rates, RateRange):
        return {"lowest": rates.lowest, "highest": rates.highest}
    if rates is not None or offered is None:
        return None if rates is None else list(rates)
    if offered.rates.least:
        return {"lowest": offered.rates.least, "highest": offered.rates.most}
    return list(offered.rates.single)


def _card(playback: PlaybackDevice) -> dict[str, Any]:
    return {
        "device": f"hw:{playback.card.id or playback.card.number},{playback.device}",
        "number": playback.card.number,
        "name": playback.name,
        "in_use": why_blocked(playback),
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
                "identity": asdict(identity_of(sink)),
            }
            for sink in snapshot.sinks
            if sink.name != FALLBACK_SINK
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
            if not is_own_stream(stream)
        ],
    }


def _show(document: dict[str, Any]) -> None:
    console = LineConsole()
    if document["server"]:
        sinks = Table("device", "description", "Hz", "channels", title=document["server"])
        for sink in document["sinks"]:
            mark = " (default)" if sink["default"] else ""
            sinks.add_row(
                sink["device"] + mark,
                sink["description"],
                str(sink["samplerate"]),
                str(sink["channels"]),
            )
        console.print(sinks)
    if document["usb"]:
        usb = Table("device", "name", "plays", "volume", "is also", title="USB")
        for device in document["usb"]:
            usb.add_row(
                device["device"],
                f"{device['manufacturer']} {device['product']}".strip(),
                "; ".join(map(_format_line, device["formats"])) or "-",
                volume_now(device["mixer"]) or "-",
                "\n".join([*(f"sink:{name}" for name in device["sinks"]), *device["hw"]]) or "-",
            )
        console.print(usb)
    if document["cards"]:
        cards_there = Table("device", "name", "", title="sound cards")
        for card in document["cards"]:
            cards_there.add_row(card["device"], card["name"], "in use" if card["in_use"] else "")
        console.print(cards_there)
    if document["applications"]:
        playing = Table("application", "binary", "role", "plays to", title="playing")
        for application in document["applications"]:
            playing.add_row(
                application["name"],
                application["binary"],
                application["role"],
                application["sink"] or "-",
            )
        console.print(playing)


def _format_line(form: dict[str, Any]) -> str:
    rates = form["samplerates"]
    if isinstance(rates, dict):
        shown = f"{rates['lowest'] / 1e3:g} to {rates['highest'] / 1e3:g} kHz"
    else:
        shown = f"{'/'.join(f'{rate / 1e3:g}' for rate in rates)} kHz" if rates else "? kHz"
    follows = ", feedback" if form["feedback"] else ""
    return f"{form['channels']} x {form['bits']} bits, {shown}, {form['synchronisation']}{follows}"
