"""Formats that can be played, one for each alternate setting that takes samples."""

from __future__ import annotations

from dataclasses import dataclass

from device.usb.descriptors.configuration import (
    Configuration,
    Endpoint,
    Interface,
    Synchronisation,
    Transfer,
    Usage,
)
from device.usb.descriptors.entities import INPUT, FeatureControl
from device.usb.descriptors.streaming import RateRange
from device.usb.descriptors.topology import Topology, topologies

_BASIC_FRAMES = 48
"""Of 1 ms; asynchronous endpoints have room for one more."""

_BASIC_FRAME_BYTES = {2: (1, 2), 3: (1, 3), 4: (2, 2), 6: (2, 3)}
"""Channels and bytes of a sample, by the bytes of a frame."""


@dataclass(frozen=True, slots=True)
class PlaybackFormat:
    """One way to play: choose `alternate` of `interface`, send frames to `endpoint_address`.

    interface, alternate, endpoint_address: numbers for the host's requests.
    uac: version of USB Audio, 1 to 3.
    encodings: of a sample, usually "PCM".
    channels: count, 0 where only the device knows it (3.0).
    channel_config: one bit a loudspeaker position, 0 where unknown.
    subslot_bytes, bits: bytes of a sample, and its significant upper bits.
    samplerates: Hz; None where the clock has to be asked (2.0, 3.0).
    packet_bytes_max, interval: bytes of one (micro)frame, and bInterval.
    synchronisation: the clock that the endpoint follows.
    feedback_endpoint: address of the endpoint that reports the device's rate.
    implicit_feedback: whether that is a recording endpoint, whose packets give the rate.
    clock_id: clock of the terminal, None in 1.0 and 3.0.
    clock_sources: clock sources that may drive it.
    control_interface: for requests to the function's units.
    path: ids from the USB terminal to the output terminal; empty without a path.
    feature_unit: unit on the path for volume and mute, see `Topology.output`.
    volume_channels, mute_channels: channels of that unit that the host can set; 0 is the master.
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
    """Return every format of type I that the device plays, in the order of its interfaces.

    Alternate settings without an isochronous output endpoint, channels or sample size are left out.
    Of 3.0 the channels are known in a basic profile only, and the units never.

    Parameters
    ----------
    configuration : Configuration
        The decoded configuration.
    """
    functions = topologies(configuration)
    implicit = _implicit_endpoints(configuration, functions)
    found = []
    for interface in configuration.interfaces:
        endpoint = _data_endpoint(interface)
        if not interface.is_streaming or endpoint is None:
            continue
        if interface.uac == 3:
            playback = _playback_3(interface, endpoint)
        else:
            playback = _playback(interface, endpoint, functions.get(interface.number), implicit)
        if playback:
            found.append(playback)
    return tuple(found)


def _playback(
    interface: Interface,
    endpoint: Endpoint,
    function: Topology | None,
    implicit: dict[int, int],
) -> PlaybackFormat | None:
    general, stream_format = interface.general, interface.format
    if not general or not stream_format or not stream_format.subslot_bytes:
        return None
    channels = general.channels or stream_format.channels or 0
    if not channels:
        return None
    terminal = function.terminals.get(general.terminal_link) if function else None
    terminal = terminal if terminal and terminal.kind == INPUT else None
    channel_config = general.channel_config
    if channel_config is None:
        same = terminal is not None and terminal.channels == channels
        channel_config = terminal.channel_config if terminal and same else 0
    clock_id = next(iter(terminal.clock_ids), None) if terminal else None
    path, unit = function.output(terminal.id) if function and terminal else ((), None)
    feedback, is_implicit = _feedback(interface, endpoint), False
    if feedback is None and endpoint.synchronisation is Synchronisation.ASYNCHRONOUS:
        feedback = implicit.get(function.control.number) if function else None
        is_implicit = feedback is not None
    return PlaybackFormat(
        interface=interface.number,
        alternate=interface.alternate,
        endpoint_address=endpoint.address,
        uac=general.uac,
        encodings=general.encodings,
        channels=channels,
        channel_config=channel_config,
        subslot_bytes=stream_format.subslot_bytes,
        bits=stream_format.bits,
        samplerates=stream_format.samplerates,
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


def _playback_3(interface: Interface, endpoint: Endpoint) -> PlaybackFormat | None:
    """Return the format of an alternate setting of 3.0.

    Without a general descriptor it has a basic profile: PCM at 48 kHz. Its channels and bits follow
    from the bytes of 1 ms (Basic Audio Device 3.0, table 4-2).
    """
    general, rates = interface.general, None
    encodings: tuple[str, ...]
    if general is not None:
        encodings, channels = general.encodings, 0
        subslot_bytes, bits = general.subslot_bytes, general.bits
    else:
        frame_bytes = endpoint.packet_bytes // _BASIC_FRAMES
        channels, subslot_bytes = _BASIC_FRAME_BYTES.get(frame_bytes, (0, 0))
        encodings, bits, rates = ("PCM",), 8 * subslot_bytes, (1_000 * _BASIC_FRAMES,)
    if not subslot_bytes:
        return None
    return PlaybackFormat(
        interface=interface.number,
        alternate=interface.alternate,
        endpoint_address=endpoint.address,
        uac=3,
        encodings=encodings,
        channels=channels,
        channel_config=0,
        subslot_bytes=subslot_bytes,
        bits=bits,
        samplerates=rates,
        packet_bytes_max=endpoint.packet_bytes,
        interval=endpoint.interval,
        synchronisation=endpoint.synchronisation,
        feedback_endpoint=_feedback(interface, endpoint),
    )


def _data_endpoint(interface: Interface) -> Endpoint | None:
    """Return the first isochronous endpoint to the device that carries samples."""
    for endpoint in interface.endpoints:
        isochronous = endpoint.transfer is Transfer.ISOCHRONOUS
        if isochronous and not endpoint.to_host and endpoint.usage is not Usage.FEEDBACK:
            return endpoint
    return None


def _feedback(interface: Interface, endpoint: Endpoint) -> int | None:
    """Return the address of the explicit feedback endpoint beside a data endpoint.

    Devices of 1.0 name it in bSynchAddress instead of marking it. Some do neither: then it is the
    endpoint of the other direction.
    """
    beside = [
        other
        for other in interface.endpoints
        if other.transfer is Transfer.ISOCHRONOUS and other.to_host
    ]
    for other in beside:
        if other.usage is Usage.FEEDBACK:
            return other.address
    synch = endpoint.synch_address
    for other in beside:
        # Some devices give its number without the direction, which Linux accepts as well.
        if synch and other.address == synch | 0x80:
            return other.address
    if endpoint.synchronisation is Synchronisation.ASYNCHRONOUS:
        for other in beside:
            if other.usage is Usage.DATA:
                return other.address
    return None


def _implicit_endpoints(
    configuration: Configuration, functions: dict[int, Topology]
) -> dict[int, int]:
    """Return the first endpoint marked as implicit feedback, by control interface."""
    found: dict[int, int] = {}
    for interface in configuration.interfaces:
        function = functions.get(interface.number) if interface.is_streaming else None
        for endpoint in interface.endpoints if function else ():
            marked = endpoint.usage is Usage.IMPLICIT_FEEDBACK and endpoint.to_host
            if function and marked and endpoint.transfer is Transfer.ISOCHRONOUS:
                found.setdefault(function.control.number, endpoint.address)
    return found
