"""`cushion usb`: decodes USB audio devices or dumps of them, and sets a device's controls."""

import argparse
import json
import math
import sys
from contextlib import closing, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.cli.usb_formats import format_text, formats_of, joined, samplerates_text
from device.alsa.mixer import CardMixer
from device.errors import CushionError, NotFoundError, NoUsbDeviceError, UsageError
from device.usb import UsbAudioDevice, UsbIdentity, descriptors, find_devices, find_one, identify
from device.usb.control import UsbControl, held_by, open_control, read_descriptors
from device.usb.descriptors import RateRange, WholeDevice, parse_whole, playback_formats
from device.usb.take_over import take_over

DUMP_BYTES_MAX = 4 << 20  # largest accepted dump


def run(options: argparse.Namespace) -> int:
    """Decode a dump, one device or all connected devices; or set a device's controls."""
    if options.does == "set":
        return _set(options)
    if (options.volume_db, options.samplerate, options.mute) != (None, None, None):
        raise UsageError("usb describe cannot change settings; use `usb set` for that")
    if options.hex is not None and (options.device or options.take_over):
        raise UsageError("--hex decodes a file; leave out DEVICE and --take-over")
    if options.hex is not None:
        devices = [parse_whole(raw) for raw in descriptors.parse_dump(_read(options.hex))]
        with_audio = [one for one in devices if any(each.uac for each in one.configurations)]
        documents = [_document(whole) for whole in with_audio or devices]
    else:
        found = find_devices()
        connected = found.devices
        if options.device is not None:
            connected = (find_one(UsbIdentity.parse(options.device), found),)
        elif not connected:
            raise found.reason or NoUsbDeviceError("no USB audio device is plugged in")
        documents = [
            _document(parse_whole(read_descriptors(one)), one, _settings(one, options.take_over))
            for one in connected
        ]
    if options.json:
        single = options.device or (options.hex is not None and len(documents) == 1)
        print(json.dumps(documents[0] if single else documents, indent=2))
    else:
        print("\n\n".join(map(_text, documents)))
    return 0


def _read(path: Path) -> bytes:
    try:
        if str(path) == "-":
            raw = sys.stdin.buffer.read(DUMP_BYTES_MAX + 1)
        else:
            with path.open("rb") as dump:
                raw = dump.read(DUMP_BYTES_MAX + 1)
    except OSError as error:
        raise UsageError(f"cannot read {path} ({error.strerror}); name a file") from None
    if len(raw) > DUMP_BYTES_MAX:
        raise UsageError(f"{path} is over {DUMP_BYTES_MAX >> 20} MB: too long for descriptors")
    return raw


def _settings(device: UsbAudioDevice, taken: bool) -> dict[str, Any] | None:
    if taken:
        with take_over(device) as control:
            return _asked(control)
    if held_by(device):
        return None
    try:
        with closing(open_control(device)) as control:
            return _asked(control)
    except CushionError as error:
        warn(str(error))
        return None


def _asked(control: UsbControl) -> dict[str, Any]:
    """Return the settings that the device reports; warn about volumes that cannot be read."""
    volumes = []
    for channel in control.volume_channels:
        try:
            offered = control.volume_range(channel)
            volume_db = control.volume_db(channel)
        except NoUsbDeviceError:
            raise
        except CushionError as error:
            warn(f"volume of channel {channel}: {error}")
            continue
        volumes.append({"channel": channel, "db": _finite(volume_db), **asdict(offered)})
    mutes = [{"channel": number, "muted": muted} for number, muted in control.state().mutes]
    settings: dict[str, Any] = {"volumes": volumes, "mutes": mutes}
    with suppress(CushionError):
        settings["samplerate"] = control.samplerate()
    with suppress(CushionError):
        settings["samplerates"] = [asdict(each) for each in control.samplerates()]
    return settings


