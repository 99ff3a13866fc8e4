"""Reads all facts of a set-up, within about a quarter of a minute even if nothing answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from audioflinger_hook.config.file import Config, default_path
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.daemon.run_config import SERVER_DEVICES
from audioflinger_hook.doctor.facts import ConfigFacts, DaemonFacts, Facts
from audioflinger_hook.doctor.machine import read_daemon, read_folders, read_plugin, read_system
from audioflinger_hook.doctor.servers import read_server
from audioflinger_hook.sources import parse_tap
from device.address import parse_device
from device.errors import CushionError
from device.server import ServerSnapshot

FindMistakes = Callable[[Path], tuple[Config | None, list[str], list[Mistake]]]


def gather(
    environ: Mapping[str, str], clock: Callable[[], float], find_mistakes: FindMistakes
) -> Facts:
    """Return all facts, except the measured delay. Only the main thread may call it.

    clock: returns seconds. find_mistakes: returns settings, warnings and mistakes of a config file.
    """
    server, snapshot = read_server(environ)
    config = _read_config(find_mistakes, snapshot)
    daemon = read_daemon(clock, environ)
    heard, felt = _sinks(config, daemon, snapshot)
    folders, plugin = read_folders(environ), read_plugin(environ)
    return Facts(read_system(), server, config, folders, plugin, daemon, heard, felt)


def _read_config(find_mistakes: FindMistakes, snapshot: ServerSnapshot | None) -> ConfigFacts:
    path = default_path()
    if not path.exists():
        return ConfigFacts(str(path))
    try:
        found, warnings, mistakes = find_mistakes(path)
    except CushionError as error:
        return ConfigFacts(str(path), exists=True, error=str(error))
    known = ConfigFacts(str(path), True, mistakes=tuple(mistakes), warnings=tuple(warnings))
    if found is None:
        return known
    live, device_error, is_on_server = found.live, "", True
    if live.device:
        address = parse_device(live.device)
        is_on_server = address.kind in SERVER_DEVICES
        if snapshot is not None and is_on_server:
            try:
                address.sink(snapshot)
            except CushionError as error:
                device_error = str(error)
    return replace(
        known,
        tap=live.tap[0],
        device=live.device or "",
        engine=live.engine,
        device_error=device_error,
        is_on_server=is_on_server,
    )


def _sinks(
    config: ConfigFacts, daemon: DaemonFacts, snapshot: ServerSnapshot | None
) -> tuple[str, str]:
    """Return the names of the sinks of sound and vibration: the daemon's, else the config's."""
    if snapshot is None:
        return "", ""
    tap, device = config.tap, config.device
    if daemon.status is not None:
        tap, device = daemon.status.tap.address, daemon.status.device.address
    heard, felt = snapshot.default_sink, ""
    with suppress(CushionError):
        address = parse_tap(tap)
        heard = address.name if address.kind == "sink" else heard
    with suppress(CushionError):
        felt = parse_device(device).sink(snapshot).name
    return heard, felt
