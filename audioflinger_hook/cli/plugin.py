"""`cushion plugin`: installs the effect as a plugin of PipeWire and other audio software."""

import argparse
import os
import sys

from audioflinger_hook.plugin import install as plugin


def run(options: argparse.Namespace) -> int:
    """Print the plugin's path, or install or remove the plugin for this user."""
    places = plugin.Places(os.environ)
    if options.does == "path":
        print(places.plugin if places.plugin.is_file() else plugin.built_plugin())
    elif options.does == "remove":
        for path in plugin.remove(places):
            print(f"{path}: removed")
    else:
        rates_hz = sorted({*plugin.RATES_HZ, *([options.rate] if options.rate else [])})
        plugin.install(places, options.profile, options.device, tuple(rates_hz))
        print(f"{places.plugin}: written, for {', '.join(map(str, rates_hz))} Hz")
        print(f"{places.bundle}: written")
        if options.device:
            print(f"{places.chain}: written")
            print(
                "to load it now, or at every login, type:", *plugin.LOADING_COMMANDS, sep="\n    "
            )
            print("to remove it: cushion plugin remove")
    sys.stdout.flush()
    return 0
