"""The formats that a USB device plays, from its descriptors, its clock and its driver.

Descriptors of USB Audio 2 and 3 contain no sample rates. Descriptors of USB Audio 3 contain no
channel count. The device's driver lists these values.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

from device.alsa import find_playback
from device.alsa.cards import PROC
from device.alsa.offers import Rates, UsbFormat, read_usb_stream
from device.errors import NotFoundError
from device.usb import UsbAudioDevice
from device.usb.descriptors import Configuration, PlaybackFormat, RateRange, playback_formats
from device.usb.mapping import hw_names

_DSD = {"raw data", "DSD"}  # "raw data" in USB Audio 2 is taken as native DSD
_SYNCHRONISATIONS = {"ASYNC": "asynchronous", "ADAPTIVE": "adaptive", "SYNC": "synchronous"}
Samplerates = list[int] | dict[str, int] | None  # discrete rates or a range in Hz; None if unknown


def formats_of(
    configuration: Configuration | None,
    device: UsbAudioDevice | None = None,
    asked: Sequence[RateRange] = (),
    root: Path = PROC,
) -> list[dict[str, Any]]:
    """Return formats for JSON: those of the configuration, then those that only the driver lists.

    device: None for a dump, which has no driver. asked: sample rates that the device reported.
    """
    listed = by_setting(device, root) if device else {}
    found = [
        _decoded(each, listed.pop((each.interface, each.alternate), None), asked)
        for each in (playback_formats(configuration) if configuration else ())
    ]
    uac = configuration.uac if configuration else None
    return found + [_listed(each, uac) for each in listed.values()]


def by_setting(device: UsbAudioDevice, root: Path = PROC) -> dict[tuple[int, int], UsbFormat]:
    """Return the formats that the driver lists, keyed by interface and alternate setting."""
    found: dict[tuple[int, int], UsbFormat] = {}
    for name in hw_names(device):
        with suppress(NotFoundError):  # the device was unplugged meanwhile
            stream = read_usb_stream(find_playback(name.removeprefix("hw:"), root))
            for each in stream.formats if stream else ():
                found[each.interface, each.altsetting] = each
    return found


def format_text(each: dict[str, Any], *, units: str = "Hz") -> str:
    """Return a format as text. units: unit of the sample rates, Hz or kHz."""
    width = f" in {each['subslot_bytes']} bytes" if each["subslot_bytes"] else ""
    sample = f"{'/'.join(each['encodings'])} of {each['bits']} bits{width}"
    if set(each["encodings"]) <= _DSD:
        sample = "native DSD"
    channels = f"{each['channels']} channels" if each["channels"] else "an unknown channel count"
    feedback = ", feedback" if each["feedback"] else ""
    if each["implicit_feedback"]:
        feedback = ", implicit feedback"
    rates = samplerates_text(each["samplerates"], units)
    return f"{sample}, {channels}, {rates}, {each['synchronisation']}{feedback}"


def samplerates_text(rates: Samplerates, units: str = "Hz") -> str:
    """Return sample rates as text."""
    per_unit = 1_000.0 if units == "kHz" else 1.0
    if rates is None or rates == []:
        return "unknown samplerates"
    if isinstance(rates, dict):
        lowest, highest = rates["lowest"] / per_unit, rates["highest"] / per_unit
        return f"{lowest:.10g} to {highest:.10g} {units}"
    return f"{', '.join(f'{rate / per_unit:.10g}' for rate in rates)} {units}"


def _decoded(
    each: PlaybackFormat, listed: UsbFormat | None, asked: Sequence[RateRange]
) -> dict[str, Any]:
    rates: Samplerates = None
    if isinstance(each.samplerates, RateRange):
        rates = asdict(each.samplerates)
    elif each.samplerates is not None:
        rates = list(each.samplerates)
    elif listed is not None:
        rates = _of_driver(listed.rates)
    elif asked:
        rates = joined(asked)
    return {
        "interface": each.interface,
        "alternate": each.alternate,
        "audio_class": each.uac,
        "encodings": ["DSD"] if listed and _is_dsd(listed) else list(each.encodings),
        "bits": each.bits,
        "subslot_bytes": each.subslot_bytes,
        "channels": each.channels or (listed.channels if listed else 0),
        "samplerates": rates,
        "synchronisation": each.synchronisation.name.lower(),
        "feedback": each.feedback_endpoint is not None,
        "implicit_feedback": each.implicit_feedback,
    }


def _listed(each: UsbFormat, uac: int | None) -> dict[str, Any]:
    return {
        "interface": each.interface,
        "alternate": each.altsetting,
        "audio_class": uac,
        "encodings": ["DSD"] if _is_dsd(each) else list(each.formats),
        "bits": each.bits,
        "subslot_bytes": 0,
        "channels": each.channels,
        "samplerates": _of_driver(each.rates),
        "synchronisation": _SYNCHRONISATIONS.get(each.sync, "none"),
        "feedback": False,
        "implicit_feedback": False,
    }


def _is_dsd(listed: UsbFormat) -> bool:
    return any(name.startswith("DSD_") for name in listed.formats)


def _of_driver(rates: Rates) -> Samplerates:
    if rates.least:
        return {"lowest": rates.least, "highest": rates.most}
    return list(rates.single)


def joined(asked: Sequence[RateRange]) -> Samplerates:
    """Return sample rates that a device reported, as discrete rates or as one range."""
    if all(one.lowest == one.highest for one in asked):
        return [one.lowest for one in asked]
    lowest, highest = min(one.lowest for one in asked), max(one.highest for one in asked)
    return {"lowest": lowest, "highest": highest}
