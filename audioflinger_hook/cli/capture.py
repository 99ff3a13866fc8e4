"""`cushion capture`: the buffers of a tap, kept exactly as they are delivered."""

from __future__ import annotations

import argparse
import time

from audioflinger_hook.capture import CaptureWriter
from audioflinger_hook.cli.terminal import progress_bar, warn
from audioflinger_hook.clients import open_tap, parse_tap


def run(options: argparse.Namespace) -> int:
    """Record until the tap ends, or for so many seconds of sound, and say what is there."""
    address = parse_tap(options.tap)
    tap = open_tap(address)
    try:
        with (
            CaptureWriter(options.folder, facts={"tap": str(address)}) as writer,
            progress_bar(str(address)) as progress,
        ):
            heard_s = 0.0
            while heard_s < options.seconds:
                buffer = tap.read()
                if buffer is None:
                    break
                writer.write_buffer(
                    "tap",
                    buffer,
                    tap.samplerate,
                    time.monotonic(),
                    discontinuity=tap.discontinuity,
                )
                heard_s += len(buffer) / tap.samplerate
                progress(writer.frames("tap"), tap.frames_expected)
    finally:
        tap.close()
    for warning in getattr(tap, "warnings", ()):
        warn(warning)
    count = writer.buffers("tap")
    print(
        f"{options.folder}: {heard_s:.2f} s in {count} buffer{'s' if count != 1 else ''}, "
        f"{tap.channels} channel{'s' if tap.channels > 1 else ''} at {tap.samplerate} Hz"
    )
    return 0
