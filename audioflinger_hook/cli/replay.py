"""`cushion replay`: processes the recorded buffers of a capture, and writes the vibration."""

import argparse
import time
from pathlib import Path

from audioflinger_hook.capture.format import INDEX_NAME, STREAMS
from audioflinger_hook.cli.render import chosen_settings, show_report
from audioflinger_hook.cli.terminal import progress_bar
from audioflinger_hook.daemon.recording import settings_from
from audioflinger_hook.offline.render import refuse_same_file, render
from audioflinger_hook.pipeline.step import RealTimePace
from audioflinger_hook.sources import CaptureTap, TapClient
from device.drive.outputs import FADE_S
from device.errors import UsageError

SPEEDS = ("max", "1")


def run(options: argparse.Namespace) -> int:
    """Replay a capture and print a summary."""
    if options.speed not in SPEEDS:
        raise UsageError(f"speed={options.speed!r} is not known; allowed: {', '.join(SPEEDS)}")
    for source in (options.folder, *capture_files(options.folder)):
        refuse_same_file(source, options.output, options.acceleration)
    tap = CaptureTap(options.folder)
    recorded = settings_from(tap.facts)
    settings = chosen_settings(options, recorded)
    client = TapClient(tap)
    pace = RealTimePace(client.samplerate, time.monotonic())

    def wait(frames: int) -> None:
        time.sleep(pace.wait_s(frames, time.monotonic()))

    with progress_bar(options.folder.name) as progress:
        report = render(
            client,
            options.output,
            settings,
            acceleration=options.acceleration,
            progress=progress,
            wait=wait if options.speed == "1" else None,
            warnings=tap.warnings,
            # A recorded run is replayed bit for bit, including its last sample.
            fade_s=0.0 if recorded else FADE_S,
        )
    replayed = {
        "buffers": client.buffers,
        "format_changes": client.format_changes,
        "discontinuities": client.discontinuities,
    }
    show_report(report, options, replayed)
    return 0


def capture_files(folder: Path) -> list[Path]:
    """Return the files of the capture in a folder."""
    segments = [path for stream in STREAMS for path in folder.glob(f"{stream}-*.wav")]
    return [folder / INDEX_NAME, *segments]
