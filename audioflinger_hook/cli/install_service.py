"""`cushion install-service`: installs a systemd user unit that starts the daemon at login."""

import argparse
import sys

from audioflinger_hook.config import file as config
from audioflinger_hook.service import autostart
from audioflinger_hook.service.install import UDEV_COMMAND, install, restore, systemd_version
from audioflinger_hook.sources import parse_tap
from device.address import parse_device
from device.errors import UsageError


def run(options: argparse.Namespace) -> int:
    """Write or remove the unit, and print the commands that the user must run next."""
    if options.udev and options.device is None and not config.names_a_device():
        _print_udev()
        return 0
    if options.remove:
        autostart.set_on(False)
        done = restore(None)
        print(f"{done.path}: {'removed' if done.changed else 'was not installed'}")
    else:
        arguments = ["--wait"]
        if options.device is not None:
            arguments += ["--device", str(parse_device(options.device))]
        elif not config.names_a_device():
            raise UsageError(
                "no device given; name it with --device, or with the key device in "
                f"{config.default_path()}; `cushion devices` lists them"
            )
        if options.tap is not None:
            arguments += ["--tap", str(parse_tap(options.tap))]
        done = install(arguments, systemd=systemd_version())
        print(f"{done.path}: {'written' if done.changed else 'is up to date'}")
    if done.commands:
        print("next, type:", *done.commands, sep="\n    ")
    if options.udev:
        _print_udev()
    sys.stdout.flush()
    return 0


def _print_udev() -> None:
    print("to let this user control USB sound devices, type as root:")
    print(UDEV_COMMAND)
