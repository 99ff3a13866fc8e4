"""Playable formats, one for each alternate setting that receives samples."""

from dataclasses import dataclass, replace

from device.usb.descriptors.audio_class import INPUT, FeatureControl, RateRange, StreamFormat
from device.usb.descriptors.configuration import (
    Configuration,
    Endpoint,
    Interface,
    Synchronisation,
    Transfer,
    Usage,
)
from device.usb.descriptors.topology import Topology, topologies

_BASIC_FRAMES = 48  # frames in 1 ms at 48 kHz; asynchronous packets have room for one more

# channels and bytes per sample, by bytes per frame
_BASIC_FRAME_BYTES = {2: (1, 2), 3: (1, 3), 4: (2, 2), 6: (2, 3)}


@dataclass(frozen=True, slots=True)
class PlaybackFormat:
    """One way to play: select `alternate` of `interface`, send frames to `endpoint_address`.

    interface, alternate, endpoint_address: numbers for the host's requests. uac: version of USB
    Audio, 1 to 3. encodings: sample encodings, usually "PCM". channels: count, 0 if only the device
    knows it (3.0). channel_config: one bit for each loudspeaker position, 0 if unknown.
    subslot_bytes, bits: bytes of a sample, and its number of significant upper bits. samplerates:
    Hz; None if they must be queried from the clock (2.0, 3.0). packet_bytes_max: largest number of
    bytes per (micro)frame. interval: bInterval. synchronisation: type of the endpoint.
    feedback_endpoint: address of the endpoint that reports the device's rate; None without one.
    implicit_feedback: whether that endpoint records sound, so that its packets give the rate.
    clock_id: clock of the terminal, None in 1.0 and 3.0. clock_sources: possible sources of
    clock_id. control_interface: number for requests to the units. path: ids from the USB terminal
    to the output terminal; empty without a path. feature_unit: id of the unit on the path for
    volume and mute. volume_channels, mute_channels: channels on which the host can set this unit's
    volume or mute; 0 is the master.
    """

    interface: int
    alternate: int
    endpoint_address: int
    uac: int
    encodings: tuple[str, ...]
    channels: int
    channel_config: int
    subslot_bytes: int
    bits: int
    samplerates: tuple[int, ...] | RateRange | None
    packet_bytes_max: int
    interval: int
    synchronisation: Synchronisation
    feedback_endpoint: int | None
    implicit_feedback: bool = False
    clock_id: int | None = None
    clock_sources: tuple[int, ...] = ()
    control_interface: int | None = None
    path: tuple[int, ...] = ()
    feature_unit: int | None = None
    volume_channels: tuple[int, ...] = ()
    mute_channels: tuple[int, ...] = ()


def playback_formats(configuration: Configuration) -> tuple[PlaybackFormat, ...]:
    """Return all formats of type I that the device can play, in the order of its interfaces.

    Alternate settings are left out if they lack an isochronous output endpoint, the sample size or,
    except in 3.0, the channel count. In 3.0 this count is known only for a basic profile, and the
    units are never known. configuration: the device's configuration.
    """
    functions = topologies(configuration)
    streaming = [interface for interface in configuration.interfaces if interface.is_streaming]
    # each function's first implicit feedback endpoint, by control interface
    implicit: dict[int, int] = {}
    for interface in streaming:
        function = functions.get(interface.number)
        for one in _isochronous(interface):
            if function and one.usage is Usage.IMPLICIT_FEEDBACK and one.to_host:
                implicit.setdefault(function.control.number, one.address)
    found = []
    for interface in streaming:
        outward = (one for one in _isochronous(interface) if not one.to_host)
        endpoint = next((one for one in outward if one.usage is not Usage.FEEDBACK), None)
        samples = _samples(interface, endpoint) if endpoint else None
        if endpoint and samples:
            function = functions.get(interface.number) if interface.uac != 3 else None
            found.append(_playback(interface, endpoint, samples, function, implicit))
    return tuple(found)


