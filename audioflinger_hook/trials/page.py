"""Asks a person questions on a page: `/trial` of the live page's server, in this process."""

from dataclasses import dataclass
from enum import Enum
from typing import Protocol


class Kind(Enum):
    """What a question shows."""

    CHOICE = "choice"  # large buttons with keys: fit, preference, simultaneity, order
    SLIDER = "slider"  # 0 to 100, for ratings
    ONE_OF = "one of"  # one of many buttons, for identification
    TEXT = "text"  # text to read, with buttons below: consent, instructions, pause, the end
    PLAYING = "playing"  # no answer: what plays now; `PageAnswers.show` shows it


@dataclass(frozen=True)
class Choice:
    """A button. value: the answer. label: text on it. key: key that presses it, such as "1"."""

    value: str
    label: str
    key: str = ""


FIRST, SECOND = Choice("1", "First", "1"), Choice("2", "Second", "2")
AGAIN, UNKNOWN = Choice("again", "Again", "a"), Choice("unknown", "Don't know", "d")
"""The usual choices; AGAIN and UNKNOWN are drawn smaller, as `Question.also`."""


@dataclass(frozen=True)
class Question:
    """One screen of the page.

    title: one line. text: paragraphs, plain text. choices: large buttons. also: smaller ones below.
    labels: texts at the slider's ends and middle. done, total: trials for the progress bar; total 0
    hides it. practice: whether to say that this is practice. can_pause: whether to offer a pause.
    """

    kind: Kind
    title: str
    text: tuple[str, ...] = ()
    choices: tuple[Choice, ...] = ()
    also: tuple[Choice, ...] = ()
    labels: tuple[str, ...] = ()
    done: int = 0
    total: int = 0
    practice: bool = False
    can_pause: bool = True


@dataclass(frozen=True)
class Answer:
    """A person's answer. value: `Choice.value`, or 0 to 100 of a slider.

    after_s: time from the screen's first drawing to the answer, by the page's clock, without
    pauses. pauses: number of pauses meanwhile.
    """

    value: str | float
    after_s: float
    pauses: int = 0


class Answers(Protocol):
    """Asks on a page, or wherever else. `PageAnswers` is the page; a simulation gives its own.

    If the person presses Stop, or closes the page, `on_stop` is called at once, in another thread:
    give `Player.stop`.
    """

    def show(self, question: Question) -> None:
        """Show a screen without an answer, such as Kind.PLAYING; return at once."""
        ...

    def ask(self, question: Question) -> Answer:
        """Show a question; return its answer. A pause does not end the question.

        StoppedError: the person pressed Stop and confirmed it. LostError: the page was closed, and
        not opened again within RETURN_S. In both cases, what was recorded is valid; end the
        session, and say how to continue.
        """
        ...
