"""What a page shows many times a second, as a line of JSON.

Each frame is computed after a pause in which other programs used the processor's caches. So it
costs what it touches: numbers are read at once and put into one form at once. What an engine shows
lies in memory as well, where a client of this computer reads it without the daemon.
"""

from __future__ import annotations

from functools import cache
from itertools import chain

from audioflinger_hook.daemon.engine import Engine
from audioflinger_hook.daemon.native.layout import Shown
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.service.state import DaemonState

_IN_MEMORY = (
    b'{"frame": {"state": "%s", "level": %.4g, '
    b'"memory": {"name": "%s", "channels": %d, "actuators": %d}, "missed": %d}}\n'
)


def frame_of(
    supervisor: Supervisor, level: float, missed: int, *, in_memory: bool
) -> tuple[bytes, bool]:
    """Return `{"frame": ...}` with a line break, and whether the next one may come later.

    Any thread may call it; audio threads do not wait for it. The frame has the numbers of `Shown`,
    or for a client that reads them in memory the file of the engine that plays.

    level: factor on the vibration, 0 while it is muted. missed: frames that were not sent.
    """
    state = supervisor.states.state
    plays = state is DaemonState.RUNNING
    native, engine = supervisor.engines.native.engine, supervisor.engines.python
    chain = native.chain if native is not None and native.audible else None
    page = chain.page if chain is not None else None
    if page is None and in_memory and engine is not None and engine.live is not None:
        engine.live.watch()
        page = engine.live.page
    shown: Shown = ((0, 0, 0), ())
    if page is not None and in_memory:
        name, reader = page.path.name.encode(), page.reader
        counts = reader.channels, reader.actuators
        return _IN_MEMORY % (state.value.encode(), level, name, *counts, missed), True
    if page is not None and plays:
        shown = page.reader.shown()
    elif engine is not None and plays:
        shown = _shown_of(engine)
    return _form(*shown[0]) % (state.value.encode(), level, *shown[1], missed), not plays


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
    actuators = [meter.reading() for meter in engine.driven_meters]
    partials = engine.framework.principal
    counts = len(channels), len(actuators), len(partials)
    return counts, (*chain(*channels), *chain(*actuators), *chain(*partials))
