"""An effect's lifecycle and commands, as in AudioFlinger's EffectModule."""

from __future__ import annotations

from dataclasses import replace
from enum import Enum, auto
from pathlib import PurePath
from traceback import walk_tb

import numpy as np

from audioflinger_hook.effect.commands import CommandCheck, is_config
from audioflinger_hook.effect.interface import (
    EINVAL,
    ENODATA,
    ENOSYS,
    OK,
    Access,
    Command,
    EffectConfig,
    EffectEngine,
    Values,
)

TAIL_MAX_S = 10.0  # seconds of sound for which a stopped effect may continue its tail
REASON_MAX = 200  # characters of an engine's message that are kept
STATUSES = (OK, EINVAL, ENODATA, ENOSYS)

# Commands whose failure is counted but causes no bypass, since they change no sound.
READING = (Command.GET_PARAM, Command.GET_CONFIG, Command.DUMP)
FRAMEWORK_ONLY = (Command.INIT, Command.SET_CONFIG)


class EffectState(Enum):
    """State of an effect. ENABLE is sent on leaving STARTING, DISABLE on leaving STOPPING."""

    IDLE = auto()
    STARTING = auto()
    ACTIVE = auto()
    STOPPING = auto()
    STOPPED = auto()
    RESTART = auto()
    DESTROYED = auto()


ENABLED = (EffectState.STARTING, EffectState.ACTIVE, EffectState.RESTART)
ON_ENABLE = {
    EffectState.IDLE: EffectState.STARTING,
    EffectState.STOPPED: EffectState.RESTART,
    EffectState.STOPPING: EffectState.ACTIVE,
}
ON_DISABLE = {new: old for old, new in ON_ENABLE.items()}


