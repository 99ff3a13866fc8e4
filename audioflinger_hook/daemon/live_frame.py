"""What a page shows many times a second, as a line of JSON.

Each frame is computed after a pause in which other programs used the processor's caches. So it
costs what it touches: numbers are read at once and put into one form at once.
"""

from __future__ import annotations

from functools import cache
from itertools import chain

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.native.page import Shown
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.state import DaemonState

_NOTHING: Shown = ((0, 0, 0), ())


def frame_of(supervisor: Supervisor, level: float, missed: int) -> bytes:
    """Return `{"frame": ...}` and a line break.

    Any thread may call it; audio threads do not wait for it. sound, vibration: peak and mean square
    of each channel and of each actuator. partials: Hz of the sound, Hz of the vibration, and
    amplitude before the level.

    level: factor on the vibration, 0 while it is muted. missed: frames that were not sent.
    """
    state = supervisor.states.state
    counts, numbers = _NOTHING
    if state is DaemonState.RUNNING:
        engines = supervisor.engines
        native = engines.switch.native
        if native is not None and native.audible:
            counts, numbers = native.shown
        elif engines.python is not None:
            counts, numbers = _shown_of(engines.python)
    return _form(*counts) % (state.value.encode(), level, *numbers, missed)


@cache
def _form(channels: int, actuators: int, partials: int) -> bytes:
    """Return the form of a frame; an engine shows a few dozen different ones."""
    pairs, triples = "[%.4g, %.4g]", "[%.5g, %.5g, %.4g]"
    return (
        '{"frame": {"state": "%s", "level": %.4g, '
        f'"sound": [{", ".join([pairs] * channels)}], '
        f'"vibration": [{", ".join([pairs] * actuators)}], '
        f'"partials": [{", ".join([triples] * partials)}], '
        '"missed": %d}}\n'
    ).encode()


def _shown_of(engine: Engine) -> Shown:
    channels = engine.sound.meter.channel_readings()
    actuators = [one.meter.reading() for one in engine.driven or (engine.vibration,)]
    partials = engine.framework.principal
    counts = len(channels), len(actuators), len(partials)
    return counts, (*chain(*channels), *chain(*actuators), *chain(*partials))
