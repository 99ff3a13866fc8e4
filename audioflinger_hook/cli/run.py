"""`cushion run`: plays this computer's sound as vibration until stopped."""

import argparse
import dataclasses
import os
import time
from collections.abc import Callable
from contextlib import nullcontext, suppress
from datetime import datetime
from pathlib import Path

from audioflinger_hook.cli.arguments import given_values
from audioflinger_hook.cli.process import Signals, allow_open_files, freeze_loaded_objects
from audioflinger_hook.cli.replay import capture_files
from audioflinger_hook.cli.run_reporter import RunReporter
from audioflinger_hook.config import file as config
from audioflinger_hook.config.edits import Edits, LiveEdits
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.live_control import LiveControl
from audioflinger_hook.daemon.offset_store import OffsetStore
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.run_config import LIVE_TAPS, PACED_TAPS, Change, RunConfig, words_of
from audioflinger_hook.daemon.safety_keeper import Moment, SafetyKeeper
from audioflinger_hook.daemon.status_report import status_of
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.timing import Wake
from audioflinger_hook.offline.render import refuse_same_file
from audioflinger_hook.service.install import state_folder
from audioflinger_hook.service.runtime_folder import DaemonLock, Holder, RuntimeFolder
from audioflinger_hook.service.status_server import StatusServer
from audioflinger_hook.service.systemd import Watchdog, watchdog_period_s
from audioflinger_hook.sources import parse_tap
from device.address import parse_device
from device.errors import LostError, NotFoundError, UsageError
from device.server import PulseConnection
from device.stream import filter_stderr

# Options that override keys of the config.
OF_SETTINGS = ("profile", "rig", "damping", "protection", "model", "tolerance")
OF_LIVE = ("tap", "device", "offset_ms", "drop_in", "engine", "device_volume_db")


def run(options: argparse.Namespace) -> int:
    """Run for `--seconds`, or until the sound ends or a signal arrives."""
    allow_open_files()
    run_config = _run_config(options)
    if not options.debug:
        filter_stderr()
    holder = Holder(os.getpid(), datetime.now().isoformat(" ", "seconds"), str(run_config.device))
    clocks = Clocks(time.monotonic, time.thread_time, _slept_s)
    with (
        RuntimeFolder(os.environ, create=True) as folder,
        DaemonLock(folder, holder) as lock,
        Wake() as wake,
        Signals(wake) as signals,
    ):
        recording = None
        if options.record is not None:
            addresses = str(run_config.tap), str(run_config.device)
            recording = RunRecording(options.record, run_config.settings, *addresses)
            run_config = dataclasses.replace(run_config, recording=recording)
        safety = SafetyKeeper(_state_folder(run_config.device_is_live), _present_moment)
        offsets = OffsetStore(_state_folder(run_config.tap_is_live and run_config.device_is_live))
        supervisor = Supervisor(run_config, clocks, wake, folder.path, safety, offsets)
        signals.on_spinning = supervisor.priority.revoke
        edits = LiveEdits(options.config or config.default_path())

        def follow(values: Edits, muted: bool) -> tuple[RunConfig, set[Change]]:
            """Read the config file again, and apply it with the edits `values`."""
            again = _run_config(options, values)
            again = dataclasses.replace(again, recording=recording, muted=muted)
            changes = supervisor.follow(again, time.monotonic())
            lock.write(dataclasses.replace(holder, device=str(again.device)))
            return again, changes

        def follow_edits(values: Edits, muted: bool) -> RunConfig:
            """Apply edits from the live page. If `muted` changes, nothing else is applied."""
            if muted == supervisor.config.muted:
                return follow(values, muted)[0]
            again = dataclasses.replace(supervisor.user_config, muted=muted)
            supervisor.follow(again, time.monotonic())
            return again

        def follow_config() -> str:
            """Read the config file again, apply it, and return the changes as text."""
            again, changes = follow(edits.values, supervisor.config.muted)
            control.reloaded(again)
            return words_of(changes)

        control = LiveControl(supervisor, edits, follow_edits, wake.ring, run_config)

        with recording or nullcontext():
            ended_well = False
            try:
                if not options.wait:
                    supervisor.look()
                if recording:
                    recording.begin()
                with StatusServer(
                    folder, lambda: status_of(supervisor, time.monotonic()), time.monotonic, control
                ):
                    _keep_on(supervisor, control, options.seconds, wake, signals, follow_config)
                ended_well = True
            except KeyboardInterrupt:
                ended_well = True
                raise
            finally:
                control.close()
                supervisor.close(time.monotonic(), keep=ended_well)
    return 0


