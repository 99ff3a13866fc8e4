"""Effects for tests: an engine that writes down its calls, buffers of noise, running chains."""

from uuid import UUID

import numpy as np

from audioflinger_hook.effect import interface
from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.registry import EffectLibrary
from audioflinger_hook.mixer.mix_buffer import MixBuffer

RATE = 48_000
FRAMES = 960
CYCLE_S = FRAMES / RATE


class FakeClock:
    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def descriptor(name="Probe", number=1, flags=interface.EffectFlag.INSERT, **more):
    return interface.EffectDescriptor(
        UUID(int=1000), UUID(int=number), name, "tests", flags, **more
    )


class Probe:
    """An engine that writes down what reaches it, and does what a test tells it to."""

    def __init__(self, name="Probe", number=1, flags=interface.EffectFlag.INSERT, **more):
        self.descriptor = descriptor(name, number, flags, **more)
        self.seen = []
        self.replies = {}
        self.act = lambda source, target: interface.OK

    def process(self, source, target):
        self.seen.append("process")
        return self.act(source, target)

    def command(self, code, data=None):
        self.seen.append(interface.Command(code).name if code in list(interface.Command) else code)
        reply = self.replies.get(code, (interface.OK, None))
        return reply() if callable(reply) else reply

    def take(self):
        seen, self.seen = self.seen, []
        return seen


ECHO_UUID = UUID("7d7cb2f0-4bc6-4f0e-9a60-3b1a7c7f1a02")
ECHO = interface.EffectDescriptor(UUID(int=1000), ECHO_UUID, "Echo", "tests")
LIBRARY = EffectLibrary("echoes", ((ECHO, Probe),))
"""A library beside the bundled one."""


def config(
    samplerate=RATE, channels=2, haptic_channels=1, frames=FRAMES, access=interface.Access.WRITE
):
    return interface.EffectConfig(samplerate, channels, haptic_channels, frames, access)


def noise(frames=FRAMES, channels=2, haptic_channels=1, seed=0, level=0.1):
    """A buffer of noise, in its haptic channels too: what is stale there must not pass."""
    buffer = MixBuffer(frames, channels, haptic_channels)
    buffer.samples[:] = level * np.random.default_rng(seed).standard_normal(buffer.samples.size)
    return buffer


def running(*engines, clock=None, session=0, cfg=None, **chains_options):
    chains = EffectChains(clock or FakeClock(), **chains_options)
    cfg = cfg or config()
    chains.set_format(cfg.samplerate, cfg.channels, cfg.haptic_channels, cfg.frames)
    modules = [chains.add(engine, session) for engine in engines]
    for module in modules:
        assert module.enable() == interface.OK
    chains.end_of_cycle(0.0)
    assert all(module.state.name == "ACTIVE" for module in modules)
    return (chains, *modules)
