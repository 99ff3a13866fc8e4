"""Foreign text as one line for a terminal. Pure; any thread may call."""

from __future__ import annotations

SHOWN_MAX = 200  # largest length of a foreign text, such as a reason or a name


def one_line(text: str, limit: int = SHOWN_MAX) -> str:
    """Return the text in one line of at most `limit` characters, `?` for what is unprintable."""
    # Cut first, so that the cost does not depend on the length.
    words = " ".join(text[: 4 * limit].split())
    shown = "".join(sign if sign.isprintable() else "?" for sign in words)
    return shown if len(shown) <= limit else shown[: limit - 1] + "…"