def _state_folder(is_used: bool) -> Path | None:
    if is_used:
        with suppress(UsageError):
            return state_folder()
    return None


def _run_config(options: argparse.Namespace, edits: Edits | None = None) -> RunConfig:
    """Return the run's configuration; options override the config file, edits override both."""
    path = options.config or config.default_path()
    edits = edits or {}
    device = str(parse_device(options.device)) if options.device else ""
    if options.config or path.exists() or edits:
        found = config.load(path, options.default_profile, edits or None, device)
    else:
        found = config.Config(Settings(profile=options.default_profile))
    settings = found.settings.choosing(
        **given_values(options, [name for name in OF_SETTINGS if name not in edits])
    )
    given = given_values(options, [name for name in OF_LIVE if name not in edits])
    if "tap" in given:
        given["tap"] = tuple(str(parse_tap(text)) for text in given["tap"])
    if "device" in given:
        given["device"] = device
    live = dataclasses.replace(found.live, **given)
    if live.device is None:
        raise UsageError(
            "no device to play the vibration to; `cushion devices` lists them: name one with "
            f"--device, or with the key device in {path}"
        )
    run_config = RunConfig(parse_tap(live.tap[0]), parse_device(live.device), settings, live)
    if run_config.device.kind == "usb" and not run_config.tap_is_live:
        past_server = True
        with suppress(LostError):
            PulseConnection().close()
            past_server = False
        run_config = dataclasses.replace(run_config, past_server=past_server)
    _check_config(run_config)
    return run_config


def _check_config(run_config: RunConfig) -> None:
    tap, device = run_config.tap, run_config.device
    if tap.kind not in LIVE_TAPS + PACED_TAPS:
        raise NotFoundError(f"tap {str(tap)!r}: `cushion run` cannot listen to it")
    _ = run_config.rules
    numbered = run_config.device_is_a_card or not run_config.device_is_live
    if run_config.settings.actuators and numbered:
        # The property raises an error if an actuator names a channel; only sinks name channels.
        _ = run_config.settings.numbered_channels
    if run_config.live.drop_in and tap.kind not in ("default", "app"):
        raise UsageError(
            f"tap {str(tap)!r}: drop-in mode forwards to the default sink; the tap "
            "must be default or app:NAME"
        )
    if device.kind == "wav":
        played = {"file": [Path(tap.name)], "capture": capture_files(Path(tap.name))}
        for source in played.get(tap.kind, []):
            refuse_same_file(source, Path(device.name), None)


def _keep_on(
    supervisor: Supervisor,
    control: LiveControl,
    seconds: float,
    wake: Wake,
    signals: Signals,
    follow_config: Callable[[], str],
) -> None:
    """Run for `seconds`, or until the sound ends or a signal arrives. Print events."""
    reporter = RunReporter()
    watchdog = Watchdog(watchdog_period_s(os.getpid()))
    reporter.begin(*(address for address, _ in supervisor.endpoints))
    freeze_loaded_objects()
    try:
        while not supervisor.input.ended:
            if signals.end:
                raise KeyboardInterrupt
            now_s = time.monotonic()
            if supervisor.played_s(now_s) >= seconds:
                break
            if signals.reload:
                signals.reload = False
                supervisor.config_error = reporter.reload(follow_config, now_s)
            control.work(now_s)
            supervisor.tick(now_s)
            report = supervisor.states.report(now_s)
            reporter.tell_engine(*supervisor.engines.playing)
            reporter.tell_page(control.page)
            notes, warnings = supervisor.states.notes(), _warnings(supervisor)
            reporter.report(report, notes, warnings, now_s)
            reporter.show_meter(lambda: status_of(supervisor, time.monotonic()), now_s)
            if watchdog.due(supervisor.engines.counts[1], report.state, now_s):
                reporter.notifier.send("WATCHDOG=1")
            rest_s = min(supervisor.rest_s, control.rest_s(now_s))
            wake.wait(min(rest_s, watchdog.check_s or rest_s))
    finally:
        reporter.end(_warnings(supervisor))
    if supervisor.output.summary:
        print(supervisor.output.summary)


def _warnings(supervisor: Supervisor) -> list[str]:
    engine = supervisor.engines.python
    return [*(engine.framework.bypass_warnings() if engine else ()), *supervisor.warnings]


def _present_moment() -> Moment:
    """Return the time since boot and the time of day; `boot`, the boot's ID, is "" if unknown."""
    boot = ""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    local = datetime.now().astimezone().isoformat(timespec="minutes")
    return Moment(boot, time.clock_gettime(time.CLOCK_BOOTTIME), time.time(), local)


def _slept_s() -> float:
    """Return the total time in seconds that this machine was suspended since boot."""
    return time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()
