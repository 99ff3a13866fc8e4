"""An effect's lifecycle and commands, as in AudioFlinger's EffectModule."""

from dataclasses import replace
from enum import Enum
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

TAIL_MAX_S = 10.0  # longest time in s for which a disabled effect outputs its decaying tail

# These commands do not change the sound, so their failure causes no bypass.
READING = (Command.GET_PARAM, Command.GET_CONFIG, Command.DUMP)
FRAMEWORK_ONLY = (Command.INIT, Command.SET_CONFIG)


# state of an effect; STOPPED: the effect is disabled, but still outputs its decaying tail
EffectState = Enum("EffectState", "IDLE STARTING ACTIVE STOPPING STOPPED RESTART DESTROYED")

ENABLED = (EffectState.STARTING, EffectState.ACTIVE, EffectState.RESTART)
ON_ENABLE = {
    EffectState.IDLE: EffectState.STARTING,
    EffectState.STOPPED: EffectState.RESTART,
    EffectState.STOPPING: EffectState.ACTIVE,
}
ON_DISABLE = {new: old for old, new in ON_ENABLE.items()}


class EffectControl:
    """Lifecycle of one engine, which may raise exceptions or return invalid answers.

    `enable` and `disable` only set `state`. After a mixer cycle, `update_state` sends ENABLE or
    DISABLE to the engine. The engine is bypassed while `refusal`, `fault` or `given_up` is not "".

    - `refusal`: the engine refused INIT or SET_CONFIG. An accepted SET_CONFIG ends the bypass.
    - `fault`: the engine failed. After `enable`, `update_state` sends INIT and SET_CONFIG again.
    - `given_up`: another thread found that the engine blocks the audio thread.
    - `complaint`: text of the last refusal or failure.

    Only the mixer's thread may call methods, between buffers. Any thread may read attributes.
    Methods raise only KeyboardInterrupt.
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
        """Whether the client has enabled the effect. An enabled effect may be bypassed."""
        return self.state in ENABLED

    @property
    def bypassed(self) -> str:
        """Why the effect is bypassed, or "" if it is not bypassed."""
        return self.fault or self.given_up or self.refusal

    def enable(self) -> int:
        """Let the next `update_state` start the effect. Return OK, or EINVAL after `release`."""
        if self.state is EffectState.DESTROYED:
            return EINVAL
        self.state = EffectState.STARTING if self.fault else ON_ENABLE.get(self.state, self.state)
        return OK

    def disable(self) -> int:
        """Let the next `update_state` stop the effect. Return OK, or EINVAL after `release`."""
        if self.state is EffectState.DESTROYED:
            return EINVAL
        self.state = ON_DISABLE.get(self.state, self.state)
        return OK

    def set_config(self, config: EffectConfig) -> int:
        """Send a format to the engine, unless already accepted. Return OK or an error status."""
        if self.state is EffectState.DESTROYED or not is_config(config):
            return EINVAL
        config = replace(config, access=self.access)
        if config == self.config and self._accepted:
            return OK
        self.config = config
        self._make_room(config)
        return self._configure()

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Execute a client's command, if it is valid. Return (status, reply)."""
        if (status := self._check.status(code, data)) != OK:
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
        """Set several parameters at once, if all values are valid. Return OK or an error status."""
        for pair in values.items():
            if status := self._check.status(Command.SET_PARAM, pair):
                return status
        for pair in values.items():
            if status := self.command(Command.SET_PARAM_DEFERRED, pair)[0]:
                return status
        return self.command(Command.SET_PARAM_COMMIT)[0]

    def send(self, code: int, data: object = None) -> tuple[int, object]:
        """Send a command to the engine. Return (status, reply); (EINVAL, None) after a failure."""
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
        """Send the commands that `state` requires. Call this at the end of each mixer cycle."""
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
        """Disable a running engine and enter the final state DESTROYED."""
        if self._running and not self.fault:
            self.send(Command.DISABLE)
        self._running = False
        self.state = EffectState.DESTROYED

    def _make_room(self, config: EffectConfig) -> None:
        """Allocate memory for the buffers of a configuration."""

    def _forgive(self) -> None:
        """End the bypass after a failure; the number of failures is kept."""
        self.fault = self.given_up = ""

    def _blame(self, reason: str, *, bypass: bool = True) -> None:
        """Count a failure, store its reason and, with `bypass`, bypass the engine."""
        self.faults += 1
        self.complaint = reason
        if bypass and not self.fault:
            self.fault = reason

    def _refused(self, what: str, status: int, *, bypass: bool = True) -> None:
        """Count a refusal, store its text and, with `bypass`, bypass the engine."""
        if self.fault:
            return
        self.refusals += 1
        self.complaint = f"refused {what} (status {status})"
        if bypass:
            self.refusal = self.complaint

    def _initialise(self) -> bool:
        status, _ = self.send(Command.INIT)
        self._initialised = status == OK
        if not self._initialised:
            self._refused("INIT", status)
        return self._initialised

    def _configure(self) -> int:
        self._accepted = False
        if self.config is None or self.fault:
            return EINVAL
        if not (self._initialised or self._initialise()):
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
            self._initialised = self._running = False
            self._configure()
        if self.fault:
            self.state = EffectState.IDLE
            return
        if not self._accepted:
            return  # the state does not change until the engine accepts a format
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
    """Return a configuration as text."""
    return (
        f"{config.samplerate} Hz, {config.channels} + {config.haptic_channels} channels, "
        f"{config.frames} frames, {config.access.name.lower()}"
    )


def is_status(answer: object) -> bool:
    """Return whether an engine's answer is a valid status code."""
    return type(answer) is int and answer in (OK, EINVAL, ENODATA, ENOSYS)


def error_text(error: BaseException) -> str:
    """Return type and message of an exception on one line; never raises."""
    try:
        words = " ".join(str(error).split())[:200]
    except BaseException:
        words = ""
    return f"{type(error).__name__}: {words}".removesuffix(": ")


def place_text(error: BaseException) -> str:
    """Return the place where an exception was raised as ` (FILE, line N)`; "" if unknown."""
    if not (places := [*walk_tb(error.__traceback__)]):
        return ""
    frame, line = places[-1]
    return f" ({PurePath(frame.f_code.co_filename).name}, line {line})"


def answer_text(answer: object) -> str:
    """Return a short text for an engine's invalid answer; never raises."""
    return str(answer) if answer is None or type(answer) is int else type(answer).__name__