def _document(
    whole: WholeDevice, device: UsbAudioDevice | None = None, settings: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Return all known properties of a device or dump, as printed by --json."""
    document: dict[str, Any] = {}
    if device is not None:
        name = str(identify(device, find_devices().devices))
        document = {"name": name, "label": device.label, "port": device.port}
        document |= {"cards": [asdict(card) for card in device.cards], "mixer": mixer_of(device)}
    active = whole.active(device.configuration) if device else None
    asked = [RateRange(**each) for each in (settings or {}).get("samplerates", [])]
    configurations = [
        {
            "value": each.value,
            "audio_class": each.uac,
            "active": each is active if device else None,
            "problems": each.problems,
            "playback": [
                asdict(playback) | {"synchronisation": playback.synchronisation.name.lower()}
                for playback in playback_formats(each)
            ],
            # Driver and device report only the formats of the active configuration.
            "formats": formats_of(each, device, asked) if each is active else formats_of(each),
            "bytes": each.raw.hex(),
        }
        for each in whole.configurations
    ]
    return document | {
        "device": asdict(whole.device) if whole.device else None,
        "configurations": configurations,
        "problem": whole.problem or None,
        "rest": whole.rest.hex(),
        "settings": settings,
        "bytes": whole.raw.hex(),
    }


def _text(document: dict[str, Any]) -> str:
    """Return a document as text. It ends with the descriptors, as a dump that --hex can read."""
    lines = []
    if "name" in document:
        cards = ", ".join(f"card {card['number']} ({card['id']})" for card in document["cards"])
        what = f"{document['label']} ({document['name']})"
        lines.append(f"{what}, port {document['port']}, {cards or 'no card'}")
    if device := document["device"]:
        what = f"device {device['vendor_id']:04x}:{device['product_id']:04x}"
        release, usb = _version(device["release"]), _version(device["usb"])
        lines.append(f"{what}, release {release}, USB {usb}")
    for configuration in document["configurations"]:
        lines += _configuration_lines(configuration, len(document["configurations"]) > 1)
    if "mixer" in document:
        lines += mixer_lines(document["mixer"])
    lines += _settings_lines(document["settings"])
    if document["problem"]:
        lines.append(f"problem: {document['problem']}")
    return "\n".join([*lines, "bytes:", *descriptors.hex_lines(bytes.fromhex(document["bytes"]))])


def _configuration_lines(configuration: dict[str, Any], is_one_of_several: bool) -> list[str]:
    uac, value = configuration["audio_class"], configuration["value"]
    lines = [f"configuration {value}: {f'USB Audio {uac}.0' if uac else 'no audio'}"]
    if is_one_of_several and configuration["active"]:
        lines.append(f"configuration {value} is the active one")
    lines += [f"problem: {problem}" for problem in configuration["problems"]]
    lines += [
        f"plays: interface {each['interface']}.{each['alternate']}, {format_text(each)}"
        for each in configuration["formats"]
    ]
    if uac and not configuration["formats"]:
        lines.append("plays: nothing")
    for control in ("volume", "mute"):
        found = {tuple(each[f"{control}_channels"]) for each in configuration["playback"]} - {()}
        for channels in sorted(found, reverse=True):
            shown = ", ".join(str(number) if number else "0 (all)" for number in channels)
            lines.append(f"{control} can be set on channels {shown}")
    return lines


def _version(number: int) -> str:
    """Return a binary-coded decimal version as text: 2.01 for 0x0201."""
    return f"{number >> 8:x}.{number & 0xFF:02x}"


def _settings_lines(settings: dict[str, Any] | None) -> list[str]:
    if settings is None:
        return []
    lines = [
        f"volume of channel {each['channel']}: {_level(each['db'])}, {each['lowest_db']:+.2f} to "
        f"{each['highest_db']:+.2f} dB in steps of {each['step_db']:.3g} dB"
        for each in settings["volumes"]
    ]
    lines += [
        f"mute of channel {each['channel']}: {'on' if each['muted'] else 'off'}"
        for each in settings["mutes"]
    ]
    if "samplerate" in settings:
        lines.append(f"samplerate: {settings['samplerate']} Hz")
    if rates := [RateRange(**each) for each in settings.get("samplerates", [])]:
        lines.append(f"samplerates of its clock: {samplerates_text(joined(rates))}")
    return lines


def mixer_of(device: UsbAudioDevice) -> dict[str, Any]:
    """Return the mixer controls of a device's cards for JSON; levels in dB, None for silence."""
    found: dict[str, Any] = {"volumes": [], "mutes": [], "problem": None}
    for card in device.cards:
        if not card.playback:
            continue
        try:
            with closing(CardMixer(card.number)) as mixer:
                for volume in mixer.volumes:
                    shown: dict[str, Any] = {"name": volume.name}
                    levels, decibels = mixer.volume_db(volume), volume.decibels
                    if levels is not None and decibels is not None:
                        shown["db"] = [_finite(level) for level in levels]
                        shown["lowest_db"] = _finite(decibels.lowest_db)
                        shown["highest_db"] = _finite(decibels.highest_db)
                    found["volumes"].append(shown)
                muted = [{"name": s.name, "muted": [*mixer.muted(s)]} for s in mixer.switches]
                found["mutes"] += muted
        except CushionError as error:
            found["problem"] = str(error)
    return found


def mixer_lines(mixer: dict[str, Any]) -> list[str]:
    """Return the controls of `mixer_of` as lines of text."""
    lines = []
    for each in mixer["volumes"]:
        shown = "in steps of unknown size"
        if "db" in each:
            now = ", ".join(dict.fromkeys(map(_level, each["db"])))
            shown = f"{now}, {_level(each['lowest_db'])} to {_level(each['highest_db'])}"
        lines.append(f"{each['name']} of the sound card: {shown}")
    for each in mixer["mutes"]:
        shown = "muted" if all(each["muted"]) else "partly muted" if any(each["muted"]) else ""
        lines.append(f"{each['name']} of the sound card: {shown or 'not muted'}")
    if mixer["problem"]:
        lines.append(f"volume of the sound card unknown: {mixer['problem']}")
    return lines


def volume_now(mixer: dict[str, Any]) -> str:
    """Return the highest volume of all channels in dB, "silence" or "muted"; "" if unknown."""
    if any(each["muted"] and all(each["muted"]) for each in mixer["mutes"]):
        return "muted"
    levels = [level for each in mixer["volumes"] for level in each.get("db", ())]
    heard = [level for level in levels if level is not None]
    if levels and not heard:
        return "silence"
    return f"{max(heard):+.1f} dB" if heard else ""


def _finite(level_db: float) -> float | None:
    return level_db if math.isfinite(level_db) else None


def _level(level_db: float | None) -> str:
    return "silence" if level_db is None else f"{level_db:+.2f} dB"


def _set(options: argparse.Namespace) -> int:
    """Set mute, sample rate and volume as given, and print them. Unmuting is done last."""
    if options.hex is not None or options.take_over or options.json:
        raise UsageError("usb set sets a device; leave out --hex, --take-over and --json")
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
        print(f"volume of channel {channel}: {_level(_finite(found_db))}")
        if found_db > wanted_db:
            raise NotFoundError(
                f"the lowest volume of channel {channel} is {found_db:g} dB, above the wanted "
                f"{wanted_db:g} dB; this lowest volume is set"
            )


def _set_mute(control: UsbControl, muted: bool) -> None:
    if not control.mute_channels:
        raise NotFoundError("the device has no mute that can be set")
    for channel in control.mute_channels:
        control.set_muted(channel, muted)
        print(f"mute of channel {channel}: {'on' if muted else 'off'}")
