"""Levels and partials that the live page shows, as JSON."""

from functools import cache
from itertools import chain

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
    """Return a line `{"frame": ...}` of JSON, and whether the next line may be delayed.

    in_memory: whether the line may name the file of levels and partials instead of listing them.
    level: gain of the vibration, 0 while muted. missed: number of lines that were not sent. Any
    thread may call it.
    """
    state = supervisor.states.state
    plays = state is DaemonState.RUNNING
    native, engine = supervisor.engines.native.engine, supervisor.engines.python
    playing = native.chain if native is not None and native.audible else None
    page = playing.page if playing is not None else None
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
        channels = engine.sound.meter.channel_readings()
        actuators = [meter.reading() for meter in engine.driven_meters]
        partials = engine.framework.principal
        numbers = (*chain(*channels), *chain(*actuators), *chain(*partials))
        shown = (len(channels), len(actuators), len(partials)), numbers
    return _form(*shown[0]) % (state.value.encode(), level, *shown[1], missed), not plays


@cache
def _form(channels: int, actuators: int, partials: int) -> bytes:
    pairs, triples = "[%.4g, %.4g]", "[%.5g, %.5g, %.4g]"
    return (
        '{"frame": {"state": "%s", "level": %.4g, '
        f'"sound": [{", ".join([pairs] * channels)}], '
        f'"vibration": [{", ".join([pairs] * actuators)}], '
        f'"partials": [{", ".join([triples] * partials)}], '
        '"missed": %d}}\n'
    ).encode()
