"""Engines that other tests of the framework use, and what they themselves must be."""

from __future__ import annotations

from types import NoneType
from uuid import UUID

import numpy as np
import pytest

from audioflinger_hook.effect.chain import EffectChains
from audioflinger_hook.effect.interface import (
    EINVAL,
    ENODATA,
    ENOSYS,
    OK,
    Access,
    Command,
    EffectConfig,
    EffectDescriptor,
    EffectFlag,
    Parameter,
    VendorCommand,
)
from audioflinger_hook.effect.registry import EffectLibrary
from audioflinger_hook.mixer.mix_buffer import MixBuffer

RATE = 48_000
FRAMES = 960
CYCLE_S = FRAMES / RATE


class FakeClock:
    """Seconds that pass only where a test says so."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


def descriptor(name="Probe", number=1, flags=EffectFlag.INSERT, **more):
    return EffectDescriptor(UUID(int=1000), UUID(int=number), name, "tests", flags, **more)


class Probe:
    """An engine that writes down what reaches it, and does what a test tells it to."""

    def __init__(self, name="Probe", number=1, flags=EffectFlag.INSERT, **more):
        self.descriptor = descriptor(name, number, flags, **more)
        self.seen = []
        self.replies = {}
        self.act = lambda source, target: OK

    def process(self, source, target):
        self.seen.append("process")
        return self.act(source, target)

    def command(self, code, data=None):
        self.seen.append(Command(code).name if code in list(Command) else code)
        reply = self.replies.get(code, (OK, None))
        return reply() if callable(reply) else reply

    def take(self):
        """Return what has reached it since the last time."""
        seen, self.seen = self.seen, []
        return seen


DELAY = EffectDescriptor(
    UUID("7d7cb2f0-4bc6-4f0e-9a60-3b1a7c7f1a01"),
    UUID("7d7cb2f0-4bc6-4f0e-9a60-3b1a7c7f1a02"),
    "Delay",
    "tests",
    EffectFlag.INSERT | EffectFlag.INSERT_FIRST,
    parameters=(
        Parameter("feedback", float, 0.5, 0.0, 0.9),
        Parameter("held_frames", int),
    ),
    vendor_commands=(VendorCommand(0x1_0000, "FREEZE", NoneType),),
)


class Delay:
    """An echo: a second, small effect with a tail, after DISABLE, of its delay line's length."""

    descriptor = DELAY
    DELAY_FRAMES = 2_000

    def __init__(self):
        self._feedback = 0.5
        self._running = False
        self._config: EffectConfig | None = None
        self._line = np.zeros((self.DELAY_FRAMES, 0), np.float32)
        self._at = 0

    def process(self, source, target):
        frames = source.frames
        out = source.audio.copy()
        for frame in range(frames):
            echo = self._line[self._at].copy()
            out[frame] += echo
            fresh = source.audio[frame] if self._running else 0.0
            self._line[self._at] = self._feedback * (fresh + echo)
            self._at = (self._at + 1) % self.DELAY_FRAMES
        assert self._config is not None
        if self._config.access is Access.ACCUMULATE:
            target.audio += out
            target.haptic += source.haptic
        else:
            target.audio[:] = out
        if not self._running and np.abs(self._line).max() < 1e-3:
            return ENODATA
        return OK

    def command(self, code, data=None):
        match code:
            case Command.SET_CONFIG:
                if data.channels > 2:
                    return EINVAL, None
                self._config = data
                self._clear()
            case Command.RESET:
                self._clear()
            case Command.ENABLE | Command.DISABLE:
                self._running = code == Command.ENABLE
            case Command.SET_PARAM:
                self._feedback = data[1]
            case Command.GET_PARAM:
                held = int(np.count_nonzero(self._line)) if self._config else 0
                return OK, self._feedback if data == "feedback" else held
            case Command.INIT | 0x1_0000:
                pass
            case _:
                return ENOSYS, None
        return OK, None

    def _clear(self):
        assert self._config is not None
        self._line = np.zeros((self.DELAY_FRAMES, self._config.channels), np.float32)
        self._at = 0


LIBRARY = EffectLibrary("echoes", ((DELAY, Delay),))


def config(samplerate=RATE, channels=2, haptic_channels=1, frames=FRAMES, access=Access.WRITE):
    return EffectConfig(samplerate, channels, haptic_channels, frames, access)


