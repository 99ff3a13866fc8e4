import itertools
import threading
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.live_memory import WRITES_LEFT, live_memory
from audioflinger_hook.daemon.timing import AWAKE_S, QUIET_S, SILENT_S, IdlePolicy, Wake
from audioflinger_hook.service.meters import FLOOR_DBFS, BufferedLevelMeter
from audioflinger_hook.sources import PushTap, TapClient
from device.drive import ActuatorSettings
from device.units import Float32Array
from tests.support.commands import noise

RATE_HZ = 48_000
STILL = Clocks(lambda: 0.0, lambda: 0.0)
SLOW_S = 0.05  # ten times a buffer, from one look at a clock to the next


@pytest.mark.parametrize(
    ("now_step_s", "used_step_s", "bypass_late", "bypassed"),
    [(SLOW_S, 0.0, True, False), (SLOW_S, SLOW_S, True, True), (SLOW_S, SLOW_S, False, False)],
)
def test_an_effect_is_passed_by_for_its_own_time(now_step_s, used_step_s, bypass_late, bypassed):
    now, used = itertools.count(), itertools.count()
    clocks = Clocks(lambda: now_step_s * next(now), lambda: used_step_s * next(used))
    tap = PushTap(RATE_HZ, 2)
    engine = Engine(TapClient(tap), RATE_HZ, clocks=clocks, bypass_late=bypass_late)
    for number in range(20):
        tap.push(noise(256, 2, number).astype(np.float32))
        assert engine.advance(number * 256 / RATE_HZ)
    assert bool(engine.framework.bypassed()) is bypassed


def test_a_buffer_too_short_for_a_frame_of_the_mix_waits_for_the_next():
    tap = PushTap(RATE_HZ, 1)
    client = TapClient(tap)
    engine = Engine(client, RATE_HZ, clocks=STILL)
    tap.change(8 * RATE_HZ, 1)
    for _ in range(80):
        tap.push(np.zeros((1, 1), np.float32))
        assert engine.advance(0.0)
    assert (engine.frames, client.buffers) == (10, 80)
    tap.end()
    assert len(engine.finish(0.0)) >= engine.framework.latency_frames
    assert not engine.advance(0.0)


def kept(engine: Engine) -> list[Float32Array]:
    """A list that gets whatever goes into the engine's delay line."""
    written: list[Float32Array] = []
    into_line = engine.delay_line.write

    def write(vibration, now_s, earlier=()):
        written.append(vibration.copy())
        into_line(vibration, now_s, earlier)

    engine.delay_line.write = write  # type: ignore[method-assign]
    return written


def heard(settings: Settings | None, seconds: float = 0.4) -> tuple[Engine, Float32Array]:
    tap = PushTap(RATE_HZ, 2)
    engine = Engine(TapClient(tap), RATE_HZ, settings, clocks=STILL)
    written = kept(engine)
    for number in range(round(seconds * RATE_HZ / 256)):
        tap.push(0.3 * noise(256, 2, number).astype(np.float32))
        assert engine.advance(number * 256 / RATE_HZ)
    tap.end()
    written.append(engine.finish(0.0))
    return engine, np.concatenate(written)


def test_protection_passes_the_same_vibration_on_later_and_damping_another_one():
    plain, usual = heard(None)
    assert plain.drive.processors == (None,)
    engine, protected = heard(Settings(protection="on"))
    late = engine.drive.latency_frames
    assert late == 192
    assert usual.any()
    assert np.array_equal(protected[late:], usual)
    assert not protected[:late].any()
    processor: Any = engine.drive.processors[0]
    assert processor.protection().limited_blocks == 0
    engine, damped = heard(Settings(damping="auto"))
    assert not np.array_equal(damped[192:], usual)
    assert np.isfinite(damped).all()
    assert engine.vibration.loudest == plain.vibration.loudest  # what levels are told


def test_what_protection_holds_when_it_goes_to_rest_does_not_come_with_the_next_sound():
    tap = PushTap(RATE_HZ, 1)
    engine = Engine(TapClient(tap), RATE_HZ, Settings(protection="on"), clocks=STILL)
    processor: Any = engine.drive.processors[0]
    engine.drive.process(np.full((256, 1), 0.5, np.float32))
    blocks = processor.protection().blocks
    engine.rest()
    assert not engine.drive.process(np.zeros((256, 1), np.float32)).any()
    assert processor.protection().blocks > blocks  # counts go on


