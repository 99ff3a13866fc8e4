"""Carries out requests that live pages send to a running daemon, in order of arrival.

At most one request is carried out per PAUSE_S. If a setting gets several values meanwhile, the last
value wins. Values are checked like values of the config file. A request has one of these forms:

    "set": {"gain_db": -6.0}                   change keys of the config; null sets the default
    "application": {"match": "mpv", "feel": false}    change its rule; null removes a value
    "mute": true                               mute the vibration; false ends the mute
    "tone": {"hz": 60, "level": 0.2}           start the test tone; null stops the tone
    "sync": {"try_ms": 120}                    play an offset on trial; null ends the trial
    "sync": {"store_ms": 120}                  store an offset for the present pair of sinks
    "trial": true                              tell what `daemon/trials.py` returns
    "undo": true                               undo the last change of the config
    "save": true                               write the changes to the config file

The answer is `{"done": true}` or `{"error": message}`. If a value is refused,
the answer also has the key of this value as `"key"`.
"""

import json
import math
import re
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import Any

from audioflinger_hook.config.edits import EDITABLE, RULE, LiveEdits, editable
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.schema import CHANGES, Key, allowed_now
from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.status_report import frame_of
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.trials import trial_figures
from audioflinger_hook.service.install import own_command
from audioflinger_hook.service.one_line import one_line
from audioflinger_hook.service.request_queue import RequestQueue
from device.errors import CushionError, UsageError
from device.units import db_to_amplitude
from device.values import Described

PAUSE_S = 0.1  # from one request that is carried out to the next
ANSWER_S = 3.0  # longest wait for an answer
KEYS_MAX = 16  # largest number of keys in one `set` request
ENVELOPE = ("ask", "protocol")  # keys of a request beside the change
TONE_S = 20.0  # the test tone ends after this time, in case its page was closed
TONE_END_S = 2.0  # longest wait for the end of the tone's process; the fade-out takes 0.1 s


