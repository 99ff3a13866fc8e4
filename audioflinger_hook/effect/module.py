"""One effect in a chain: its lifecycle, as AudioFlinger's EffectModule keeps it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from enum import Enum, auto

import numpy as np

from audioflinger_hook.effect.commands import CommandCheck, is_config
from audioflinger_hook.effect.guard import GuardedEngine, same_layout
from audioflinger_hook.effect.interface import (
    EINVAL,
    ENODATA,
    OK,
    Access,
    Command,
    EffectConfig,
    EffectEngine,
)
from audioflinger_hook.effect.parameters import Values
from audioflinger_hook.mixer.mix_buffer import MixBuffer

TAIL_MAX_S = 10.0
"""Seconds of sound for which a stopped effect may continue its tail."""


class EffectState(Enum):
    """Where an effect stands. ENABLE is sent on leaving STARTING, DISABLE on leaving STOPPING."""

    IDLE = auto()
    STARTING = auto()
    ACTIVE = auto()
    STOPPING = auto()
    STOPPED = auto()
    RESTART = auto()
    DESTROYED = auto()


ENABLED = (EffectState.STARTING, EffectState.ACTIVE, EffectState.RESTART)
PROCESSING = (
    EffectState.ACTIVE,
    EffectState.STOPPING,
    EffectState.STOPPED,
    EffectState.RESTART,
)
FRAMEWORK_ONLY = frozenset({Command.INIT, Command.SET_CONFIG})
"""Commands that only the framework itself sends."""


class EffectModule:
    """The framework's side of one engine; its client holds it.

    `enable` and `disable` only set the state. `update_state` sends it to the engine at the end of
    the next cycle, so it takes effect with the buffer after that cycle. An engine that refuses its
    configuration, raises, answers nonsense or overruns its time is bypassed and counted, and the
    sound passes unchanged. An accepted configuration ends a refusal. Enabling the effect again
    ends a fault, after a new INIT and SET_CONFIG.

    All calls come from the thread that steps the mixer, between buffers except `process`; none
    raises. Any thread may read the attributes.

    Parameters
    ----------
    engine : EffectEngine
        The effect's implementation.
    session : int
        Whose sound it treats.
    access : Access
        Whether it writes over the buffer or adds to another one.
    clock : callable
        Seconds.
    budget_s : float
        Seconds that one buffer may take; inf for offline work.

    Attributes
    ----------
    readings : tuple of str
        The effect's own state when it was last asked, as lines.

    Raises
    ------
    Exception
        The engine raises when asked for its descriptor.
    """

    def __init__(
        self,
        engine: EffectEngine,
        *,
        session: int,
        access: Access = Access.WRITE,
        clock: Callable[[], float],
        budget_s: float,
    ) -> None:
        self.descriptor = engine.descriptor
        self.session = session
        self.access = access
        self.state = EffectState.IDLE
        self.refusal = ""
        self.refusals = 0
        self.misfits = 0
        self.readings: tuple[str, ...] = ()
        self.config: EffectConfig | None = None
        self.guard = GuardedEngine(engine, clock, budget_s)
        self._check = CommandCheck(self.descriptor)
        self._initialised = False
        self._accepted = False
        self._running = False
        self._tail_buffers = 0
        self._initialise()

    @property
    def enabled(self) -> bool:
        """Whether its client wants it to run."""
        return self.state in ENABLED

    @property
    def bypassed(self) -> str:
        """Why it is bypassed although it may be enabled; "" while it is not."""
        return self.guard.fault or self.refusal

    def enable(self) -> int:
        """Start it with the buffer after the next. Returns OK, or EINVAL if destroyed."""
        match self.state:
            case EffectState.DESTROYED:
                return EINVAL
            case _ if self.guard.fault:
                self.state = EffectState.STARTING
            case EffectState.IDLE:
                self.state = EffectState.STARTING
            case EffectState.STOPPED:
                self.state = EffectState.RESTART
            case EffectState.STOPPING:
                self.state = EffectState.ACTIVE
        return OK

    def disable(self) -> int:
        """Stop it after its tail. Returns OK, or EINVAL if destroyed."""
        match self.state:
            case EffectState.DESTROYED:
                return EINVAL
            case EffectState.STARTING:
                self.state = EffectState.IDLE
            case EffectState.RESTART:
                self.state = EffectState.STOPPED
            case EffectState.ACTIVE:
                self.state = EffectState.STOPPING
        return OK

    def set_config(self, config: EffectConfig) -> int:
        """Send it the format of the stream, if that is new, and return its status.

        `access` stays unchanged. A refusal bypasses it until one is accepted.
        """
        if self.state is EffectState.DESTROYED or not is_config(config):
            return EINVAL
        config = replace(config, access=self.access)
        if config == self.config and self._accepted:
            return OK
        self.config = config
        self.guard.prepare(config)
        return self._configure()

    def command(self, code: int, data: object = None) -> tuple[int, object]:
        """Return status and reply of a client's command.

        Wrong codes, types, sizes, names and ranges are EINVAL and never reach the engine.
        """
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
        status, reply = self.guard.command(code, data)
        if code == Command.GET_PARAM and status == OK:
            parameter = self._check.parameter(data)
            if parameter is None or not parameter.accepts(reply):
                self.guard.blame(f"answered GET_PARAM {data} with nonsense", bypass=False)
                return EINVAL, None
        return status, reply

    def set_parameters(self, values: Values) -> int:
        """Set several parameters at once, or none. Returns OK or why not."""
        for name, value in values.items():
            status = self._check.status(Command.SET_PARAM, (name, value))
            if status != OK:
                return status
        for name, value in values.items():
            status, _ = self.command(Command.SET_PARAM_DEFERRED, (name, value))
            if status != OK:
                return status
        return self.command(Command.SET_PARAM_COMMIT)[0]

    def process(self, source: MixBuffer, target: MixBuffer) -> None:
        """Treat one buffer: in place where both are the same, else `target` is added to.

        Where it does not run, the sound passes: in place nothing happens, else `source` is
        added to `target`. Called once a cycle.
        """
        in_place = source is target
        if not in_place and not same_layout(source, target):
            self.misfits += 1
            return
        if self.state in PROCESSING and self._ready(source, in_place):
            status = self.guard.process(source, target)
            if status == ENODATA and self.state is EffectState.STOPPED:
                self._tail_buffers = 1
            if status is not None:
                return
        if not in_place:
            np.add(target.samples, source.samples, out=target.samples)

    def update_state(self) -> None:
        """Send what enable, disable and the end of a tail ask for. Called at a cycle's end."""
        match self.state:
            case EffectState.STARTING | EffectState.RESTART:
                self._start()
            case EffectState.STOPPING:
                self._stop()
            case EffectState.STOPPED:
                self._tail_buffers -= 1
                if self.guard.fault:
                    self.state = EffectState.IDLE
                elif self._tail_buffers <= 0:
                    self.guard.command(Command.RESET)
                    self.state = EffectState.IDLE

    def release(self) -> None:
        """Disable a running engine and detach it for good."""
        if self._running and not self.guard.fault:
            self.guard.command(Command.DISABLE)
        self._running = False
        self.state = EffectState.DESTROYED

    def _ready(self, source: MixBuffer, in_place: bool) -> bool:
        """Return whether the engine can be given a buffer: configured, sound, of its size."""
        if self.config is None or not self._accepted or self.guard.fault:
            return False
        access = Access.WRITE if in_place else Access.ACCUMULATE
        if access is not self.access:
            self.access = access
            if self.set_config(self.config) != OK:
                return False
        config = self.config
        frames = source.frames
        if (
            not 1 <= frames <= config.frames
            or source.audio.shape != (frames, config.channels)
            or source.haptic.shape != (frames, config.haptic_channels)
        ):
            self.misfits += 1
            return False
        return True

    def _initialise(self) -> None:
        status, _ = self.guard.command(Command.INIT)
        self._initialised = status == OK
        if not self._initialised:
            self._refused("INIT", status)

    def _configure(self) -> int:
        self._accepted = False
        if self.config is None or self.guard.fault:
            return EINVAL
        if not self._initialised:
            self._initialise()
            if not self._initialised:
                return EINVAL
        status, _ = self.guard.command(Command.SET_CONFIG, self.config)
        if status == OK:
            self._accepted = True
            self.refusal = ""
        else:
            self._refused(stream_text(self.config), status)
        return status

    def _start(self) -> None:
        if self.guard.fault:
            self.guard.forgive()
            self._initialised = False
            self._running = False
            self._configure()
        if self.guard.fault:
            self.state = EffectState.IDLE
            return
        if not self._accepted:
            return  # it starts once it has a format
        if self.state is EffectState.RESTART:
            self.guard.command(Command.RESET)
        status, _ = self.guard.command(Command.ENABLE)
        if status == OK:
            self._running = True
            self.state = EffectState.ACTIVE
        else:
            self._refused("ENABLE", status, bypass=False)
            self.state = EffectState.IDLE

    def _stop(self) -> None:
        if self.guard.fault or self.config is None:
            self.state = EffectState.IDLE
            return
        self.guard.command(Command.DISABLE)
        self._running = False
        cycle_s = self.config.frames / self.config.samplerate
        self._tail_buffers = max(1, round(TAIL_MAX_S / cycle_s))
        self.state = EffectState.STOPPED

    def _refused(self, what: str, status: int, *, bypass: bool = True) -> None:
        """Count and name a refusal that was not a fault."""
        if self.guard.fault:
            return
        self.refusals += 1
        reason = f"refused {what} (status {status})"
        self.guard.complaint = reason
        if bypass:
            self.refusal = reason


def stream_text(config: EffectConfig) -> str:
    """Return a configuration in words."""
    return (
        f"{config.samplerate} Hz, {config.channels} + {config.haptic_channels} channels, "
        f"{config.frames} frames, {config.access.name.lower()}"
    )
