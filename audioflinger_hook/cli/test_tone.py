"""`cushion test-tone`: a short vibration on one device, to find the right output."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, closing

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.cli.tone import FADE_S, PCM, open_tone
from audioflinger_hook.daemon.outputs.sink import muted
from device.address import parse_device
from device.errors import UsageError
from device.server import PulseConnection, ServerSnapshot
from device.server.snapshot import Sink
from device.stream import PcmConfig, filter_stderr


def run(options: argparse.Namespace) -> int:
    """Play the tone on this device and on no other."""
    if not 20.0 <= options.hz <= 220.0:
        raise UsageError(f"hz={options.hz:.12g} is out of range; allowed: 20 to 220 Hz")
    if not 0.0 < options.level <= 1.0:
        raise UsageError(f"level={options.level:.12g} is out of range; allowed: above 0, up to 1")
    if not FADE_S * 2 < options.seconds <= 60.0:
        raise UsageError(f"seconds={options.seconds:.12g} is out of range; allowed: 0.2 to 60 s")
    device = parse_device(options.device)
    if device.kind not in ("sink", "usb"):
        allowed = "sink:NAME, usb:VID:PID"
        raise UsageError(f"device {str(device)!r} cannot play a test tone; allowed: {allowed}")
    filter_stderr()
    with ExitStack() as stack:
        pcms = stack.enter_context(closing(PcmConfig(PCM)))
        connection = stack.enter_context(closing(PulseConnection()))
        player = stack.enter_context(open_tone(device, pcms.pcms[PCM], connection, options.hz))
        player.tone.play(options.level, options.seconds)
        how = f"{options.hz:g} Hz for {options.seconds:g} s, at {options.level:.0%} of full scale"
        print(f"{player.name}: {how}", flush=True)
        for warning in _warnings(device.sink(connection.latest), connection.latest):
            warn(warning)
        player.wait_ended()
    return 0


def _warnings(sink: Sink, snapshot: ServerSnapshot) -> Iterator[str]:
    if sink.mute:
        yield muted(sink.name)
    elif sink.weakened:
        yield f"{sink.name} has {sink.weakened}, which makes the vibration weaker"
    if sink.name == snapshot.default_sink:
        yield (
            f"{sink.name} is the default output, where the computer's sound plays; vibration needs "
            "another one, see `cushion devices`"
        )
