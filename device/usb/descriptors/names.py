"""The words for numbers in descriptors: types, classes, terminals, loudspeaker positions.

Sources: USB 2.0 table 9-5, USB 3.2 table 9-6; USB Audio 1.0 appendix A, 2.0 appendix A, 3.0
appendix A; Terminal Types 2.0; MIDI Devices 1.0 appendix A.
"""

from __future__ import annotations

from collections.abc import Mapping

_TYPES = {
    0x01: "device",
    0x02: "configuration",
    0x03: "string",
    0x04: "interface",
    0x05: "endpoint",
    0x06: "device qualifier",
    0x07: "other speed configuration",
    0x08: "interface power",
    0x09: "on-the-go",
    0x0A: "debug",
    0x0B: "interface association",
    0x0F: "binary object store",
    0x10: "device capability",
    0x21: "class-specific",
    0x22: "class report",
    0x23: "class physical",
    0x24: "class-specific interface",
    0x25: "class-specific endpoint",
    0x30: "SuperSpeed endpoint companion",
    0x31: "SuperSpeedPlus isochronous endpoint companion",
}

_CLASSES = {
    0x00: "class per interface",
    0x01: "audio",
    0x02: "communications",
    0x03: "HID",
    0x05: "physical",
    0x06: "image",
    0x07: "printer",
    0x08: "mass storage",
    0x09: "hub",
    0x0A: "communications data",
    0x0B: "smart card",
    0x0D: "content security",
    0x0E: "video",
    0x0F: "personal healthcare",
    0x10: "audio/video",
    0xDC: "diagnostic",
    0xE0: "wireless controller",
    0xEF: "miscellaneous",
    0xFE: "application specific",
    0xFF: "vendor specific",
}

_AUDIO_SUBCLASSES = {1: "audio control", 2: "audio streaming", 3: "MIDI streaming"}

_UAC3_CONTROL = {
    0x01: "header",
    0x02: "input terminal",
    0x03: "output terminal",
    0x04: "extended terminal",
    0x05: "mixer unit",
    0x06: "selector unit",
    0x07: "feature unit",
    0x08: "effect unit",
    0x09: "processing unit",
    0x0A: "extension unit",
    0x0B: "clock source",
    0x0C: "clock selector",
    0x0D: "clock multiplier",
    0x0E: "sample rate converter",
    0x0F: "connectors",
    0x10: "power domain",
}

_UAC3_STREAMING = {1: "streaming general", 2: "valid frequency range"}

_MIDI = {1: "header", 2: "in jack", 3: "out jack", 4: "element"}

_TERMINALS = {
    0x0100: "USB",
    0x0101: "USB streaming",
    0x01FF: "USB vendor specific",
    0x0200: "input",
    0x0201: "microphone",
    0x0202: "desktop microphone",
    0x0203: "personal microphone",
    0x0204: "omni-directional microphone",
    0x0205: "microphone array",
    0x0206: "processing microphone array",
    0x0300: "output",
    0x0301: "speaker",
    0x0302: "headphones",
    0x0303: "head-mounted display audio",
    0x0304: "desktop speaker",
    0x0305: "room speaker",
    0x0306: "communication speaker",
    0x0307: "low-frequency speaker",
    0x0400: "bidirectional",
    0x0401: "handset",
    0x0402: "headset",
    0x0403: "speakerphone",
    0x0404: "echo-suppressing speakerphone",
    0x0405: "echo-cancelling speakerphone",
    0x0500: "telephony",
    0x0501: "phone line",
    0x0502: "telephone",
    0x0503: "down line phone",
    0x0600: "external",
    0x0601: "analog connector",
    0x0602: "digital audio interface",
    0x0603: "line connector",
    0x0604: "legacy audio connector",
    0x0605: "S/PDIF interface",
    0x0606: "IEEE 1394 DA stream",
    0x0607: "IEEE 1394 DV soundtrack",
    0x0608: "ADAT lightpipe",
    0x0609: "TDIF",
    0x060A: "MADI",
    0x0700: "embedded",
    0x0703: "CD player",
    0x0710: "radio receiver",
    0x0711: "radio transmitter",
    0x0713: "synthesizer",
}

_POSITIONS = (
    "front-left",
    "front-right",
    "front-center",
    "lfe",
    "rear-left",
    "rear-right",
    "front-left-of-center",
    "front-right-of-center",
    "rear-center",
    "side-left",
    "side-right",
    "top-center",
    "top-front-left",
    "top-front-center",
    "top-front-right",
    "top-rear-left",
    "top-rear-center",
    "top-rear-right",
    "top-front-left-of-center",
    "top-front-right-of-center",
    "left-lfe",
    "right-lfe",
    "top-side-left",
    "top-side-right",
    "bottom-center",
    "rear-left-of-center",
    "rear-right-of-center",
)
"""By bit. USB Audio 1.0 has the first 12, by other names for the same places."""


def type_name(number: int) -> str:
    """The name of a descriptor type, "type 0x41" for an unknown type."""
    return _TYPES.get(number) or f"type 0x{number:02x}"


def class_name(interface_class: int, subclass: int) -> str:
    """The name of an interface's class, with the subclass if the class is audio."""
    if interface_class == 0x01 and subclass in _AUDIO_SUBCLASSES:
        return _AUDIO_SUBCLASSES[subclass]
    return _CLASSES.get(interface_class) or f"class 0x{interface_class:02x}"


def uac3_name(streaming: bool, subtype: int) -> str:
    """The name of a class-specific interface descriptor of USB Audio 3.0."""
    names = _UAC3_STREAMING if streaming else _UAC3_CONTROL
    return f"UAC3 {names.get(subtype) or f'subtype 0x{subtype:02x}'}"


def midi_name(subtype: int) -> str:
    """The name of a class-specific descriptor of a MIDI streaming interface."""
    return f"MIDI {_MIDI.get(subtype) or f'subtype 0x{subtype:02x}'}"


def terminal_name(terminal_type: int) -> str:
    """The name of a terminal's type, "type 0x0999" for an unknown type."""
    return _TERMINALS.get(terminal_type) or f"type 0x{terminal_type:04x}"


def position_names(channel_config: int) -> tuple[str, ...]:
    """The positions of a cluster's first channels, in the order of the channels.

    channel_config: wChannelConfig or bmChannelConfig. Bits without a position are "bit 29".
    """
    return named_bits(channel_config, {**dict(enumerate(_POSITIONS)), 31: "raw data"}, "bit")


def named_bits(bits: int, names: Mapping[int, str], unnamed: str) -> tuple[str, ...]:
    """The names of the bits that are set, the lowest first; unnamed: such as "bit" of "bit 29"."""
    found = (bit for bit in range(bits.bit_length()) if bits >> bit & 1)
    return tuple(names.get(bit) or f"{unnamed} {bit}" for bit in found)