def noise(frames=FRAMES, channels=2, haptic_channels=1, seed=0, level=0.1):
    """A buffer of noise, in its haptic channels too: what is stale there must not pass."""
    buffer = MixBuffer(frames, channels, haptic_channels)
    rng = np.random.default_rng(seed)
    buffer.samples[:] = level * rng.standard_normal(buffer.samples.size)
    return buffer


def running(*engines, clock=None, session=0, cfg=None, **chains_options):
    """Chains in which engines run, and their modules."""
    chains = EffectChains(clock or FakeClock(), **chains_options)
    cfg = cfg or config()
    chains.set_format(cfg.samplerate, cfg.channels, cfg.haptic_channels, cfg.frames)
    modules = [chains.add(engine, session) for engine in engines]
    for module in modules:
        assert module.enable() == OK
    chains.end_of_cycle(0.0)
    assert all(module.state.name == "ACTIVE" for module in modules)
    return (chains, *modules)


def test_a_delay_is_heard_a_delay_later():
    chains, _ = running(Delay())
    buffer = MixBuffer(FRAMES, 2, 1)
    buffer.audio[0] = 1.0, -0.5
    heard = []
    for cycle in range(5):
        chains.process(0, buffer, cycle * CYCLE_S)
        heard.append(buffer.audio.copy())
        chains.end_of_cycle(cycle * CYCLE_S)
        buffer.clear()
    made = np.concatenate(heard)
    (when,) = np.nonzero(made[:, 0])
    assert when.tolist() == [0, 2_000, 4_000]
    assert made[when].tolist() == [[1.0, -0.5], [0.5, -0.25], [0.25, -0.125]]


def test_a_stopped_delay_goes_on_with_its_tail_until_it_has_ended_and_is_then_reset():
    chains, delay = running(Delay())
    chains.process(0, noise(), 0.0)
    delay.disable()
    assert delay.state.name == "STOPPING"
    heard, states = [], []
    for cycle in range(40):
        buffer = MixBuffer(FRAMES, 2, 1)
        chains.process(0, buffer, cycle * CYCLE_S)
        chains.end_of_cycle(cycle * CYCLE_S)
        heard.append(np.abs(buffer.audio).max())
        states.append(delay.state.name)
    ended = states.index("IDLE")
    assert 10 < ended < 39
    assert set(states[:ended]) == {"STOPPED"}
    assert max(heard[:3]) > 0.1
    assert heard[ended + 1 :] == [0.0] * (39 - ended)
    assert delay.command(Command.GET_PARAM, "held_frames") == (OK, 0)


def test_a_tail_that_does_not_end_is_cut_off_after_ten_seconds_of_sound():
    probe = Probe()
    chains, module = running(probe)
    module.disable()
    chains.end_of_cycle(0.0)
    cycles = 0
    while module.state.name == "STOPPED":
        chains.process(0, noise(), 0.0)
        chains.end_of_cycle(0.0)
        cycles += 1
    assert cycles * CYCLE_S == pytest.approx(10.0)
    assert probe.take()[-1] == "RESET"


def test_a_delay_accumulates_what_it_makes_into_another_buffer():
    separate, delay = running(Delay(), session=7)
    in_place, _ = running(Delay(), session=7)
    own, mix, same = noise(seed=1), noise(seed=2), noise(seed=1)
    before = mix.samples.copy()
    separate.process(7, own, 0.0, mix)
    in_place.process(7, same, 0.0)
    assert delay.access is Access.ACCUMULATE
    np.testing.assert_array_equal(mix.samples, before + same.samples)


def test_a_delay_that_refuses_a_stream_is_passed_by_until_one_is_accepted():
    chains, delay = running(Delay())
    chains.set_format(RATE, 6, 1, FRAMES)
    assert chains.bypassed() == [
        "session 0, Delay: refused 48000 Hz, 6 + 1 channels, 960 frames, write (status -22)"
    ]
    buffer = noise(channels=6)
    before = buffer.samples.copy()
    chains.process(0, buffer, 0.0)
    assert buffer.samples.tobytes() == before.tobytes()
    assert delay.refusals == 1
    chains.set_format(44_100, 1, 1, FRAMES)
    assert chains.bypassed() == []
    buffer = noise(channels=1)
    for _ in range(4):
        chains.process(0, buffer, 0.0)
    assert delay.buffers == 4