LEFT = ActuatorSettings((0,), "left")
RIGHT = ActuatorSettings((1,), "right", polarity="inverted", delay_ms=10.0)


def test_actuators_get_their_sources_and_what_is_recorded_is_the_vibration_before_them():
    _, each = heard(Settings(channels="each"))
    engine, driven = heard(Settings(actuators=(RIGHT, LEFT)))
    assert (engine.drive.processors, engine.drive.outputs) == ((None, None), 2)
    assert engine.framework.haptic_channels == 2
    assert np.array_equal(driven[: len(each), 1], each[:, 0])
    late = engine.drive.delays_frames[0]
    assert late == 480
    assert np.array_equal(driven[late:, 0], -each[:, 1])
    assert not driven[:late, 0].any()
    out = np.zeros((256, 2), np.float32)
    engine.fill(out, 0.0)
    assert np.isfinite(out).all()
    assert engine.read_ahead.shape[1] == 2


def test_actuators_follow_another_order_and_each_one_s_level_is_told():
    tap = PushTap(RATE_HZ, 2)
    engine = Engine(TapClient(tap), RATE_HZ, Settings(actuators=(LEFT, RIGHT)), clocks=STILL)
    sent = kept(engine)
    wave = 0.3 * np.sin(2.0 * np.pi * 110.0 * np.arange(RATE_HZ) / RATE_HZ).astype(np.float32)
    for start in range(0, RATE_HZ // 256 * 256, 256):
        if start == 94 * 256:
            silent = ActuatorSettings((0,), "left", gain_db=-60.0)
            engine.follow(Settings(actuators=(silent, RIGHT)))
        tap.push(np.column_stack([wave[start : start + 256]] * 2))
        engine.advance(start / RATE_HZ)
    before, after = np.concatenate(sent[60:94]), np.concatenate(sent[-60:])
    assert np.abs(after[:, 0]).max() == pytest.approx(1e-3 * np.abs(before[:, 0]).max(), rel=0.1)
    assert np.abs(after[:, 1]).max() == pytest.approx(np.abs(before[:, 1]).max(), rel=0.1)
    quiet, loud = (gathered.meter.level() for gathered in engine.driven)
    # Half a second on, with a time constant of 0.3 s for the power: 7 dB.
    assert quiet.rms_dbfs == pytest.approx(loud.rms_dbfs - 7.2, abs=1.0)
    engine.rest()
    assert engine.driven[1].meter.level().rms_dbfs == FLOOR_DBFS
    assert not engine.drive.process(np.zeros((2_000, 2), np.float32)).any()


NOBODY: frozenset[int] = frozenset()


def rests_after(rest: IdlePolicy, began_s: float, players: frozenset[int], sound_s: float) -> float:
    """The time from `began_s` at which it rests, asked ten times a second."""
    for tick in range(1_000):
        now_s = began_s + 0.1 * tick
        if rest.update(now_s, players, sound_s, heard=False):
            return now_s
    raise AssertionError("it never rests")


def test_it_rests_soon_or_later_and_not_in_sound_and_wakes_by_a_new_stream_or_by_sound():
    assert rests_after(IdlePolicy(0.0), 100.0, NOBODY, 100.0) - 100.0 < QUIET_S + 0.2
    assert rests_after(IdlePolicy(0.0), 0.0, NOBODY, -100.0) > AWAKE_S  # it has just begun
    rest = IdlePolicy(0.0)
    rest.update(99.0, frozenset({1}), 99.0, heard=False)
    assert SILENT_S < rests_after(rest, 100.0, frozenset({1}), 100.0) - 100.0 < SILENT_S + 0.2
    rest = IdlePolicy(0.0)
    assert not any(rest.update(now_s, NOBODY, now_s - 1.0, heard=False) for now_s in range(100))
    rest = IdlePolicy(0.0)
    rests_after(rest, 10.0, frozenset({1, 2}), 10.0)
    assert rest.update(50.0, frozenset({2}), 10.0, heard=False)
    assert rest.update(51.0, frozenset({2}), 10.0, heard=False)
    assert not rest.update(52.0, frozenset({2}), 10.0, heard=True)
    rests_after(rest, 53.0, frozenset({2}), 10.0)
    assert not rest.update(80.0, frozenset({2, 3}), 10.0, heard=False)
    assert not rest.update(80.0 + AWAKE_S - 0.1, frozenset({2, 3}), 10.0, heard=False)


def test_gathered_levels_are_those_of_the_frames():
    gathered = BufferedLevelMeter(RATE_HZ)
    for count in [*np.random.default_rng(0).integers(1, 600, 2_000), 5_000]:
        gathered.add(np.full((count, 1), 0.5, np.float32))
    level = gathered.meter.level()
    assert (level.peak_dbfs, level.rms_dbfs) == pytest.approx((-6.02, -6.02), abs=0.01)
    assert gathered.loudest == 0.5


def test_a_ring_ends_the_present_rest_or_the_next_one():
    with Wake() as wake:
        assert not wake.wait(0.0)
        wake.ring()
        wake.ring()
        assert wake.wait(10.0)
        assert not wake.wait(0.0)
        threading.Thread(target=wake.ring).start()
        assert wake.wait(10.0)
    wake.ring()


LONG = 1024  # longer than the time between two writes


def engine_with(folder, channels=2, actuators=2):
    settings = Settings(actuators=tuple(ActuatorSettings((number,)) for number in range(actuators)))
    engine = Engine(TapClient(PushTap(RATE_HZ, channels)), RATE_HZ, settings, clocks=STILL)
    engine.live = live_memory(folder, RATE_HZ, channels, len(engine.driven_meters))
    return engine


def watched(engine: Engine, blocks: int, level: float = 0.3) -> None:
    tap = engine._client._tap  # type: ignore[attr-defined]
    for _ in range(blocks):
        number = engine.buffers
        tone = level * np.sin(2.0 * np.pi * 440.0 * ((number * LONG + np.arange(LONG)) / RATE_HZ))
        tap.push(np.outer(tone, 1.0 / (1.0 + np.arange(engine.channels))).astype(np.float32))
        assert engine.advance(number * LONG / RATE_HZ)


def test_the_engine_tells_when_it_last_heard_sound_and_when_the_vibration_has_faded():
    engine = engine_with(None)
    for blocks, level in ((50, 0.3), (100, 0.0)):
        watched(engine, blocks, level)
        assert abs(engine.last_sound_s - 50 * LONG / RATE_HZ) < 0.1
        assert engine.faded == (level == 0.0)


@pytest.mark.parametrize("actuators", [0, 2])
def test_a_watched_page_reads_what_the_engine_measured(tmp_path, actuators):
    engine = engine_with(tmp_path, actuators=actuators)
    engine.live.watch()
    watched(engine, 48)
    (channels, driven, partials), numbers = engine.live.page.reader.shown()
    sound = engine.sound.meter.channel_readings()
    vibration = [meter.reading() for meter in engine.driven_meters]
    principal = engine.framework.principal
    assert (channels, driven, partials) == (2, max(1, actuators), len(principal))
    assert partials > 0
    expected = [value for group in (*sound, *vibration, *principal) for value in group]
    assert (numbers, engine.live.page.frames) == (pytest.approx(expected), engine.frames)


def test_nothing_is_written_while_nobody_watches_or_that_the_file_cannot_hold(tmp_path):
    engine = engine_with(tmp_path)
    watched(engine, 8)
    assert engine.live.page.frames == 0
    engine.live.watch()
    watched(engine, 4 * WRITES_LEFT)
    written = engine.live.page.frames
    assert 0 < written < engine.frames
    watched(engine, 8)
    assert engine.live.page.frames == written
    assert engine_with(tmp_path, channels=9).live is None
    assert engine_with(None).live is None
    assert engine_with(tmp_path / "none").live is None
    engine.live.close()  # each engine has a file of its own, and old ones are removed
    (tmp_path / "python-99.page").touch()
    first, second = engine_with(tmp_path), engine_with(tmp_path)
    assert first.live.page.path != second.live.page.path
    assert list(tmp_path.iterdir()) == [second.live.page.path]
    for one in (first, second, second):
        one.live.close()
    assert not list(tmp_path.iterdir())