class EffectControl:
    """An engine that may raise or answer nonsense, held through its lifecycle.

    `enable` and `disable` only set the state; `update_state` sends it to the engine at the end of
    the next cycle. An engine that refuses its configuration (`refusal`) is bypassed until it
    accepts one. An engine with a `fault` is bypassed until it is enabled again, after a new INIT
    and SET_CONFIG. `given_up`: why another thread, which sets it, does not wait for the engine.
    `complaint`: the last refusal or fault. `readings`: the engine's own lines about its state.

    All calls come from the thread that steps the mixer, between buffers; any thread may read. None
    raises, except KeyboardInterrupt, which is the user's.
    """

    def __init__(self, engine: EffectEngine, session: int) -> None:
        self.descriptor = engine.descriptor
        self.session = session
        self.access = Access.WRITE
        self.state = EffectState.IDLE
        self.fault = self.refusal = self.complaint = self.given_up = ""
        self.faults = self.refusals = 0
        self.readings: tuple[str, ...] = ()
        self.config: EffectConfig | None = None
        self._engine = engine
        self._check = CommandCheck(self.descriptor)
        self._initialised = self._accepted = self._running = False
        self._tail_buffers = 0
        self._initialise()

    @property
    def enabled(self) -> bool:
        """Whether the client wants the effect to run."""
        return self.state in ENABLED

    @property
    def bypassed(self) -> str:
        """Why the effect is bypassed, whether enabled or not; "" if it is not bypassed."""
        return self.fault or self.given_up or self.refusal

    def enable(self) -> int:
        """Start it with the buffer after the next. Returns OK, or EINVAL if destroyed."""
        if self.state is EffectState.DESTROYED:
            return EINVAL
        self.state = EffectState.STARTING if self.fault else ON_ENABLE.get(self.state, self.state)
        return OK

    def disable(self) -> int:
        """Stop it after its tail. Returns OK, or EINVAL if destroyed."""
        if self.state is EffectState.DESTROYED:
            return EINVAL
        self.state = ON_DISABLE.get(self.state, self.state)
        return OK

    def set_config(self, config: EffectConfig) -> int:
        """Send the engine the stream's format, if it is new, and return the engine's status."""
        if self.state is EffectState.DESTROYED or not is_config(config):
            return EINVAL
        config = replace(config, access=self.access)
        if config == self.config and self._accepted:
            return OK
        self.config = config
        self._make_room(config)
        return self._configure()

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Return status and reply of a client's command; EINVAL for a wrong one."""
        status = self._check.status(code, data)
        if status != OK:
            return status, None
        if self.state is EffectState.DESTROYED or code in FRAMEWORK_ONLY:
            return EINVAL, None
        if code == Command.ENABLE:
            return self.enable(), None
        if code == Command.DISABLE:
            return self.disable(), None
        if code == Command.RESET and not self._accepted:
            return EINVAL, None
        status, reply = self.send(code, data)
        if code == Command.GET_PARAM and status == OK:
            parameter = self._check.parameter(data)
            if parameter is None or not parameter.accepts(reply):
                self._blame(f"answered GET_PARAM {data} with nonsense", bypass=False)
                return EINVAL, None
        return status, reply

    def set_parameters(self, values: Values) -> int:
        """Set several parameters at once, or none. Return OK or the status of the failure."""
        for pair in values.items():
            if status := self._check.status(Command.SET_PARAM, pair):
                return status
        for pair in values.items():
            if status := self.command(Command.SET_PARAM_DEFERRED, pair)[0]:
                return status
        return self.command(Command.SET_PARAM_COMMIT)[0]

    def send(self, code: int, data: object = None) -> tuple[int, object]:
        """Return the engine's status and reply to a command; EINVAL and None if it failed."""
        name = Command(code).name if code < Command.FIRST_PROPRIETARY else f"command {code:#x}"
        try:
            with np.errstate(all="ignore"):
                answer: object = self._engine.command(code, data)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            wrong = f"raised {error_text(error)} in {name}{place_text(error)}"
        else:
            if type(answer) is tuple and len(answer) == 2 and is_status(answer[0]):
                return answer
            wrong = f"answered {name} with {answer_text(answer)}; allowed: (status, reply)"
        self._blame(wrong, bypass=code not in READING)
        return EINVAL, None

    def update_state(self) -> None:
        """Send the commands due after enable, disable or the end of a tail, at a cycle's end."""
        match self.state:
            case EffectState.STARTING | EffectState.RESTART:
                self._start()
            case EffectState.STOPPING:
                self._stop()
            case EffectState.STOPPED:
                self._tail_buffers -= 1
                if self.fault:
                    self.state = EffectState.IDLE
                elif self._tail_buffers <= 0:
                    self.send(Command.RESET)
                    self.state = EffectState.IDLE

    def release(self) -> None:
        """Disable a running engine and detach it for good."""
        if self._running and not self.fault:
            self.send(Command.DISABLE)
        self._running = False
        self.state = EffectState.DESTROYED

    def _make_room(self, config: EffectConfig) -> None:
        """Prepare for a configuration's buffers."""

    def _forgive(self) -> None:
        """Lift the bypass after a fault; the counters continue."""
        self.fault = self.given_up = ""

    def _blame(self, reason: str, *, bypass: bool = True) -> None:
        """Count a failure, keep its reason and, if asked to, bypass the engine."""
        self.faults += 1
        self.complaint = reason
        if bypass and not self.fault:
            self.fault = reason

    def _refused(self, what: str, status: int, *, bypass: bool = True) -> None:
        """Count and name a refusal, which is not a fault."""
        if self.fault:
            return
        self.refusals += 1
        self.complaint = f"refused {what} (status {status})"
        if bypass:
            self.refusal = self.complaint

    def _initialise(self) -> None:
        status, _ = self.send(Command.INIT)
        self._initialised = status == OK
        if not self._initialised:
            self._refused("INIT", status)

    def _configure(self) -> int:
        self._accepted = False
        if self.config is None or self.fault:
            return EINVAL
        if not self._initialised:
            self._initialise()
            if not self._initialised:
                return EINVAL
        status, _ = self.send(Command.SET_CONFIG, self.config)
        if status == OK:
            self._accepted = True
            self.refusal = ""
        else:
            self._refused(config_text(self.config), status)
        return status

    def _start(self) -> None:
        if self.fault:
            self._forgive()
            self._initialised = False
            self._running = False
            self._configure()
        if self.fault:
            self.state = EffectState.IDLE
            return
        if not self._accepted:
            return  # the effect starts once it has a format
        if self.state is EffectState.RESTART:
            self.send(Command.RESET)
        status, _ = self.send(Command.ENABLE)
        if status == OK:
            self._running = True
            self.state = EffectState.ACTIVE
        else:
            self._refused("ENABLE", status, bypass=False)
            self.state = EffectState.IDLE

    def _stop(self) -> None:
        if self.fault or self.config is None:
            self.state = EffectState.IDLE
            return
        self.send(Command.DISABLE)
        self._running = False
        cycle_s = self.config.frames / self.config.samplerate
        self._tail_buffers = max(1, round(TAIL_MAX_S / cycle_s))
        self.state = EffectState.STOPPED


def config_text(config: EffectConfig) -> str:
    """Return the words for a configuration."""
    return (
        f"{config.samplerate} Hz, {config.channels} + {config.haptic_channels} channels, "
        f"{config.frames} frames, {config.access.name.lower()}"
    )


def is_status(answer: object) -> bool:
    """Return whether an engine's answer is one of Android's status codes."""
    return type(answer) is int and answer in STATUSES


def error_text(error: BaseException) -> str:
    """Return an exception's type and message on one line; never raises."""
    try:
        words = " ".join(str(error).split())[:REASON_MAX]
    except BaseException:
        words = ""
    return f"{type(error).__name__}: {words}".removesuffix(": ")


def place_text(error: BaseException) -> str:
    """Return ` (FILE, line N)` of the line that raised an exception; never raises."""
    places = [*walk_tb(error.__traceback__)]
    if not places:
        return ""
    frame, line = places[-1]
    return f" ({PurePath(frame.f_code.co_filename).name}, line {line})"


def answer_text(answer: object) -> str:
    """Return a wrong answer in few words; never raises, whatever the answer is."""
    return str(answer) if answer is None or type(answer) is int else type(answer).__name__
