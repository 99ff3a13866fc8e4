"""`cushion status`: shows the status of a running daemon."""

import argparse
import time

from rich.table import Table
from rich.text import Text

from audioflinger_hook.cli.terminal import LineConsole
from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.shown import BAR_CELLS, bar
from audioflinger_hook.service.status import Status, status_rows
from audioflinger_hook.service.status_client import ask_status

ANSWER_S = 2.0
REFRESH_S, JSON_EVERY_S = 0.5, 1.0
STYLES = {"good": "green", "wait": "yellow", "bad": "red", "sound": "cyan", "felt": "yellow"}


def run(options: argparse.Namespace) -> int:
    """Print the status once, or repeatedly."""
    if options.watch and not options.json:
        return _watch()
    while True:
        status = ask_status(ANSWER_S, time.monotonic)
        if options.json:
            print(to_json(status), flush=True)
        else:
            LineConsole().print(status_view(status))
        if not options.watch:
            return 0
        time.sleep(JSON_EVERY_S)


def _watch() -> int:
    from rich.live import Live

    with Live(status_view(ask_status(ANSWER_S, time.monotonic)), auto_refresh=False) as live:
        while True:
            time.sleep(REFRESH_S)
            live.update(status_view(ask_status(ANSWER_S, time.monotonic)), refresh=True)


def status_view(status: Status) -> Table:
    """Return the status as a table of the package `rich`."""
    view = Table.grid(padding=(0, 1, 0, 0), expand=False)
    view.add_column(style="dim", overflow="fold", min_width=1)
    view.add_column(overflow="fold", min_width=1)
    for row in status_rows(status):
        pieces = ((text, STYLES.get(tone, "")) for text, tone in row.parts)
        view.add_row(Text(row.label), Text.assemble(*pieces))
    return view


def meter_line(status: Status, width: int) -> str:
    """Return a line with state, levels and strongest frequency, at most `width` characters long."""
    cells = max(4, min(BAR_CELLS, (width - 50) // 2))
    levels = status.levels
    words = [
        status.state.value + (", muted" if status.muted else ""),
        f"sound {bar(levels.sound, cells)}",
        f"felt {bar(levels.vibration, cells)}",
    ]
    if status.principal:
        strongest = max(status.principal, key=lambda one: one.amplitude)
        words.append(f"{strongest.audio_hz:.0f} → {strongest.vibration_hz:.0f} Hz")
    return "  ".join(words)[: max(0, width)]
