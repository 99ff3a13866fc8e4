"""Repairs that need no root. Each returns a sentence about its result."""

import os
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.doctor.facts import Facts
from audioflinger_hook.plugin.install import RATES_HZ, Places, install
from audioflinger_hook.service.runtime_folder import LOCK_NAME, DaemonLock, Holder, RuntimeFolder
from device.atomic_file import make_private_folder
from device.errors import CushionError
from device.server import PulseConnection
from device.server.identity import find_sink


def repair(name: str, facts: Facts, environ: Mapping[str, str]) -> str:
    """Repair the finding `name`; return the result in words. Only the main thread may call it."""
    try:
        return REPAIRS[name](facts, environ)
    except (CushionError, OSError) as error:
        return f"{name} was not repaired: {error}."


def unmute(facts: Facts, environ: Mapping[str, str]) -> str:
    """Unmute the output of the vibration at its present volume.

    The output stays muted while a stream plays to it, or if its volume is above 100 %: a person
    might feel a sudden strong vibration. If the volume then is higher than before, mute it again.
    """
    with closing(PulseConnection()) as connection:
        if (before := replace(facts, server=connection.latest).felt) is None:
            return "The output of the vibration is gone."
        muted = f"{before.name!r} stays muted, because"
        if connection.latest.playing_to(before.name):
            return f"{muted} a stream plays to it now; pause it first."
        if before.volume_db > 0.0:
            return f"{muted} its volume is above 100 %; lower it first."
        connection.set_sink_mute(before.name, False)
        after = find_sink(connection.snapshot(), before.name)
        if after.volume_db > before.volume_db + 0.01:  # less is the server's rounding
            connection.set_sink_mute(before.name, True)
            return f"{muted} unmuting raised its volume."
    return f"{before.name!r} was unmuted; its volume is still {before.volume_db:.1f} dB."


def remove_lock(facts: Facts, environ: Mapping[str, str]) -> str:
    """Remove the lock file of a daemon that no longer exists. UsageError: a daemon holds it."""
    with RuntimeFolder(environ, create=False) as folder:
        with DaemonLock(folder, Holder(os.getpid(), "", "")):
            os.unlink(LOCK_NAME, dir_fd=folder.fd)
        return f"{folder.path / LOCK_NAME} was removed."


def install_plugin(facts: Facts, environ: Mapping[str, str]) -> str:
    """Install the plugin; a configuration that refers to it is not changed."""
    places = Places(environ)
    install(places, LIVE_DEFAULT, None, RATES_HZ)
    return f"{places.plugin} was installed."


def make_folders(facts: Facts, environ: Mapping[str, str]) -> str:
    """Make the missing folders, accessible to this user only."""
    paths = [Path(folder.path) for folder in facts.folders if folder.problem]
    missing = [path for path in paths if path.is_absolute() and not path.exists()]
    for path in missing:
        make_private_folder(path)
    return f"{', '.join(map(str, missing)) or 'No folder'} was made."


# {name of the finding: its repair}
REPAIRS: Mapping[str, Callable[[Facts, Mapping[str, str]], str]] = {
    "device-muted": unmute,
    "stale-lock": remove_lock,
    "plugin-copy": install_plugin,
    "folder": make_folders,
}
