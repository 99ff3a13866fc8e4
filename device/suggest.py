"""Suggestions for an unknown name: the nearest names, or all known ones."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


def no_such(kind: str, name: str, names: Iterable[str], where_none: str) -> str:
    """The text of an error, one line. where_none: what to do if there is nothing of that kind.

    kind: as in "sink"; name: what was asked for; names: what there is. Any thread.
    """
    known = sorted(names)
    nearest = get_close_matches(name, known, n=3, cutoff=0.5)
    if nearest:
        offer = f"did you mean {' or '.join(repr(near) for near in nearest)}?"
    elif known:
        offer = f"there are {', '.join(repr(one) for one in known[:8])}"
        offer += " and others" if len(known) > 8 else ""
    else:
        offer = f"there is none at all: {where_none}"
    return f"there is no {kind} {name!r}; {offer}"


def nearest(name: str, names: Iterable[str]) -> str:
    """The known name that is most like another, "" if none is."""
    return next(iter(get_close_matches(name, list(names), n=1)), "")