def _samples(interface: Interface, endpoint: Endpoint) -> StreamFormat | None:
    """Return the sample format of an alternate setting; None if it is incomplete or not of type I.

    A setting of 3.0 without a general descriptor has a basic profile: PCM at 48 kHz. Its channels
    and bits follow from the packet size for 1 ms (Basic Audio Device 3.0, table 4-2).
    """
    general, stream_format = interface.general, interface.format
    if interface.uac == 3:
        if general:
            samples = StreamFormat(general.subslot_bytes, general.bits)
        else:
            channels, size = _BASIC_FRAME_BYTES.get(endpoint.packet_bytes // _BASIC_FRAMES, (0, 0))
            samples = StreamFormat(size, 8 * size, channels, (1_000 * _BASIC_FRAMES,))
        return samples if samples.subslot_bytes else None
    if not general or not stream_format or not stream_format.subslot_bytes:
        return None
    total = general.channels or stream_format.channels
    return replace(stream_format, channels=total) if total else None


def _playback(
    interface: Interface,
    endpoint: Endpoint,
    samples: StreamFormat,
    function: Topology | None,
    implicit: dict[int, int],
) -> PlaybackFormat:
    general = interface.general
    terminal = function.terminals.get(general.terminal_link) if function and general else None
    terminal = terminal if terminal and terminal.kind == INPUT else None
    channel_config = general.channel_config if general else None
    if channel_config is None:
        same = terminal is not None and terminal.channels == samples.channels
        channel_config = terminal.channel_config if terminal and same else 0
    clock_id = next(iter(terminal.clock_ids), None) if terminal else None
    path, unit = function.output(terminal.id) if function and terminal else ((), None)
    feedback, is_implicit = _feedback(interface, endpoint), False
    if function and feedback is None and endpoint.synchronisation is Synchronisation.ASYNCHRONOUS:
        feedback = implicit.get(function.control.number)
        is_implicit = feedback is not None
    return PlaybackFormat(
        interface=interface.number,
        alternate=interface.alternate,
        endpoint_address=endpoint.address,
        uac=interface.uac,
        encodings=general.encodings if general else ("PCM",),
        channels=samples.channels or 0,
        subslot_bytes=samples.subslot_bytes,
        bits=samples.bits,
        samplerates=samples.samplerates,
        channel_config=channel_config,
        packet_bytes_max=endpoint.packet_bytes,
        interval=endpoint.interval,
        synchronisation=endpoint.synchronisation,
        feedback_endpoint=feedback,
        implicit_feedback=is_implicit,
        clock_id=clock_id,
        clock_sources=function.clock_sources(clock_id) if function and clock_id else (),
        control_interface=function.control.number if function else None,
        path=path,
        feature_unit=unit.id if unit else None,
        volume_channels=unit.settable(FeatureControl.VOLUME) if unit else (),
        mute_channels=unit.settable(FeatureControl.MUTE) if unit else (),
    )


def _isochronous(interface: Interface) -> list[Endpoint]:
    return [one for one in interface.endpoints if one.transfer is Transfer.ISOCHRONOUS]


def _feedback(interface: Interface, endpoint: Endpoint) -> int | None:
    """Return the address of the explicit feedback endpoint for a data endpoint; None without one.

    An endpoint that is marked as feedback has priority. Devices of 1.0 instead give the address in
    bSynchAddress, sometimes without the direction bit. If there is neither, an asynchronous data
    endpoint uses the first isochronous IN data endpoint of the same setting.
    """
    beside = [one for one in _isochronous(interface) if one.to_host]
    synch = endpoint.synch_address
    asynchronous = endpoint.synchronisation is Synchronisation.ASYNCHRONOUS
    marked = [one.address for one in beside if one.usage is Usage.FEEDBACK]
    named = [one.address for one in beside if synch and one.address == synch | 0x80]
    others = [one.address for one in beside if asynchronous and one.usage is Usage.DATA]
    return next(iter(marked + named + others), None)
