import math
import sys
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon import capture_queue
from audioflinger_hook.daemon.capture_queue import CaptureQueue, Feed, SoundGain, undone_db
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.run_config import Change, RunConfig, changes_between, words_of
from audioflinger_hook.sources import PushTap, TapAddress, TapClient
from audioflinger_hook.transform import TransformParameters
from device.address import DeviceAddress
from device.clock import DelayState
from device.drive import ActuatorSettings
from device.errors import UsageError
from device.units import Float32Array

RATE_HZ = 48_000
BLOCK = 256
BLOCK_S = BLOCK / RATE_HZ
STILL = Clocks(lambda: 0.0, lambda: 0.0)


class Live:
    """A feed and its engine between two streams; keeps what was mixed, felt and played."""

    def __init__(self, feed: Feed, settings: Settings | None = None) -> None:
        self.feed = feed
        self.mixed: list[Float32Array] = []
        self.felt: list[Float32Array] = []
        self.played: list[Float32Array] = []
        told: Any = {"clocks": STILL, "block_frames": BLOCK, "on_step": self._stepped}
        self.engine = Engine(feed.client(RATE_HZ, 2), RATE_HZ, settings, **told)
        feed.serve(self.engine)
        feed.opened(RATE_HZ, 2)

    def _stepped(self, audio: Float32Array, vibration: Float32Array, now_s: float) -> None:
        self.mixed.append(audio.copy())
        self.felt.append(vibration.copy())

    def fill(self, now_s: float, frames: int = BLOCK) -> None:
        out = np.zeros((frames, 1), np.float32)
        self.engine.fill(out, now_s)
        self.played.append(out)

    def run(self, sound: Float32Array, late_s: Float32Array) -> None:
        """Both streams go on; block n is delivered late_s[n] after its time, but in order."""
        delivered_s = np.maximum.accumulate(BLOCK_S * np.arange(1, len(late_s) + 1) + late_s)
        begun = 0
        for read in range(1, len(late_s)):
            read_s = (read + 0.37) * BLOCK_S
            while begun < len(late_s) and delivered_s[begun] <= read_s:
                at = begun * BLOCK
                self.feed.push(sound[at : at + BLOCK], float(delivered_s[begun]))
                begun += 1
            self.fill(read_s)


def music(seconds: float) -> Float32Array:
    at = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    wave = 0.3 * np.sin(2.0 * np.pi * 440.0 * at) * (0.6 + 0.4 * np.sin(2.0 * np.pi * 3.0 * at))
    return np.column_stack([wave, wave]).astype(np.float32)


def lateness(blocks: int, jitter_s: float) -> Float32Array:
    late = np.random.default_rng(5).gamma(1.0, max(jitter_s, 1e-12), blocks)
    return np.minimum(late, 0.02).astype(np.float32)


