"""`cushion plugin`: installs the effect as a plugin of PipeWire and other audio software."""

import argparse
import os
import sys

from audioflinger_hook.config import fits
from audioflinger_hook.plugin.install import (
    LOADING_COMMANDS,
    RATES_HZ,
    Places,
    built_plugin,
    install,
    remove,
)


def run(options: argparse.Namespace) -> int:
    """Print the plugin's path, or install or remove the plugin for this user."""
    places = Places.of(os.environ)
    if options.does == "path":
        print(places.plugin if places.plugin.is_file() else built_plugin())
    elif options.does == "remove":
        for path in remove(places):
            print(f"{path}: removed")
    else:
        rates_hz = (*RATES_HZ, options.rate) if options.rate else RATES_HZ
        curve = fits.read(options.fit).curve if options.fit else ""
        install(places, options.profile, options.device, tuple(sorted(set(rates_hz))), curve)
        print(f"{places.plugin}: written, for {', '.join(map(str, sorted(set(rates_hz))))} Hz")
        print(f"{places.bundle}: written")
        if options.device:
            print(f"{places.chain}: written")
            print("to load it now, or at every login, type:", *LOADING_COMMANDS, sep="\n    ")
            print("to remove it: cushion plugin remove")
    sys.stdout.flush()
    return 0
