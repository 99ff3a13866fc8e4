"""`cushion test-tone`: a short vibration on one device, to find the right output."""

from __future__ import annotations

import argparse
from contextlib import ExitStack, closing

from audioflinger_hook.cli.tone import FADE_S, PCM, open_tone
from device.address import parse_device
from device.errors import UsageError
from device.server import PulseConnection
from device.stream import PcmConfig, filter_stderr

LIMIT_HZ = (20.0, 220.0)


def run(options: argparse.Namespace) -> int:
    """Play the tone on this device and on no other."""
    low, high = LIMIT_HZ
    if not low <= options.hz <= high:
        raise UsageError(f"hz={options.hz:.12g} is out of range; allowed: {low:g} to {high:g} Hz")
    if not 0.0 < options.level <= 1.0:
        raise UsageError(f"level={options.level:.12g} is out of range; allowed: above 0, up to 1")
    if not FADE_S * 2 < options.seconds <= 60.0:
        raise UsageError(f"seconds={options.seconds:.12g} is out of range; allowed: 0.2 to 60 s")
    device = parse_device(options.device)
    if device.kind not in ("sink", "usb"):
        raise UsageError(
            f"device {str(device)!r} cannot play a test tone; allowed: sink:NAME, usb:VID:PID"
        )
    filter_stderr()
    with ExitStack() as stack:
        pcms = stack.enter_context(closing(PcmConfig(PCM)))
        connection = stack.enter_context(closing(PulseConnection()))
        player = stack.enter_context(open_tone(device, pcms.pcms[PCM], connection, options.hz))
        player.tone.play(options.level, options.seconds)
        print(f"{player.name}: {options.hz:g} Hz", flush=True)
        player.wait_ended()
    return 0
