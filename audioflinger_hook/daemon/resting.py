"""Closes the streams of tap and device while nothing plays, and opens them at the next sound."""

from audioflinger_hook.daemon.endpoints import Endpoints
from audioflinger_hook.daemon.engines import Engines
from audioflinger_hook.daemon.timing import IdlePolicy
from audioflinger_hook.service.state import DaemonState, StateKeeper
from device.server import PulseConnection, ServerSnapshot


class Resting:
    """The idle state of the Python engine's streams. Only the main thread may call the methods."""

    def __init__(
        self, endpoints: Endpoints, engines: Engines, states: StateKeeper, now_s: float
    ) -> None:
        self._endpoints, self._engines, self._states = endpoints, engines, states
        self._policy = IdlePolicy(now_s)

    def end(self, now_s: float) -> None:
        """End the idle state after a change that concerns the streams."""
        self._policy.wake(now_s)

    def update(
        self, connection: PulseConnection | None, snapshot: ServerSnapshot | None, now_s: float
    ) -> bool:
        """Close the streams if nothing plays; return whether the daemon is idle.

        LostError, NotFoundError: the tap cannot be listened to.
        """
        tap, output, engine = self._endpoints.input, self._endpoints.output, self._engines.python
        if not (tap.may_rest and output.may_rest):
            self._policy.wake(now_s)
            return False
        heard = self._policy.resting and tap.listen(connection, now_s)
        players = tap.players(snapshot)
        # Without players, buffers may stop arriving, and `engine.faded` might never become true.
        over = engine is not None and (engine.faded or not players)
        last_sound_s = engine.last_sound_s if engine and over else now_s
        if not self._policy.update(now_s, players, last_sound_s, heard=heard):
            return False
        if self._states.enter(DaemonState.IDLE, now_s, tap.why_silent):
            self._endpoints.close()
            if engine:
                engine.rest()
        return True
