"""When nothing plays the daemon rests, and wakes for whatever may sound."""

from __future__ import annotations

import threading

import numpy as np

from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.timing import AWAKE_S, QUIET_S, SILENT_S, IdlePolicy
from audioflinger_hook.daemon.wake import Wake
from audioflinger_hook.service.meters import BufferedLevelMeter
from audioflinger_hook.sources import PushTap, TapClient

RATE_HZ = 48_000
NOBODY: frozenset[int] = frozenset()


def rests_after(rest: IdlePolicy, began_s: float, players: frozenset[int], sound_s: float) -> float:
    """The time from `began_s` at which it rests, asked ten times a second."""
    for tick in range(1_000):
        now_s = began_s + 0.1 * tick
        if rest.update(now_s, players, sound_s, heard=False):
            return now_s
    raise AssertionError("it never rests")


def test_it_rests_soon_if_nothing_plays_and_later_if_something_silent_does() -> None:
    assert rests_after(IdlePolicy(0.0), 100.0, NOBODY, 100.0) - 100.0 < QUIET_S + 0.2
    rest = IdlePolicy(0.0)
    rest.update(99.0, frozenset({1}), 99.0, heard=False)
    assert SILENT_S < rests_after(rest, 100.0, frozenset({1}), 100.0) - 100.0 < SILENT_S + 0.2


def test_after_its_start_it_stays_awake_for_a_while() -> None:
    assert rests_after(IdlePolicy(0.0), 0.0, NOBODY, -100.0) > AWAKE_S


def test_a_stream_that_comes_wakes_it_and_so_does_sound_but_not_a_stream_that_goes() -> None:
    rest = IdlePolicy(0.0)
    rests_after(rest, 10.0, frozenset({1, 2}), 10.0)
    assert rest.update(50.0, frozenset({2}), 10.0, heard=False)
    assert rest.update(51.0, frozenset({2}), 10.0, heard=False)
    assert not rest.update(52.0, frozenset({2}), 10.0, heard=True)
    rests_after(rest, 53.0, frozenset({2}), 10.0)
    assert not rest.update(80.0, frozenset({2, 3}), 10.0, heard=False)
    assert not rest.update(80.0 + AWAKE_S - 0.1, frozenset({2, 3}), 10.0, heard=False)


def test_sound_keeps_it_awake() -> None:
    rest = IdlePolicy(0.0)
    for second in range(100):
        assert not rest.update(float(second), NOBODY, second - 1.0, heard=False)


def engine() -> tuple[PushTap, Engine]:
    tap = PushTap(RATE_HZ, 2)
    return tap, Engine(TapClient(tap), RATE_HZ, clocks=Clocks(lambda: 0.0, lambda: 0.0))


def play(tap: PushTap, engine: Engine, level: float, seconds: float, from_s: float) -> float:
    """Play a tone, and return when it ends."""
    blocks = int(seconds * RATE_HZ / 256)
    for block in range(blocks):
        at = (block * 256 + np.arange(256)) / RATE_HZ
        wave = (level * np.sin(2.0 * np.pi * 110.0 * at)).astype(np.float32)
        tap.push(np.column_stack([wave, wave]))
        engine.advance(from_s + block * 256 / RATE_HZ)
    return from_s + blocks * 256 / RATE_HZ


def test_the_engine_tells_when_it_last_heard_sound_and_when_the_vibration_has_faded() -> None:
    tap, live = engine()
    ended_s = play(tap, live, 0.3, 1.0, 0.0)
    assert abs(live.last_sound_s - ended_s) < 0.1
    assert not live.faded
    play(tap, live, 0.0, 2.0, ended_s)
    assert abs(live.last_sound_s - ended_s) < 0.1
    assert live.faded


def test_gathered_levels_are_those_of_the_frames() -> None:
    gathered = BufferedLevelMeter(RATE_HZ)
    rng = np.random.default_rng(0)
    for count in [*rng.integers(1, 600, 2_000), 5_000]:
        gathered.add(np.full((count, 1), 0.5, np.float32))
    level = gathered.meter.level()
    assert abs(level.peak_dbfs + 6.02) < 0.01
    assert abs(level.rms_dbfs + 6.02) < 0.01
    assert gathered.loudest == 0.5


def test_the_other_output_rate_begins_another_delay_line_and_keeps_the_effect() -> None:
    tap, live = engine()
    play(tap, live, 0.3, 0.5, 0.0)
    before = live.delay_line
    live.retarget(RATE_HZ)
    assert live.delay_line is before
    live.retarget(44_100)
    assert live.delay_line.samplerate_out == 44_100
    play(tap, live, 0.3, 0.5, 0.5)
    assert live.vibration.loudest > 0.05


def test_a_change_of_the_taps_format_goes_on_in_the_same_mix() -> None:
    tap, live = engine()
    play(tap, live, 0.3, 0.5, 0.0)
    assert tap.change(44_100, 1)
    mono = (0.3 * np.sin(2.0 * np.pi * 110.0 * np.arange(22_050) / 44_100)).astype(np.float32)
    for first in range(0, 22_050 - 256, 256):
        tap.push(mono[first : first + 256, np.newaxis])
        live.advance(1.0)
    assert live.samplerate == RATE_HZ
    assert live.vibration.loudest > 0.05


def test_a_ring_ends_the_present_rest_or_the_next_one() -> None:
    with Wake() as wake:
        assert not wake.wait(0.0)
        wake.ring()
        wake.ring()
        assert wake.wait(10.0)
        assert not wake.wait(0.0)
        threading.Thread(target=wake.ring).start()
        assert wake.wait(10.0)
    wake.ring()
