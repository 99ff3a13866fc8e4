"""`cushion run`: everything this computer plays, felt, until it is told to stop."""

from __future__ import annotations

import argparse
import dataclasses
import os
import time
from collections.abc import Callable
from contextlib import nullcontext
from datetime import datetime
from pathlib import Path

from audioflinger_hook.cli.check import load_config
from audioflinger_hook.cli.replay import capture_files
from audioflinger_hook.cli.run_reporter import RunReporter
from audioflinger_hook.cli.signals import Signals
from audioflinger_hook.config import file as config
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.gc_freeze import spare_what_is_there
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.run_config import LIVE_TAPS, PACED_TAPS, RunConfig
from audioflinger_hook.daemon.status_report import status_of
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.wake import Wake
from audioflinger_hook.offline.render import refuse_same_file
from audioflinger_hook.service.runtime_folder import DaemonLock, Holder, RuntimeFolder
from audioflinger_hook.service.status_server import StatusServer
from audioflinger_hook.service.systemd import Watchdog, watchdog_period_s
from audioflinger_hook.sources import TapAddress, parse_tap
from device.address import DeviceAddress, parse_device
from device.errors import LostError, NotFoundError, UsageError
from device.server import PulseConnection
from device.stream import filter_stderr


def run(options: argparse.Namespace) -> int:
    """Run until `--seconds` of sound are over, the sound ends or somebody ends it."""
    order = _order(options)
    if not options.debug:
        filter_stderr()
    holder = Holder(os.getpid(), datetime.now().isoformat(" ", "seconds"), str(order.device))
    clocks = Clocks(time.monotonic, time.thread_time, _slept_s)
    with (
        RuntimeFolder(os.environ, create=True) as folder,
        DaemonLock(folder, holder) as lock,
        Wake() as wake,
        Signals(wake) as signals,
    ):
        recording = None
        if options.record is not None:
            addresses = str(order.tap), str(order.device)
            recording = RunRecording(options.record, order.settings, *addresses)
            order = dataclasses.replace(order, recording=recording)
        supervisor = Supervisor(order, clocks, wake)
        signals.on_spinning = supervisor.priority.revoke

        def follow_config(now_s: float) -> str:
            """Read the config again, and return what it changed."""
            order = dataclasses.replace(_order(options), recording=recording)
            changes = supervisor.follow(order, now_s)
            lock.write(dataclasses.replace(holder, device=str(order.device)))
            return str(changes)

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
                    _keep_on(supervisor, options.seconds, wake, signals, follow_config)
                ended_well = True
            except KeyboardInterrupt:
                ended_well = True
                raise
            finally:
                supervisor.close(time.monotonic(), keep=ended_well)
    return 0


def _order(options: argparse.Namespace) -> RunConfig:
    """Return what the config asks for, and over it what the options do.

    Raises
    ------
    UsageError, NotFoundError
        One of them has a mistake, or asks for what there is not.
    """
    path = options.config or config.default_path()
    found = load_config(path) if options.config or path.exists() else config.Config()
    settings, live = found.settings, found.live
    chosen = {name: getattr(options, name) for name in ("profile", "rig", "damping", "protection")}
    settings = settings.choosing(**{name: c for name, c in chosen.items() if c})
    given = {
        "tap": tuple(str(parse_tap(text)) for text in options.tap) if options.tap else None,
        "device": options.device and str(parse_device(options.device)),
        "offset_ms": options.offset_ms,
        "drop_in": options.drop_in,
        "device_volume_db": options.device_volume_db,
    }
    live = dataclasses.replace(
        live, **{name: value for name, value in given.items() if value is not None}
    )
    if live.device is None:
        raise UsageError(
            "no device to play the vibration to; `cushion devices` lists them: name one with "
            f"--device, or with the key device in {path}"
        )
    order = RunConfig(parse_tap(live.tap[0]), parse_device(live.device), settings, live)
    if order.device.kind == "usb" and not order.tap_is_live:
        order = dataclasses.replace(order, past_server=not _server_answers())
    _refuse_what_is_not_there(order)
    _refuse_overwriting(order.tap, order.device)
    return order


def _server_answers() -> bool:
    try:
        PulseConnection().close()
    except LostError:
        return False
    return True


def _refuse_what_is_not_there(order: RunConfig) -> None:
    """Raise UsageError or NotFoundError for what cannot be done, or not by this version."""
    if order.tap.kind not in LIVE_TAPS + PACED_TAPS:
        raise NotFoundError(f"tap {str(order.tap)!r}: `cushion run` cannot listen to it")
    _ = order.rules
    if order.settings.actuators and (order.device_is_a_card or not order.device_is_live):
        _ = order.settings.numbered_channels  # raises: one goes by a name that only sinks have
    if order.live.drop_in and order.tap.kind not in ("default", "app"):
        raise UsageError(
            f"tap {str(order.tap)!r}: drop-in mode stands in front of the default sink; the tap "
            "has to be default or app:NAME"
        )


def _refuse_overwriting(tap: TapAddress, device: DeviceAddress) -> None:
    """Raise UsageError where the file to write is one to play."""
    if device.kind == "wav":
        played = {"file": [Path(tap.name)], "capture": capture_files(Path(tap.name))}
        for source in played.get(tap.kind, []):
            refuse_same_file(source, Path(device.name), None)


def _keep_on(
    supervisor: Supervisor,
    seconds: float,
    wake: Wake,
    signals: Signals,
    follow_config: Callable[[float], str],
) -> None:
    """Tick until enough was heard or a signal came; tell systemd and the user what goes on."""
    reporter = RunReporter()
    watchdog = Watchdog(watchdog_period_s(os.getpid()))
    reporter.begin(*(address for address, _ in supervisor.endpoints))
    spare_what_is_there()
    try:
        while supervisor.heard_s < seconds and not supervisor.ended:
            if signals.end:
                raise KeyboardInterrupt
            now_s = time.monotonic()
            if signals.reload:
                signals.reload = False
                supervisor.trouble = reporter.reload(follow_config, now_s)
            supervisor.tick(now_s)
            report = supervisor.states.report(now_s)
            reporter.tell(report, supervisor.states.notes(), supervisor.warnings, now_s)
            if watchdog.due(supervisor.heard_buffers, report.state, now_s):
                reporter.notifier.watchdog()
            wake.wait(min(supervisor.rest_s, watchdog.check_s or supervisor.rest_s))
    finally:
        reporter.end(supervisor.warnings)
    if supervisor.summary:
        print(supervisor.summary)


def _slept_s() -> float:
    """For how long this machine has slept since it was started."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()
