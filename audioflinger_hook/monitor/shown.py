"""What the page shows of a status: rows, and parts of the delay, from the table of figures."""

from __future__ import annotations

from typing import Any

from audioflinger_hook import __version__
from audioflinger_hook.service.figure import Row, label_of, table
from audioflinger_hook.service.json_codec import from_document
from audioflinger_hook.service.status import LatencyBudget, Status, status_rows
from device.errors import UsageError

OTHER = "The page shows figures of a daemon of its own version only."

TONES = ("bad", "wait", "good")  # the first that a piece of a row has is the row's


def figures_of(document: dict[str, Any]) -> dict[str, Any]:
    """Return `{"panels": {panel: [[label, text, tone, meaning]]}, "parts": [[name, ms, meaning]]}`.

    Of a daemon of another version, only that.
    """
    try:
        status = from_document(Status, document)
    except UsageError:
        versions = f"daemon {document['version']}, page {__version__}"
        text = f"{versions}: restart the older one"
        return {"panels": {"health": [["version", text, "bad", OTHER]], "rig": []}, "parts": []}
    panels: dict[str, list[Any]] = {"health": [], "rig": []}
    for row in status_rows(status):
        if row.panel:
            panels[row.panel].append([row.label.strip(), _text(row), _tone(row), row.help])
    parts = [
        [label_of(name, known), getattr(status.latency, name), known.help]
        for name, known, _ in table(LatencyBudget)
        if name != "total_ms"
    ]
    return {"panels": panels, "parts": parts}


def _text(row: Row) -> str:
    """Return a row's text; that of a rig has a line for each figure."""
    if row.panel != "rig":
        return str(row)
    return "".join(text.replace(", ", "\n", text.startswith(", ")) for text, _ in row.parts)


def _tone(row: Row) -> str:
    tones = {piece.tone for piece in row.pieces}
    return next((tone for tone in TONES if tone in tones), "")
