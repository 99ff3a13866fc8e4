"""The status as text, for a terminal of any width."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from audioflinger_hook.service.shown import BAR_CELLS, bar
from audioflinger_hook.service.status import Status, status_rows

STYLES = {"good": "green", "wait": "yellow", "bad": "red", "sound": "cyan", "felt": "yellow"}


def status_view(status: Status) -> Table:
    """Return the rows of the status as a table for rich; names are never taken for markup."""
    view = Table.grid(padding=(0, 1, 0, 0), expand=False)
    view.add_column(style="dim", overflow="fold", min_width=1)
    view.add_column(overflow="fold", min_width=1)
    for row in status_rows(status):
        pieces = ((text, STYLES.get(tone, "")) for text, tone in row.parts)
        view.add_row(Text(row.label), Text.assemble(*pieces))
    return view


def meter_line(status: Status, width: int) -> str:
    """Return state, levels and the strongest frequency in one line of at most `width` cells."""
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
