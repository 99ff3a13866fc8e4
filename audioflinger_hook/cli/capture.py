"""`cushion capture`: records the audio buffers of a tap (a source of sound) unchanged."""

import argparse
import time
from contextlib import closing
from pathlib import Path

from audioflinger_hook.capture import CaptureRecorder, CaptureWriter
from audioflinger_hook.cli.process import Signals, freeze_loaded_objects
from audioflinger_hook.cli.terminal import progress_bar, warn
from audioflinger_hook.daemon.live_capture import TICK_S, LiveCapture
from audioflinger_hook.daemon.timing import Wake
from audioflinger_hook.sources import TapAddress, open_tap, parse_tap
from device.stream import filter_stderr
from device.values import counted


def run(options: argparse.Namespace) -> int:
    """Record `--seconds` of sound, or less if the sound ends; then print a summary."""
    address = parse_tap(options.tap)
    if address.kind in ("default", "sink"):  # live sound
        _record_live(address, options.folder, options.seconds, debug=options.debug)
        return 0
    tap = open_tap(address)
    heard_s = 0.0
    with (
        closing(tap),
        CaptureWriter(options.folder, facts={"tap": str(address)}) as writer,
        progress_bar(str(address)) as progress,
    ):
        while heard_s < options.seconds and (buffer := tap.read()) is not None:
            now_s = time.monotonic()
            gap = tap.discontinuity
            writer.write_buffer("tap", buffer, tap.samplerate, now_s, discontinuity=gap)
            heard_s += len(buffer) / tap.samplerate
            progress(writer.frames("tap"), tap.frames_expected)
    warn(*getattr(tap, "warnings", ()))
    _print_summary(writer, heard_s, tap.samplerate, tap.channels)
    return 0


def _print_summary(writer: CaptureWriter, heard_s: float, samplerate: int, channels: int) -> None:
    buffers, of = counted(writer.buffers("tap"), "buffers"), counted(channels, "channels")
    print(f"{writer.folder}: {heard_s:.2f} s in {buffers}, {of} at {samplerate} Hz")


def _record_live(address: TapAddress, folder: Path, seconds: float, *, debug: bool) -> None:
    if not debug:
        filter_stderr()
    with (
        Wake() as wake,
        Signals(wake) as signals,
        closing(LiveCapture(address, wake, time.monotonic())) as live,
    ):
        live.look()
        writer = CaptureWriter(folder, facts={"tap": str(address)})
        with (
            CaptureRecorder(writer) as recorder,
            progress_bar(str(address)) as progress,
            closing(live),  # no buffer may arrive after the recorder is closed
        ):
            freeze_loaded_objects()
            live.begin(recorder)
            while live.heard_s < seconds and not signals.end and not recorder.error:
                live.tick(time.monotonic())
                progress(live.heard_s, seconds if seconds < float("inf") else None)
                wake.wait(TICK_S)
        if signals.end:
            raise KeyboardInterrupt
    dropped, frames = recorder.dropped("tap")
    if dropped:
        lost = counted(dropped, "buffers")
        warn(f"not recorded: {lost} ({frames} frames): the disk was too slow")
    _print_summary(writer, live.heard_s, *live.format)
