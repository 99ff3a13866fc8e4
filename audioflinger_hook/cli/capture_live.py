"""`cushion capture` of what plays, until it is stopped."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path

from audioflinger_hook.capture import CaptureRecorder, CaptureWriter
from audioflinger_hook.cli.signals import Signals
from audioflinger_hook.cli.terminal import progress_bar, warn
from audioflinger_hook.daemon.gc_freeze import freeze_loaded_objects
from audioflinger_hook.daemon.live_capture import TICK_S, LiveCapture
from audioflinger_hook.daemon.wake import Wake
from audioflinger_hook.sources import TapAddress
from device.stream import filter_stderr


def record(
    address: TapAddress, folder: Path, seconds: float, *, debug: bool
) -> tuple[CaptureWriter, LiveCapture]:
    """Record so many seconds of sound, or until a signal; return the writer and the capture."""
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
        warn(f"{dropped} buffers ({frames} frames) could not be kept: the disk was too slow")
    return writer, live
