"""`cushion run`: everything this computer plays, felt, until it is told to stop."""

from __future__ import annotations

import argparse
import dataclasses
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from datetime import datetime
from pathlib import Path

from audioflinger_hook import config
from audioflinger_hook.cli.replay import capture_files
from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.clients import TapAddress, parse_tap
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.order import (
    LIVE_DEVICES,
    LIVE_TAPS,
    PACED_DEVICES,
    PACED_TAPS,
    Order,
)
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.report import status_of
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.wake import Wake
from audioflinger_hook.render import refuse_same_file
from audioflinger_hook.service.folder import RuntimeFolder
from audioflinger_hook.service.lock import DaemonLock, Holder
from audioflinger_hook.service.notify import Notifier
from audioflinger_hook.service.socket import StatusServer
from audioflinger_hook.service.watchdog import Watchdog, watchdog_period_s
from audioflinger_hook.settings import Settings
from device.address import DeviceAddress, parse_device
from device.errors import NotFoundError, UsageError
from device.server import quiet_libraries


def run(options: argparse.Namespace) -> int:
    """Run until `--seconds` of sound are over, the sound ends or somebody ends it."""
    tap, device = parse_tap(options.tap), parse_device(options.device)
    if tap.kind not in LIVE_TAPS + PACED_TAPS:
        raise NotFoundError(
            f"tap {str(tap)!r}: `cushion run` listens to default, sink:NAME, file:PATH, "
            "capture:DIR or scene:demo in this version"
        )
    if device.kind not in LIVE_DEVICES + PACED_DEVICES:
        raise NotFoundError(
            f"device {str(device)!r}: `cushion run` plays to sink:NAME, usb:VID:PID, wav:FILE or "
            "twin in this version; `cushion devices` lists what the sound server has"
        )
    _refuse_overwriting(tap, device)
    offset_s = options.offset_ms * 1e-3
    if not 0.0 <= offset_s <= 1.0:
        raise UsageError(f"offset-ms={options.offset_ms:g} is out of range; allowed: 0 to 1000 ms")
    settings = _settings(options)
    if not options.debug:
        quiet_libraries()
    holder = Holder(os.getpid(), datetime.now().isoformat(" ", "seconds"), str(device))
    clocks = Clocks(time.monotonic, time.thread_time, _slept_s)
    with (
        RuntimeFolder(os.environ, create=True) as folder,
        DaemonLock(folder, holder),
        Wake() as wake,
        asked_to_end(wake) as ending,
    ):
        recording = None
        if options.record is not None:
            recording = RunRecording(options.record, settings, str(tap), str(device))
        supervisor = Supervisor(Order(tap, device, settings, offset_s, recording), clocks, wake)
        with recording or nullcontext():
            ended_well = False
            try:
                if not options.wait:
                    supervisor.look()
                if recording:
                    recording.begin()
                with StatusServer(
                    folder, lambda: status_of(supervisor, time.monotonic()), time.monotonic
                ):
                    _keep_on(supervisor, options.seconds, wake, ending)
                ended_well = True
            except KeyboardInterrupt:
                ended_well = True
                raise
            finally:
                supervisor.close(time.monotonic(), keep=ended_well)
    return 0


def _refuse_overwriting(tap: TapAddress, device: DeviceAddress) -> None:
    """Raise UsageError where the file to write is one to play."""
    if device.kind == "wav":
        played = {"file": [Path(tap.name)], "capture": capture_files(Path(tap.name))}
        for source in played.get(tap.kind, []):
            refuse_same_file(source, Path(device.name), None)


def _settings(options: argparse.Namespace) -> Settings:
    path = options.config or config.default_path()
    settings = config.load(path) if options.config or path.exists() else Settings()
    return dataclasses.replace(settings, profile=options.profile) if options.profile else settings


@contextmanager
def asked_to_end(wake: Wake) -> Iterator[list[int]]:
    """Signals that ask for the end, as they come: none breaks into an opening or a closing."""
    signals: list[int] = []

    def take(number: int, _: object) -> None:
        signals.append(number)
        wake.ring()

    before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield signals
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _keep_on(supervisor: Supervisor, seconds: float, wake: Wake, ending: Sequence[int]) -> None:
    """Tick until enough was heard or a signal came; tell systemd and the user what goes on."""
    notifier = Notifier()
    watchdog = Watchdog(watchdog_period_s(os.getpid()))
    told = warned = ""
    notifier.ready()
    while supervisor.heard_s < seconds and not supervisor.ended:
        if ending:
            raise KeyboardInterrupt
        now_s = time.monotonic()
        supervisor.tick(now_s)
        report = supervisor.states.report(now_s)
        text = f"{report.state.value}{': ' if report.reason else ''}{report.reason}"
        if text != told:
            told = text
            notifier.status(text)
            print(f"cushion: {text}", file=sys.stderr, flush=True)
        if supervisor.trouble != warned:
            warned = supervisor.trouble
            warn(warned)
        if watchdog.due(supervisor.heard_buffers, report.state, now_s):
            notifier.watchdog()
        wake.wait(min(supervisor.rest_s, watchdog.check_s or supervisor.rest_s))
    notifier.stopping()
    for warning in supervisor.warnings:
        if warning != warned:
            warn(warning)
    if supervisor.summary:
        print(supervisor.summary)


def _slept_s() -> float:
    """For how long this machine has slept since it was started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()
