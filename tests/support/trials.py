"""What replaces a daemon and a page in tests of people: a player and answers without either."""

from collections.abc import Mapping
from typing import Any

from audioflinger_hook.service.status import ExposureFigures
from audioflinger_hook.trials.page import Answer, Screen
from audioflinger_hook.trials.person import Person
from audioflinger_hook.trials.player import Played

PLAYED = Played(1.0, 1.0, 0.5, False, -20.0, 0.0, None, None)


class Player:
    """Plays nothing. others: results or errors, by the number of the call from 1, beside PLAYED."""

    def __init__(
        self, others: Mapping[int, Any] | None = None, exposure: ExposureFigures | None = None
    ) -> None:
        self.others, self.exposure = others or {}, exposure
        self.played: list[Any] = []
        self.waited = 0

    def may_play(self) -> None:
        pass

    def status(self) -> Any:
        return self

    def play(self, sound: Any, vibration: Any) -> Played:
        self.played.append((sound, vibration))
        found = self.others.get(len(self.played), PLAYED)
        if isinstance(found, Exception):
            raise found
        assert isinstance(found, Played)
        return found

    def wait(self, timeout_s: float) -> bool:
        """Whether the device is back: at the second question."""
        self.waited += 1
        return self.waited > 1


class Answers:
    """Gives the values in their order, None and later ones are the first choice, or 50."""

    def __init__(self, *values: str | None) -> None:
        self._values = list(values)
        self.asked: list[Screen] = []
        self.shown: list[Screen] = []

    def show(self, shown: Screen) -> None:
        self.shown.append(shown)

    def wait(self) -> None:
        pass

    def ask(self, shown: Screen) -> Answer:
        self.asked.append(shown)
        value = self._values.pop(0) if self._values else None
        first = 50.0 if shown["kind"] == "slider" else shown["choices"][0][0]
        return Answer(first if value is None else value, 1.0)


def person(player: Any, answers: Any) -> Person:
    """Return a person with a player and answers of any type."""
    return Person(player, answers)
