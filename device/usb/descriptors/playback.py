"""Formats that can be played, one for each alternate setting that takes samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from device.usb.descriptors.audio_class import INPUT, FeatureControl, RateRange
from device.usb.descriptors.configuration import (
    Configuration,
    Endpoint,
    Interface,
    Synchronisation,
    Transfer,
    Usage,
)
from device.usb.descriptors.topology import Topology, topologies

_BASIC_FRAMES = 48  # of 1 ms; asynchronous endpoints have room for one more

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

    configuration: the decoded one.
    """
    functions = topologies(configuration)
    implicit = _implicit_endpoints(configuration, functions)
    found = []
    for interface in configuration.interfaces:
        endpoint = next((one for one in interface.endpoints if _takes_samples(one)), None)
        if not interface.is_streaming or endpoint is None:
            continue
        samples = _samples(interface, endpoint)
        if samples:
            function = functions.get(interface.number) if interface.uac != 3 else None
            found.append(_playback(interface, endpoint, samples, function, implicit))
    return tuple(found)


class _Samples(NamedTuple):
    """What an alternate setting takes, as in `PlaybackFormat`."""

    encodings: tuple[str, ...]
    channels: int
    subslot_bytes: int
    bits: int
    samplerates: tuple[int, ...] | RateRange | None


def _samples(interface: Interface, endpoint: Endpoint) -> _Samples | None:
    """Return what an alternate setting takes; None if it takes no samples of type I.

    One of 3.0 without a general descriptor has a basic profile: PCM at 48 kHz. Its channels and
    bits follow from the bytes of 1 ms (Basic Audio Device 3.0, table 4-2).
    """
    general, stream_format = interface.general, interface.format
    if interface.uac == 3:
        if general:
            samples = _Samples(general.encodings, 0, general.subslot_bytes, general.bits, None)
        else:
            frame_bytes = endpoint.packet_bytes // _BASIC_FRAMES
            channels, size = _BASIC_FRAME_BYTES.get(frame_bytes, (0, 0))
            samples = _Samples(("PCM",), channels, size, 8 * size, (1_000 * _BASIC_FRAMES,))
        return samples if samples.subslot_bytes else None
    if not general or not stream_format or not stream_format.subslot_bytes:
        return None
    channels = general.channels or stream_format.channels or 0
    if not channels:
        return None
    size, bits = stream_format.subslot_bytes, stream_format.bits
    return _Samples(general.encodings, channels, size, bits, stream_format.samplerates)


def _playback(
    interface: Interface,
    endpoint: Endpoint,
    samples: _Samples,
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
        **samples._asdict(),
    )


def _takes_samples(endpoint: Endpoint) -> bool:
    isochronous = endpoint.transfer is Transfer.ISOCHRONOUS
    return isochronous and not endpoint.to_host and endpoint.usage is not Usage.FEEDBACK


def _feedback(interface: Interface, endpoint: Endpoint) -> int | None:
    """Return the address of the explicit feedback endpoint beside a data endpoint.

    Devices of 1.0 name it in bSynchAddress instead of marking it. Some give its number without the
    direction, which Linux accepts as well. Some do neither: then it is the endpoint of the other
    direction.
    """
    beside = [
        other
        for other in interface.endpoints
        if other.transfer is Transfer.ISOCHRONOUS and other.to_host
    ]
    synch = endpoint.synch_address
    asynchronous = endpoint.synchronisation is Synchronisation.ASYNCHRONOUS
    marked = [one.address for one in beside if one.usage is Usage.FEEDBACK]
    named = [one.address for one in beside if synch and one.address == synch | 0x80]
    others = [one.address for one in beside if asynchronous and one.usage is Usage.DATA]
    return next(iter(marked + named + others), None)


def _implicit_endpoints(
    configuration: Configuration, functions: dict[int, Topology]
) -> dict[int, int]:
    """Return the first endpoint marked as implicit feedback, by control interface."""
    found: dict[int, int] = {}
    for interface in configuration.interfaces:
        function = functions.get(interface.number) if interface.is_streaming else None
        for endpoint in interface.endpoints:
            marked = endpoint.usage is Usage.IMPLICIT_FEEDBACK and endpoint.to_host
            if function and marked and endpoint.transfer is Transfer.ISOCHRONOUS:
                found.setdefault(function.control.number, endpoint.address)
    return found
