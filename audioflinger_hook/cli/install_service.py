"""`cushion install-service`: a systemd user unit that runs the daemon from every login on."""

from __future__ import annotations

import argparse
import sys

from audioflinger_hook.clients import parse_tap
from audioflinger_hook.service.install import install, remove
from audioflinger_hook.service.udev import udev_command, udev_rule
from device.address import parse_device
from device.errors import UsageError


def run(options: argparse.Namespace) -> int:
    """Write the unit, or take it away, and print what to type next."""
    if options.remove:
        done = remove()
        print(f"{done.path}: {'removed' if done.changed else 'was not there'}")
    else:
        if options.device is None:
            raise UsageError("no device given; name it with --device, see `cushion devices`")
        arguments = ["--wait", "--device", str(parse_device(options.device))]
        if options.tap != "default":
            arguments += ["--tap", str(parse_tap(options.tap))]
        done = install(arguments)
        print(f"{done.path}: {'written' if done.changed else 'is as it should be'}")
    print("next, type:")
    for command in done.commands:
        print(f"    {command}")
    if options.udev:
        print("so that this user may control USB sound devices, as root:")
        print(udev_command(udev_rule()))
    sys.stdout.flush()
    return 0
