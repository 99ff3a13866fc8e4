"""Sinks that declare a delay: on PipeWire an ALSA sink without a card, on PulseAudio a tunnel."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from tests.servers.daemons import program
from tests.servers.listening import RATE_HZ, Arrivals, wait_for
from tests.support.data import text
from tools.live_latency.bursts import APART_S, GraphOnce, onsets
from tools.sound_server import SoundServer

SLOW, BEHIND = "slow", "behind"
PORT = 34_571


class DeclaringSink:
    """The sink SLOW of PipeWire, which declares `delay_s` and a cycle of buffer, as cards do.

    It drives the graph of what is played to it, so that monitors of other sinks are not late.
    """

    def __init__(self, server: SoundServer, delay_s: float) -> None:
        self._server = server
        properties = {
            "factory.name": "api.alsa.pcm.sink",
            "library.name": "alsa/libspa-alsa",
            "node.name": SLOW,
            "media.class": "Audio/Sink",
            "api.alsa.path": "null",
            "audio.rate": RATE_HZ,
            "audio.channels": 2,
            "audio.position": "FL,FR",
            "priority.driver": 20_000,
            "object.linger": True,
            "latency.internal.ns": round(1e9 * delay_s),
        }
        self._cli("create-node", "adapter", json.dumps(properties))
        wait_for(lambda: SLOW in server.names("sinks"), "the slow sink")

    def declare(self, delay_s: float, by: str = "ProcessLatency") -> None:
        """Declare another delay, by ProcessLatency or by Props (latencyOffsetNsec)."""
        name = {"ProcessLatency": "ns", "Props": "latencyOffsetNsec"}[by]
        node = wait_for(lambda: GraphOnce(self._server.environment).read().sink(SLOW), "the node")
        self._cli("set-param", str(node.id), by, f"{{ {name} = {round(1e9 * delay_s)} }}")

    def _cli(self, *command: str) -> None:
        subprocess.run(
            ["pw-cli", *command],
            env=self._server.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            timeout=10.0,
            check=True,
        )


DELAYING = text("delaying-sink.conf")


@contextmanager
def delaying_sink(server: SoundServer, delay_s: float) -> Iterator[None]:
    """The sink SLOW of PipeWire 1.6, which delays sound to the sink BEHIND and declares that."""
    server.add_sink(BEHIND)
    conf = server.folder / "delaying.conf"
    conf.write_text(DELAYING.format(delay_s=delay_s, SLOW=SLOW, BEHIND=BEHIND))
    with program(server.environment, "pipewire", "-c", str(conf), stdout=None):
        wait_for(lambda: SLOW in server.names("sinks"), "the slow sink")
        yield


def add_tunnel(server: SoundServer, delay_s: float) -> None:
    """Add the sink SLOW of PulseAudio: it declares its delay and plays to the sink BEHIND."""
    server.add_sink(BEHIND)
    listen = (f"port={PORT}", "listen=127.0.0.1", "auth-anonymous=1")
    server.pactl("load-module", "module-native-protocol-tcp", *listen)
    remote = (f"server=tcp:127.0.0.1:{PORT}", f"sink={BEHIND}", f"latency_msec={1e3 * delay_s:.0f}")
    server.pactl("load-module", "module-tunnel-sink", f"sink_name={SLOW}", *remote)
    wait_for(lambda: SLOW in server.names("sinks"), "the tunnel")


def lags_ms(heard: Arrivals, felt: Arrivals, after_s: float) -> list[float]:
    """How late each burst is felt, in ms, but for those of the first `after_s` of the recording.

    A burst is felt from half of its peak on.
    """
    sound = heard.frames()[:, 0].astype(np.float64)
    vibration = np.abs(felt.frames()[:, 0])
    middle = len(vibration) // 2
    middle_s, found = felt.at_s(middle), []
    near = round(0.45 * APART_S * RATE_HZ)
    for onset in onsets(sound, RATE_HZ):
        if onset < after_s * RATE_HZ:
            continue
        heard_s = heard.at_s(onset)
        at = middle + round((heard_s - middle_s) * RATE_HZ)
        part = vibration[max(0, at - near) : at + near]
        if len(part) < 2 * near or part.max() < 1e-3:
            continue
        first = at - near + int(np.argmax(part >= 0.5 * part.max()))
        found.append(1e3 * (felt.at_s(first) - heard_s))
    peaks = np.abs(sound).max(initial=0.0), vibration.max(initial=0.0)
    print(
        f"{len(found)} bursts are felt; peaks of sound and vibration {peaks[0]:.2f}, {peaks[1]:.2f}"
    )
    return found