class LiveControl:
    """Carries out requests of live pages on the main thread; implements `Live`.

    Threads of the status server call `frame`, `watched_by` and `control`.

    edits: changes to the config. ring: wakes the main thread. follow: applies edits and mute, and
    returns the new config. After a CushionError, nothing has changed.
    page: address of the live page that connected last, or "". settings: values that pages show.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        edits: LiveEdits,
        follow: Callable[[Mapping[str, Any], bool], RunConfig],
        ring: Callable[[], None],
        config: RunConfig,
    ) -> None:
        self._supervisor, self._config, self._edits = supervisor, config, edits
        self._follow, self._ring = follow, ring
        self.page = ""
        self.settings: dict[str, Any] = {}
        self._tone: subprocess.Popen[bytes] | None = None
        self._waiting = RequestQueue()
        self._due_s = -math.inf
        self._tell()

    def frame(self, missed: int, *, in_memory: bool) -> tuple[bytes, bool]:
        """Return levels and partials as a line of JSON. See `frame_of`."""
        return frame_of(self._supervisor, self._level, missed, in_memory=in_memory)

    def watched_by(self, page: str) -> None:
        """Store the address of a live page that has connected."""
        if page.startswith("http://"):
            self.page = one_line(page)
            self._ring()

    def control(self, request: dict[str, Any]) -> dict[str, Any]:
        """Let the main thread carry out a request; return the answer."""
        answers = SimpleQueue[dict[str, Any]]()
        answer = answers.put
        asked = {name: value for name, value in request.items() if name not in ENVELOPE}
        if "trial" in asked:
            return trial_figures(self._supervisor)
        if self._waiting.put(asked, answer):  # else the main thread has been woken
            self._ring()
        try:
            return answers.get(timeout=ANSWER_S)
        except Empty:
            self._waiting.drop(answer)
            return {"error": f"the daemon has not answered within {ANSWER_S:g} s; try again"}

    def rest_s(self, now_s: float) -> float:
        """Return the time until `work` can carry out the next waiting request; inf for none."""
        return max(0.0, self._due_s - now_s) if len(self._waiting) else math.inf

    def work(self, now_s: float) -> None:
        """Carry out a waiting request, if it is due. Detect the end of the test tone's process."""
        if now_s >= self._due_s and (waiting := self._waiting.take()):
            asked, answer = waiting
            self._due_s = now_s + PAUSE_S
            answer(self._carry_out(asked))
        if self._tone is not None and self._tone.poll() is not None:
            self._tone = None
            self._tell()

    def reloaded(self, config: RunConfig) -> None:
        """Use a config that was read again from its file."""
        self._config = config
        self._tell()

    def close(self) -> None:
        """End the test tone."""
        if self._tone is not None:
            self._tone.terminate()
            try:
                self._tone.wait(TONE_END_S)
            except subprocess.TimeoutExpired:  # if the sound server hangs, the daemon must continue
                self._tone.kill()
                self._tone.wait()
            self._tone = None

    def _carry_out(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        actions: dict[str, Callable[[Any], None]] = {
            "set": self._set,
            "application": self._rule,
            "mute": self._mute,
            "tone": self._play_tone,
            "sync": self._sync,
            "undo": lambda _: self._undo(),
            "save": lambda _: self._edits.save(),
        }
        try:
            if len(asked) != 1 or not asked.keys() <= actions.keys():
                raise UsageError(f"give exactly one of {', '.join(actions)}, and nothing else")
            ((name, value),) = asked.items()
            if re.search("[\ud800-\udfff]", json.dumps(value, ensure_ascii=False)):
                raise UsageError(f"{name} has text that is not Unicode")
            if name in ("undo", "save") and value is not True:
                raise UsageError(f"{name} takes true")
            actions[name](value)
        except _Refused as error:
            return {"error": str(error), "key": error.key}
        except CushionError as error:
            return {"error": one_line(str(error), 400)}
        except Exception as error:  # a programming error must not end the daemon
            return {"error": f"the request failed: {type(error).__name__}: {one_line(str(error))}"}
        self._tell()
        return {"done": True}

    def _set(self, changes: object) -> None:
        if not isinstance(changes, dict) or not 1 <= len(changes) <= KEYS_MAX:
            raise UsageError(f"set takes 1 to {KEYS_MAX} keys with their values")
        typed = {}
        for name, value in changes.items():
            described = editable(name).description
            refusal = None if value is None else described.refuse(value)
            if refusal:
                raise _Refused(name, f"{one_line(str(value), 60)} {refusal}")
            typed[name] = None if value is None else described.typed(value)
        self._edit(typed)

    def _edit(self, changes: Mapping[str, Any]) -> None:
        try:
            self._apply({**self._edits.values, **changes}, self._config.muted)
        except CushionError as error:
            raise _Refused(next(iter(changes)), one_line(str(error), 400)) from error
        self._edits.accept(changes)

    def _rule(self, given: object) -> None:
        if not isinstance(given, dict) or not isinstance(given.get("match"), str) or len(given) < 2:
            raise UsageError('application takes {"match": NAME} with feel, profile or gain_db')
        match, live = given["match"].strip(), self._config.live
        if given.get("feel") is False and self._supervisor.is_mixed:
            # Only captures of single applications can leave out one of them.
            self._set({"applications.exclude": [*live.exclude, match]})
            return
        present: dict[str, Any] = {}
        for one in live.application_rules:
            if one.match.strip().casefold() == match.casefold():
                match, present = one.match, vars(one)
        if False in (given.get("feel"), present.get("feel")):  # contradicts the other keys
            present = {}
        rule = {**present, **given, "match": None}
        rule = {n: v for n, v in rule.items() if v is not None and (n, v) != ("gain_db", 0.0)}
        self._edit({RULE + match: rule or None})

    def _mute(self, muted: object) -> None:
        if not isinstance(muted, bool):
            raise UsageError("mute takes true or false")
        if muted:  # the tone is a separate process, which the engine cannot mute
            self.close()
        if muted != self._config.muted:
            self._apply(self._edits.values, muted)

    def _undo(self) -> None:
        self._apply(self._edits.without_last(), self._config.muted)
        self._edits.undo()

    def _apply(self, edits: Mapping[str, Any], muted: bool) -> None:
        self._config = self._follow(edits, muted)

    def _play_tone(self, wanted: object) -> None:
        if wanted is None:
            self.close()
            return
        if not isinstance(wanted, dict) or not wanted.keys() <= {"hz", "level"}:
            raise _Refused("tone", 'tone takes {"hz": HZ} with or without level, or null')
        hz, level = wanted.get("hz", 60.0), wanted.get("level", 0.2)
        if type(hz) not in (int, float) or not 20.0 <= hz <= 220.0:
            raise _Refused(
                "tone", f"{one_line(str(hz), 60)} is out of range; allowed: 20 to 220 Hz"
            )
        if type(level) not in (int, float) or not 0.0 < level <= 0.5:
            raise _Refused("tone", "the level is out of range; allowed: above 0, up to 0.5")
        _, (address, name) = self._supervisor.endpoints
        if not address.startswith(("sink:", "usb:")) or name is None:
            raise _Refused(
                "tone",
                f"{one_line(address)} cannot play a test tone; allowed: a sink or a USB device of "
                "the sound server that is there",
            )
        self.close()
        options = {"device": f"sink:{name}", "hz": hz, "level": level, "seconds": TONE_S}
        command = [*own_command(), "test-tone", *(f"--{key}={v}" for key, v in options.items())]
        # In a separate process, the tone uses no thread of the daemon.
        nothing = subprocess.DEVNULL
        self._tone = subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing)

    def _sync(self, wanted: object) -> None:
        offset = self._supervisor.alignment.offset
        actions: dict[str, Callable[[Any], None]]
        actions = {"try_ms": offset.try_out, "store_ms": offset.store}
        if not isinstance(wanted, dict) or len(wanted) != 1 or not wanted.keys() <= set(actions):
            raise UsageError('sync takes {"try_ms": MS}, {"try_ms": null} or {"store_ms": MS}')
        ((name, offset_ms),) = wanted.items()
        if wanted == {"try_ms": None}:
            offset.try_out(None)
            return
        if type(offset_ms) not in (int, float):
            raise UsageError(f"{name} takes a number of ms")
        # UsageError: the offset is not allowed
        actions[name](replace(self._config.live, offset_ms=offset_ms).offset_s)

    def _tell(self) -> None:
        """Set `settings` to a new object, by which the status server detects the change."""
        config, filed = self._config, self._edits.unsaved()
        owners = {Settings: config.settings, LiveSettings: config.live}
        self._level = 0.0 if config.muted else db_to_amplitude(config.settings.gain_db)
        self.settings = {
            "keys": [
                _shown(name, key, owners.get(key.owner, config.settings.parameters))
                | {"unsaved": name in filed, "file": filed.get(name)}
                for name, key in EDITABLE.items()
            ],
            "rules": [vars(one) for one in config.live.application_rules],
            "unsaved_rules": [name.partition(RULE)[2] for name in filed if RULE in name],
            "unsaved": len(filed),
            "undo": self._edits.undo_count,
            "muted": config.muted,
            "tone": self._tone is not None,
            "recording": config.recording is not None,
        }


class _Refused(UsageError):
    def __init__(self, key: str, message: str) -> None:
        super().__init__(message)
        self.key = key


def _shown(name: str, key: Key, owner: Described) -> dict[str, Any]:
    described = key.description
    schema = {k: v for k, v in described.json_schema().items() if k != "description"}
    return {
        "key": name,
        "meaning": described.meaning,
        "allowed": described.allowed,
        "schema": schema | allowed_now(owner, key.field),
        "unit": getattr(described, "unit", ""),
        "default": LIVE_DEFAULT if name == "profile" else key.default,
        "value": getattr(owner, key.field),
        "change": CHANGES[key.change],
    }
