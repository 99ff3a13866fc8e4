"""A session of trials with one client, which ends when the client leaves.

The session begins with `{"session": true}`. For each line of the client, it gets one line:

    {"ready": true}                         {"ready": true}, or {"ready": false, "why": text}
    {"play": "trial.npy"}                   what was played, or {"lost": text}, or {"error": text}

The file is in the daemon's folder; see `trial_sound`. While a trial plays, any line of the client
ends the trial with a fade, and so does the end of the connection.
"""

from pathlib import Path
from typing import Any

from audioflinger_hook.daemon.trials import Trials
from audioflinger_hook.service.status_server import Talk
from device.errors import CushionError, UsageError

WAIT_S = 1.0


def play_trials(trials: Trials, talk: Talk) -> None:
    """Let a client play trials. OSError: it has left."""
    if not trials.begin():
        talk.say({"error": "another program plays trials; end it first"})
        return
    try:
        talk.say({"session": True})
        while True:
            asked = talk.heard(WAIT_S)
            if asked is None or asked.keys() == {"stop"}:  # a trial may end before its stop
                continue
            talk.say(_answer(trials, talk, asked))
    finally:
        trials.end()


def _answer(trials: Trials, talk: Talk, asked: dict[str, Any]) -> dict[str, Any]:
    try:
        match asked:
            case {"ready": True}:
                why = trials.why_not()
                return {"ready": False, "why": why} if why else {"ready": True}
            case {"play": str(name)} if Path(name).name == name:
                return trials.play(name, lambda timeout_s: _ends(talk, timeout_s))
        raise UsageError('allowed: {"ready": true} or {"play": NAME} with a file of this folder')
    except CushionError as error:
        return {"error": str(error)}


def _ends(talk: Talk, timeout_s: float) -> bool:
    try:
        return talk.heard(timeout_s) is not None
    except OSError:  # the client has left
        return True
