"""Questions to whoever sits at the terminal."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable, Mapping, Sequence

from device.errors import CushionError

CHECK_S = 0.1


def choose(
    question: str,
    answers: Mapping[str, str],
    default: str = "",
    meanwhile: Callable[[], None] | None = None,
) -> str:
    """Ask until one of the answers is given, and return it.

    answers: what may be typed, with its meaning; a first letter stands for its word. default: the
    answer to an empty line, "" for none. meanwhile: called again and again until a line is typed;
    what it raises ends the question.
    KeyboardInterrupt: the terminal was closed, or Ctrl+D typed.
    """
    words = {answer[0]: answer for answer in answers} | {answer: answer for answer in answers}
    prompt = f"{question} [{default}] " if default else f"{question} "
    while True:
        given = _read(prompt, meanwhile).strip().lower() or default
        if given in words:
            return words[given]
        if given not in ("", "?"):
            print(f"{given[:60]!r} is no answer.")
        print("Please type one of these:")
        for answer, meaning in answers.items():
            print(f"  {answer}: {meaning}")


def agree(question: str, *, default: bool) -> bool:
    """Ask for yes or no. KeyboardInterrupt: as for `choose`."""
    answers = {"yes": "do it", "no": "leave it"}
    return choose(question, answers, "yes" if default else "no") == "yes"


def pick(question: str, items: Sequence[str], default: int | None) -> int:
    """List items, and return the index of the one that is chosen by its number.

    default: index of the answer to an empty line. KeyboardInterrupt: as for `choose`.
    """
    for number, item in enumerate(items, 1):
        print(f"  {number}  {item}")
    answers = {str(number): item for number, item in enumerate(items, 1)}
    return int(choose(question, answers, "" if default is None else str(default + 1))) - 1


def name_some(question: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return some of the names, in the order given; empty for all. They are split at commas.

    KeyboardInterrupt: as for `choose`.
    """
    while True:
        given = _read(f"{question} [all] ").strip()
        if given in ("", "all"):
            return ()
        chosen = tuple(name.strip() for name in given.split(","))
        if set(chosen) <= set(names) and len(set(chosen)) == len(chosen):
            return chosen
        print(f"Please type all, or some of: {', '.join(names)}.")


def _read(prompt: str, meanwhile: Callable[[], None] | None = None) -> str:
    # `input` would print it through C's stderr, which a command with audio streams silences.
    print(prompt, end="", flush=True)
    try:
        while not select.select([sys.stdin], [], [], CHECK_S)[0]:
            if meanwhile:
                meanwhile()
        return input()
    except EOFError:
        print()
        sys.stdout.flush()
        raise KeyboardInterrupt from None
    except CushionError:
        print(flush=True)
        raise
