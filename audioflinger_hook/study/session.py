"""A participant who feels what the daemon plays, and answers on the page."""

from collections.abc import Iterator, Mapping
from typing import Any

from audioflinger_hook.study.stimuli import Stimuli
from audioflinger_hook.trials.page import AGAIN, Choice, Screen, screen
from audioflinger_hook.trials.person import Interval, Person

LABELS = {"1": "First", "2": "Second"}
PAUSE = "Take a pause. Go on when you are ready."
THANKS = "This was the last question. Thank you for taking part."


class Participant:
    """Plays trials to a person, and asks. total: number of the session's trials."""

    def __init__(self, person: Person, stimuli: Stimuli, total: int) -> None:
        self._person, self._stimuli, self._total = person, stimuli, total

    def agrees(self, consent: str) -> bool:
        """Ask for consent; return whether it is given."""
        choices = ("yes", "I agree", "1"), ("no", "I do not agree", "2")
        return self._read("Consent", consent, *choices) == "yes"

    def pause(self) -> None:
        """Show a pause until the person goes on."""
        self._read("Pause", PAUSE, ("on", "Go on", "1"))

    def thank(self) -> None:
        """Show that the session is over."""
        self._person.answers.show(screen("text", "The end", THANKS))

    def answer(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Play all intervals, as often as the person asks; return what was played and answered."""
        question, made = self._stimuli.design.questions[row["question"]], self._stimuli.of(row)
        about = {"done": row["trial"] - 1, "total": self._total, "practice": row["practice"]}
        choices = [
            (choice, LABELS.get(choice, choice.capitalize()), str(number))
            for number, choice in enumerate(row["choices"], 1)
        ]
        kind, title = question.kind["screen"], question.ask or question.kind["ask"]
        labels = question.kind.get("labels", ())
        asked = screen(kind, title, choices=choices, also=[AGAIN], labels=labels, **about)

        def intervals() -> Iterator[Interval]:
            for number, one in enumerate(made, 1):
                name = LABELS[str(number)] if len(made) > 1 else title
                yield one.sound, one.vibration, screen("playing", name, **about)

        played, answered = self._person.answer(intervals, asked)
        columns: dict[str, Any] = {}
        for number, (one, measured) in enumerate(zip(made, played, strict=True), 1):
            columns |= one.columns(number, measured)
        return columns | answered

    def _read(self, title: str, text: str, *choices: Choice) -> str | float:
        shown: Screen = screen("text", title, *text.strip().split("\n\n"), choices=choices)
        return self._person.answers.ask(shown).value
