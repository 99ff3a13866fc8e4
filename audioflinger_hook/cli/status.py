"""`cushion status`: the status of a running daemon."""

from __future__ import annotations

import argparse
import time

from audioflinger_hook.cli.terminal import LineConsole
from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.status_client import ask_status
from audioflinger_hook.service.status_view import status_view

ANSWER_S = 2.0
REFRESH_S = 0.5


def run(options: argparse.Namespace) -> int:
    """Print the status once, or repeatedly."""
    if options.watch and not options.json:
        return _watch()
    status = ask_status(ANSWER_S, time.monotonic)
    if options.json:
        print(to_json(status))
    else:
        LineConsole().print(status_view(status))
    return 0


def _watch() -> int:
    from rich.live import Live

    with Live(status_view(ask_status(ANSWER_S, time.monotonic)), auto_refresh=False) as live:
        while True:
            time.sleep(REFRESH_S)
            live.update(status_view(ask_status(ANSWER_S, time.monotonic)), refresh=True)
