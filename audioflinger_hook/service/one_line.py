"""Conversion of untrusted text to one line for a terminal."""

SHOWN_MAX = 200  # default limit in characters


def one_line(text: str, limit: int = SHOWN_MAX) -> str:
    """Return one line of at most `limit` characters, with `?` for unprintable characters."""
    # Cut the text first, so that the computing time is limited.
    words = " ".join(text[: 4 * limit].split())
    shown = "".join(sign if sign.isprintable() else "?" for sign in words)
    return shown if len(shown) <= limit else shown[: limit - 1] + "…"
