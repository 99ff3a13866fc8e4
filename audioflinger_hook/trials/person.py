"""A person of a fit or a study: plays trials until they are valid, and asks."""

import sys
from collections.abc import Callable, Iterable
from typing import Any

from audioflinger_hook.trials.page import AGAIN, Answer, PageAnswers, Screen, screen
from audioflinger_hook.trials.player import DaemonPlayer, Frames, NotPlayedError, Played
from device.drive.exposure import ACTION_A8_M_S2, ACTION_VDV
from device.errors import UsageError

DEVICE_S = 1.0  # between two looks whether a lost device is back
NO_RIG = "exposure is not measured, so it ends no session: set rig in the config"
EXPOSURE_SHARE = 0.5  # of an action value of 2002/44/EC, which trials may use

Interval = tuple[Frames, Frames, Screen]  # sound, vibration, and the screen while they play


class TerminalAnswers:
    """Asks on the terminal, as `PageAnswers` on a page. keys: `pressed_keys` of the terminal."""

    def __init__(self, keys: Callable[[float], str]) -> None:
        self._keys = keys

    def show(self, shown: Screen) -> None:
        """Print the title."""
        print(shown["title"], file=sys.stderr, flush=True)

    def ask(self, shown: Screen) -> Answer:
        """Print a question with its keys; return the answer."""
        rows = *shown["choices"], *shown["also"]
        offered = {key: value for value, _, key in rows}
        keys = ", ".join(f"{key} {label.lower()}" for _, label, key in rows)
        while self._keys(0.0):  # pressed before the question
            pass
        print(*shown["text"], f"{shown['title']} ({keys})", sep="\n", file=sys.stderr, flush=True)
        while (pressed := self._keys(60.0).lower()) not in offered:
            pass
        return Answer(offered[pressed])

    def wait(self) -> None:
        """Return at once: a terminal has no pause."""


class Person:
    """A person who feels what `player` plays, and who answers through `answers`.

    All errors of both pass through. UsageError: half of a day's exposure action value is reached.
    """

    def __init__(self, player: DaemonPlayer, answers: PageAnswers | TerminalAnswers) -> None:
        self._player, self.answers = player, answers

    def play(self, sound: Frames, vibration: Frames, shown: Screen) -> Played:
        """Play both to the end, again after each pause or loss of the device.

        sound, vibration: as for `DaemonPlayer.play`. shown: screen while they play.
        """
        while True:
            self._player.may_play()  # before the look for a pause, so that no later one is lost
            self.answers.wait()
            felt = self._player.status().exposure
            if felt and max(felt.a8_m_s2 / ACTION_A8_M_S2, felt.vdv / ACTION_VDV) >= EXPOSURE_SHARE:
                raise UsageError(
                    f"today's exposure is A(8) {felt.a8_m_s2:.2g} m/s²; trials may use half of the "
                    "action value; go on tomorrow, all answers are kept"
                )
            self.answers.show(shown)
            try:
                played = self._player.play(sound, vibration)
                if not played.stopped:
                    return played
            except NotPlayedError as error:
                lost = f"The trial is played again as soon as possible: {error}."
                self.answers.show(screen("playing", "One moment", lost))
                while not self._player.wait(DEVICE_S):
                    self.answers.wait()

    def answer(
        self,
        intervals: Callable[[], Iterable[Interval]],
        question: Screen,
        is_valid: Callable[[Played], bool] = lambda played: True,
    ) -> tuple[list[Played], dict[str, Any]]:
        """Play intervals, again as often as the person asks; return what was played last.

        intervals: called before each playing. is_valid: whether an interval counts; if not, all are
        played again. Second result: "answer", "answered_after_s", "again" and "pauses".
        """
        again = 0
        while True:
            played = [self.play(*interval) for interval in intervals()]
            if not all(map(is_valid, played)):
                continue
            value, after_s, pauses = self.answers.ask(question)
            if value != AGAIN[0]:
                about = {"answered_after_s": after_s, "again": again, "pauses": pauses}
                return played, {"answer": value, **about}
            again += 1
