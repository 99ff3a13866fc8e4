"""Checks whether the native engine can run a config on this machine."""

import re
import shutil
from pathlib import Path

from audioflinger_hook.core import library_path as plugin_path
from audioflinger_hook.core.structures import CHANNELS
from audioflinger_hook.daemon.native.layout import ACTUATORS
from audioflinger_hook.daemon.run_config import RunConfig
from device.errors import NotFoundError
from device.server import ServerSnapshot
from device.server.graph_watch import EDITOR, READER
from device.stream.pcms import missing_plugin

VERSION_MIN = (0, 3, 50)  # older versions of filter-chain have another syntax

FILTER_CHAIN = "libpipewire-module-filter-chain.so"
MODULE_FOLDERS = ("/usr/lib/*/pipewire-*", "/usr/lib/pipewire-*", "/usr/lib64/pipewire-*")


def check_engine(config: RunConfig, snapshot: ServerSnapshot | None) -> None:
    """Raise NotFoundError if the config's engine cannot run on this machine."""
    reason = why_python(config, snapshot)
    if reason and config.live.engine == "native":
        raise NotFoundError(f"engine = 'native' is impossible: {reason}; allowed: auto, python")
    if reason and config.needs_plugin and (missing := missing_plugin()):
        raise NotFoundError(f"the Python engine ({reason}) cannot play: {missing}")


def why_python(config: RunConfig, snapshot: ServerSnapshot | None) -> str:
    """Return why the native engine cannot run or is not chosen, or ""."""
    if config.live.engine == "python":
        return "engine = 'python'"
    if (reason := _refusal(config)) or snapshot is None:
        return reason or "there is no sound server"
    return missing_parts() or why_not_server(snapshot)


def missing_parts() -> str:
    """Return what the native engine lacks on this machine and how to get it, or ""."""
    if plugin_path() is None:
        return "the plugin is not built; run `make run` with a C compiler"
    for program in ("pipewire", READER, EDITOR):
        if shutil.which(program) is None:
            return f"the program {program} is missing; install pipewire and pipewire-bin"
    folders = [folder for pattern in MODULE_FOLDERS for folder in Path("/").glob(pattern[1:])]
    if folders and not any((folder / FILTER_CHAIN).exists() for folder in folders):
        return f"PipeWire's module {FILTER_CHAIN} is missing; install pipewire-bin"
    return ""


def why_not_server(snapshot: ServerSnapshot) -> str:
    """Return why the native engine cannot use this server, or ""."""
    if snapshot.kind != "PipeWire":
        return f"the sound server is {snapshot.kind}"
    found = re.match(r"(\d+)\.(\d+)\.(\d+)", snapshot.version)
    if found and tuple(map(int, found.groups())) < VERSION_MIN:
        least = ".".join(map(str, VERSION_MIN))
        return f"PipeWire {snapshot.version} is too old; {least} or newer is needed"
    return ""


def _refusal(config: RunConfig) -> str:
    settings, is_server = config.settings, config.device_is_live and not config.device_is_a_card
    reasons = (
        (not config.tap_is_live, f"the tap {config.tap} is not on the sound server"),
        (not is_server, f"the device {config.device} is not on the sound server"),
        (config.live.drop_in, "drop_in is on"),
        (config.recording is not None, "the run is recorded"),
        (settings.form != "live", f"transform = {settings.form!r}"),
        (settings.effects_file is not None, "effects_file is set"),
        (len(settings.actuators) > ACTUATORS, f"there are more than {ACTUATORS} actuators"),
    )
    return next((text for applies, text in reasons if applies), "")


def why_not_tap(channels: int) -> str:
    """Return why the native engine cannot tap this number of channels, or ""."""
    return "" if channels <= CHANNELS else f"the tap has {channels} channels, more than {CHANNELS}"