def live_after(seconds: float, feed: Feed | None = None, jitter_s: float = 0.0) -> Live:
    sound, live = music(seconds), Live(feed or CaptureQueue())
    live.run(sound, lateness(len(sound) // BLOCK, jitter_s))
    return live


@pytest.mark.sweep
@pytest.mark.parametrize("jitter_s", [0.0, 0.001, 0.003])
def test_what_is_felt_is_the_same_and_comes_at_the_same_time(jitter_s):
    at_once, when_needed = (live_after(6.0, feed, jitter_s) for feed in (Feed(), CaptureQueue()))
    felt, expected = np.concatenate(when_needed.felt), np.concatenate(at_once.felt)
    assert felt.tobytes() == expected[: len(felt)].tobytes()
    assert len(expected) - len(felt) < 0.05 * RATE_HZ  # what the output did not need yet
    one, other = (live.engine.delay_line.status for live in (at_once, when_needed))
    assert (other.underflows, other.resyncs) == (one.underflows, one.resyncs)
    assert other.state is one.state
    assert other.delay_s == pytest.approx(one.delay_s, abs=0.0002)
    # Played at the same moments, to a tenth of a millisecond: what the clocks learn comes later.
    heard, wanted = np.concatenate(when_needed.played)[:, 0], np.concatenate(at_once.played)[:, 0]
    assert np.abs(heard - wanted)[2 * RATE_HZ :].max() < 0.1 * np.abs(wanted).max()


def test_what_the_delay_line_has_is_read_at_once_and_that_is_not_taken_for_haste():
    sound, live = music(6.0), Live(CaptureQueue())
    reads: list[tuple[int, int]] = []
    read = live.engine.delay_line.read

    def counted(out: Float32Array, now_s: float, ahead: int = 0) -> int:
        reads.append((len(out), ahead))
        return read(out, now_s, ahead)

    live.engine.delay_line.read = counted  # type: ignore[method-assign]
    live.run(sound, lateness(len(sound) // BLOCK, 0.0))
    lengths = [len(part) for part in live.mixed[-40:]]
    assert np.mean(lengths) >= 2 * BLOCK  # blocks become one cycle
    assert max(lengths) <= live.engine.frames_max
    status = live.engine.delay_line.status
    assert (status.state, status.underflows) == (DelayState.LOCKED, 0)
    assert len(live.played) >= 2 * len(reads[-200:])
    assert np.mean([frames for frames, _ in reads[-200:]]) >= 2 * BLOCK
    assert all(frames - ahead == BLOCK for frames, ahead in reads)
    at_once = live_after(6.0, Feed())
    targets_s = [one.engine.delay_line.status.target_s for one in (live, at_once)]
    assert targets_s[0] == pytest.approx(targets_s[1], abs=0.0002)


def test_what_was_read_ahead_of_a_gap_is_not_played_after_it():
    live = live_after(3.0)
    while not len(live.engine.read_ahead):
        live.fill(live.engine.filled_s + BLOCK_S)
    stale = live.engine.read_ahead[:BLOCK, 0].copy()
    assert np.abs(stale).max() > 0.0
    live.fill(live.engine.filled_s + 1.0)
    assert not np.array_equal(live.played[-1][:, 0], stale)


@given(st.lists(st.integers(1, 1_500), min_size=20, max_size=60))
@examples(max_examples=10, deadline=None)
def test_requests_of_any_sizes_get_every_frame_once_and_in_order(sizes):
    live = live_after(3.0)
    taken: list[Float32Array] = []
    read = live.engine.delay_line.read

    def kept(out: Float32Array, now_s: float, ahead: int = 0) -> int:
        count = read(out, now_s, ahead)
        taken.append(out[:count].copy())
        return count

    live.engine.delay_line.read = kept  # type: ignore[method-assign]
    held, before, now_s = live.engine.read_ahead.copy(), len(live.played), 3.0
    for frames in sizes:
        live.fill(now_s, frames)
        now_s += frames / RATE_HZ
    out = np.concatenate(live.played[before:])
    assert out.tobytes() == np.concatenate([held, *taken])[: len(out)].tobytes()


def test_long_delays_do_not_let_sound_wait_for_more_than_a_cycle():
    sound, live = music(4.0), Live(CaptureQueue())
    live.engine.delay_line.offset_s = 0.5
    live.run(sound, lateness(len(sound) // BLOCK, 0.0))
    assert len(sound) // BLOCK * BLOCK - live.engine.frames <= live.engine.frames_max + BLOCK


def test_without_an_output_or_when_its_stream_moves_or_is_reopened_sound_is_mixed_at_once():
    live = Live(CaptureQueue())
    live.fill(0.0)
    sound = music(1.0)
    for block in range(100):
        live.feed.push(sound[block * BLOCK : (block + 1) * BLOCK], block * BLOCK_S)
        if block * BLOCK_S > capture_queue.UNASKED_S:
            assert live.engine.frames == (block + 1) * BLOCK
    live = Live(CaptureQueue())
    live.fill(0.0)
    live.feed.push(np.full((BLOCK, 2), 0.5, np.float32), 0.001)
    assert live.engine.frames == 0
    live.feed.moved()
    assert live.engine.frames == BLOCK
    live.feed.push(np.full((BLOCK, 2), 0.5, np.float32), 0.002)
    assert live.feed.opened(44_100, 1)
    live.feed.push(np.full((441, 1), 0.25, np.float32), 0.1)
    assert live.engine.frames - BLOCK == pytest.approx(480, abs=48)
    assert np.concatenate(live.mixed[1:]).max() <= 0.3


def test_two_threads_lose_nothing_and_keep_the_order():
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        feed = CaptureQueue()
        live, blocks, ended = Live(feed), 3_000, threading.Event()

        def play() -> None:
            while not ended.is_set():
                live.fill(live.engine.filled_s + BLOCK_S if live.engine.filled_s > 0.0 else 1.0)

        output = threading.Thread(target=play)
        output.start()
        for block in range(blocks):
            # Now and then later than the output asks, so that both threads mix.
            now_s = live.engine.filled_s + (0.2 if block % 5 == 0 else 0.0)
            feed.push(np.full((BLOCK, 2), block / blocks, np.float32), now_s)
        ended.set()
        output.join()
        feed.pull()
    finally:
        sys.setswitchinterval(interval_s)
    assert live.engine.frames == blocks * BLOCK
    firsts = np.concatenate(live.mixed)[::BLOCK, 0]
    assert np.array_equal(firsts, np.arange(blocks, dtype=np.float32) / np.float32(blocks))


def test_a_jump_takes_back_what_would_have_been_read_ahead():
    """The output loses 40 ms: what is read then, late, ends sooner than what was there before."""
    live, sound = Live(CaptureQueue()), music(8.0)
    for block in range(len(sound) // BLOCK):
        now_s = (block + 1) * BLOCK_S
        live.feed.push(sound[block * BLOCK : (block + 1) * BLOCK], now_s)
        if not 4.0 <= now_s < 4.04:
            live.fill(now_s + 0.4 * BLOCK_S)
    status = live.engine.delay_line.status
    assert (status.resyncs, status.underflows) == (1, 0)
    assert status.delay_s == pytest.approx(status.target_s, abs=0.001)


def test_a_volume_is_undone_over_one_buffer_and_no_sample_goes_over_full_scale():
    gain, frames = SoundGain(), np.full((100, 2), 0.1, np.float32)
    assert gain.apply(frames) is frames
    gain.wanted = 10.0
    assert len(gain.apply(np.zeros((0, 2), np.float32))) == 0  # the change is yet to come
    changing, after = gain.apply(frames), gain.apply(frames)
    steps = np.diff(changing[:, 0])
    assert np.all(steps > 0.0)
    assert np.ptp(steps) < 1e-6
    assert (changing[0, 0], changing[-1, 0]) == (pytest.approx(0.109), pytest.approx(1.0, rel=1e-6))
    assert after == pytest.approx(1.0, rel=1e-6)
    gain = SoundGain()
    gain.wanted = 1000.0
    assert gain.apply(np.full((4, 1), 0.5, np.float32)).max() == 1.0
    assert gain.apply(np.full((4, 1), -0.5, np.float32)).min() == -1.0
    gain.wanted = 1.0
    gain.apply(np.ones((4, 1), np.float32))
    assert gain.apply(np.full((4, 1), 1.5, np.float32)).max() == 1.5


@pytest.mark.parametrize(("server", "limit_db"), [("PulseAudio", 40.0), ("PipeWire", 80.0)])
@pytest.mark.parametrize("volume_db", [-math.inf, -200.0, -80.0, -60.0, -20.0, 11.0])
def test_a_volume_is_undone_as_far_as_the_servers_samples_bear(volume_db, server, limit_db):
    assert undone_db(volume_db, server) == max(volume_db, -limit_db)


MUSIC = music(1.0)
ORDER = RunConfig(TapAddress("default"), DeviceAddress("sink", "a"), Settings(), LiveSettings())


def wishing(**settings: Any) -> RunConfig:
    return replace(ORDER, settings=Settings(**settings))


def living(**live: Any) -> RunConfig:
    return replace(ORDER, live=LiveSettings(**live))


BOTH = LEFT, RIGHT = ActuatorSettings((0,), "left"), ActuatorSettings((1,), "right")
SOFTER = replace(LEFT, gain_db=-3.0, polarity="inverted", delay_ms=4.0, channels=(3,))
SWAPPED = (replace(LEFT, source="right"), replace(RIGHT, source="left"))
EVERYTHING, TRANSFORM = "the effects", "the transform"


@pytest.mark.parametrize(
    ("order", "changed", "words"),
    [
        *((ORDER, "", "nothing"), (wishing(gain_db=-3.0), "level", "the level")),
        (wishing(parameters=TransformParameters(partials_max=3)), "transform", TRANSFORM),
        (wishing(profile="game"), "transform", TRANSFORM),
        (wishing(form="reference", gain_db=-1.0), "level engine", f"the level, {EVERYTHING}"),
        (wishing(channels="each"), "engine", EVERYTHING),
        (wishing(effects_file=Path("x")), "engine", EVERYTHING),
        (replace(ORDER, tap=TapAddress("sink", "b")), "tap", "the tap"),
        (replace(ORDER, device=DeviceAddress("sink", "b")), "device", "the device"),
        (living(offset_ms=5.0), "offset", "the offset"),
        (living(device_volume_db=-6.0), "volume", "the device's volume"),
    ],
)
def test_an_order_changes_what_is_another_in_it(order, changed, words):
    found = changes_between(ORDER, order)
    assert {change.name.lower() for change in found} == {*changed.split()}
    assert words_of(found) == words


@pytest.mark.parametrize(
    ("before", "after", "changed"),
    [
        *(((LEFT,), (LEFT,), set()), (BOTH, (SOFTER, RIGHT), {Change.ACTUATORS})),
        (BOTH, SWAPPED, {Change.ACTUATORS}),
        (BOTH, (LEFT, replace(RIGHT, source="left")), {Change.ENGINE}),
        *(((LEFT,), BOTH, {Change.ENGINE}), ((), (LEFT,), {Change.ENGINE})),
        ((LEFT,), (), {Change.ENGINE}),
        ((LEFT,), (replace(LEFT, rig="consumer"),), {Change.ENGINE}),
        ((LEFT,), (replace(LEFT, damping="auto", gain_db=-1.0),), {Change.ENGINE}),
        ((LEFT,), (replace(LEFT, protection="on"),), {Change.ENGINE}),
    ],
)
def test_actuators_follow_while_they_play_unless_others_are_to_be_there(before, after, changed):
    found = changes_between(wishing(actuators=before), wishing(actuators=after))
    assert found == changed
    assert (words_of(found) == "the actuators") == (changed == {Change.ACTUATORS})


def hear(live: Live, blocks: range) -> Float32Array:
    begun = len(live.felt)
    for block in blocks:
        live.feed.push(MUSIC[block * BLOCK : (block + 1) * BLOCK], block * BLOCK_S)
    return np.concatenate(live.felt[begun:])[:, 0]


def rms(frames: Float32Array) -> float:
    return float(np.sqrt(np.mean(np.square(frames, dtype=np.float64))))


def test_other_parameters_fade_the_vibration_out_and_begin_anew():
    live, top = Live(Feed()), TransformParameters(vibration_top_hz=120.0)
    hear(live, range(90))
    live.engine.framework.change(Settings(parameters=top))
    vibration = hear(live, range(90, 180))
    assert np.abs(vibration[: BLOCK // 2]).max() > 1e-3
    assert abs(vibration[BLOCK - 1]) < 1e-6
    # It begins anew: as another effect that first hears the rest of the music.
    fresh = Live(Feed(), Settings(parameters=top))
    assert np.array_equal(vibration[BLOCK:], hear(fresh, range(91, 180)))
    assert rms(vibration[-RATE_HZ // 10 :]) > 1e-2


def test_of_many_changes_between_two_blocks_the_last_one_counts():
    live, plain = Live(Feed()), Live(Feed())
    for gain_db in (*range(-60, 0), -20):
        live.engine.framework.change(Settings(gain_db=float(gain_db)))
    vibration, loud = hear(live, range(180)), hear(plain, range(180))
    assert rms(vibration[BLOCK:]) == pytest.approx(0.1 * rms(loud[BLOCK:]), rel=0.05)
    assert live.engine.framework.mixer.failed_events == 0


def test_parameters_that_the_mix_cannot_have_are_refused_and_nothing_changes():
    narrow = Settings(parameters=TransformParameters(band_high_hz=3_000.0))
    low = Engine(TapClient(PushTap(1_000, 1)), 1_000, narrow, clocks=STILL).framework
    wrong = TransformParameters(band_low_hz=600.0, band_high_hz=1_900.0, window_s=0.2)
    with pytest.raises(UsageError, match="1000 Hz"):
        low.change(Settings(parameters=wrong))
    assert low.settings == narrow
    assert low.mixer.cycle(0.0).frames_written


@pytest.mark.parametrize(("samplerate", "block"), [(RATE_HZ, 1_024), (44_100, BLOCK)])
def test_other_blocks_or_rates_take_another_delay_line_with_the_same_offset(samplerate, block):
    live = Live(Feed())
    hear(live, range(40))
    live.engine.delay_line.offset_s = 0.1
    before = live.engine.delay_line
    live.engine.retarget(RATE_HZ, BLOCK)
    assert live.engine.delay_line is before
    live.engine.retarget(samplerate, block)
    after = live.engine.delay_line
    assert after is not before
    assert (after.samplerate_out, after.offset_s) == (samplerate, 0.1)
    assert after.status.target_s > 0.1 + 2.5 * block / RATE_HZ
    assert rms(hear(live, range(40, 80))) > 1e-3
