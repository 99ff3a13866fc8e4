"""The packages that only some commands need, and how they are installed."""

from __future__ import annotations

DISTRIBUTION = "haptic-cushion"


def not_installed(package: str, extra: str) -> str:
    """Return the message of one line that a package is missing, and which extra brings it.

    package: its name. extra: of this distribution. Any thread.
    """
    return f'{package} is not installed; install it: pip install "{DISTRIBUTION}[{extra}]"'
