"""Text from elsewhere, made fit for one line on a terminal. Pure; any thread may call."""

from __future__ import annotations

SHOWN_MAX = 200
"""Characters kept of a text from elsewhere: a reason, a name."""


def one_line(text: str, limit: int = SHOWN_MAX) -> str:
    """Return the text with every run of white space as one space, cut to `limit` characters.

    What is not printable (escape sequences, marks that turn the writing direction) becomes `?`.
    """
    # Cut before the work, so that a text of any length costs the same.
    words = " ".join(text[: 4 * limit].split())
    shown = "".join(sign if sign.isprintable() else "?" for sign in words)
    return shown if len(shown) <= limit else shown[: limit - 1] + "…"
