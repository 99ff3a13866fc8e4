"""What USB audio devices say they are: descriptors of USB Audio 1.0 and 2.0 from raw bytes.

    hexdump.py        bytes from what people send
    blocks.py         bytes cut into descriptors; problems.py: what is wrong with them, and where
    standard.py       device, configuration, association, endpoint
    entities.py       terminals, units, clocks (read by control_v1.py, control_v2.py)
    streaming.py      formats, samplerates, streaming endpoints
    reading.py        the whole of a configuration, as the tree of configuration.py
    checks.py         where it contradicts itself
    topology.py       how sound and clocks flow through it
    whole.py          a device with all its configurations
    playback.py       what can be played, and how
    text.py, names.py the same for people

Pure functions of bytes: nothing here touches a device. USB Audio 3.0 and whatever nobody knows is
named and kept with its bytes. Volumes are in 1/256 dB.
"""

from device.usb.descriptors.blocks import Descriptor, OtherDescriptor
from device.usb.descriptors.configuration import Configuration, Interface, audio_endpoint
from device.usb.descriptors.entities import (
    USB_STREAMING,
    VOLUME_UNITS_PER_DB,
    Access,
    ClockKind,
    ClockMultiplier,
    ClockSelector,
    ClockSource,
    ControlHeader,
    EffectUnit,
    Entity,
    ExtensionUnit,
    FeatureControl,
    FeatureUnit,
    InputTerminal,
    MixerUnit,
    OutputTerminal,
    ProcessingUnit,
    SampleRateConverter,
    SelectorUnit,
)
from device.usb.descriptors.hexdump import parse_hex
from device.usb.descriptors.names import position_names, terminal_name
from device.usb.descriptors.playback import PlaybackFormat, playback_formats
from device.usb.descriptors.problems import DescriptorError, Problem
from device.usb.descriptors.reading import parse_configuration
from device.usb.descriptors.standard import (
    ConfigurationHeader,
    DeviceDescriptor,
    Endpoint,
    InterfaceAssociation,
    Synchronisation,
    Transfer,
    Usage,
    parse_device,
)
from device.usb.descriptors.streaming import (
    AudioEndpoint,
    OtherFormat,
    RateRange,
    StreamFormat,
    StreamGeneral,
)
from device.usb.descriptors.text import describe
from device.usb.descriptors.topology import Topology, topologies
from device.usb.descriptors.whole import WholeDevice, parse_whole

__all__ = [
    "USB_STREAMING",
    "VOLUME_UNITS_PER_DB",
    "Access",
    "AudioEndpoint",
    "ClockKind",
    "ClockMultiplier",
    "ClockSelector",
    "ClockSource",
    "Configuration",
    "ConfigurationHeader",
    "ControlHeader",
    "Descriptor",
    "DescriptorError",
    "DeviceDescriptor",
    "EffectUnit",
    "Endpoint",
    "Entity",
    "ExtensionUnit",
    "FeatureControl",
    "FeatureUnit",
    "InputTerminal",
    "Interface",
    "InterfaceAssociation",
    "MixerUnit",
    "OtherDescriptor",
    "OtherFormat",
    "OutputTerminal",
    "PlaybackFormat",
    "Problem",
    "ProcessingUnit",
    "RateRange",
    "SampleRateConverter",
    "SelectorUnit",
    "StreamFormat",
    "StreamGeneral",
    "Synchronisation",
    "Topology",
    "Transfer",
    "Usage",
    "WholeDevice",
    "audio_endpoint",
    "describe",
    "parse_configuration",
    "parse_device",
    "parse_hex",
    "parse_whole",
    "playback_formats",
    "position_names",
    "terminal_name",
    "topologies",
]
