"""The form of a finding."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """Something that is wrong.

    name: of the rule. wrong: what is wrong, in one sentence with the value. advice: what to do.
    command: to type, "" for none. repair: name of the repair of `--fix`, "" for none.
    """

    name: str
    wrong: str
    advice: str
    command: str = ""
    repair: str = ""
