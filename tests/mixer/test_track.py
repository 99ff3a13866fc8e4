"""Tracks: their states, start threshold, underruns, ramps, draining, and what is refused."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from audioflinger_hook.mixer import CycleReport, Mixer, MixerState, PcmFormat, Track, TrackState
from audioflinger_hook.mixer.track import Request, after
from audioflinger_hook.mixer.track_mixer import RETRIES
from device.errors import UsageError

RATE = 48_000
FRAMES = 960


class Player:
    """A mixer with one track, stepped by hand."""

    def __init__(self, rate: int = RATE, channels: int = 2, **options) -> None:
        self.mixer = Mixer(RATE, 2)
        self.track = self.mixer.create_track("one", PcmFormat.FLOAT, rate, channels, **options)
        self.cycles = 0
        self.report: CycleReport

    def cycle(self, count: int = 1) -> np.ndarray:
        """The sound of so many cycles, (frames, 2)."""
        heard: list[np.ndarray] = []
        for _ in range(count):
            self.report = self.mixer.cycle(self.cycles * FRAMES / RATE)
            self.cycles += 1
            heard.append(self.report.buffer.audio.copy())
        return np.concatenate(heard)


# calls, because mypy takes an attribute once compared for unchanged
def stands(player: Player) -> TrackState:
    return player.track.state


def found(player: Player) -> MixerState:
    return player.report.state


def noise(frames: int, channels: int = 2, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (frames, channels)).astype(np.float32)


def test_nothing_is_heard_before_the_start_and_before_the_threshold_is_filled() -> None:
    player = Player(ring_frames=4 * FRAMES, start_threshold=3 * FRAMES)
    sound = noise(4 * FRAMES)
    player.track.write(sound[: 3 * FRAMES - 1])
    player.cycle()
    assert found(player) is MixerState.STANDBY
    player.track.start()
    player.cycle(3)
    assert found(player) is MixerState.ENABLED
    assert player.report.underruns == player.track.underruns == 0
    player.track.write(sound[3 * FRAMES - 1 : 3 * FRAMES])
    np.testing.assert_array_equal(player.cycle(), sound[:FRAMES])
    # once started it needs only a period
    np.testing.assert_array_equal(player.cycle(2), sound[FRAMES : 3 * FRAMES])
    assert player.track.underruns == 0


def test_the_ring_takes_what_fits_and_by_default_has_to_be_full_before_it_sounds() -> None:
    player = Player()
    track, sound = player.track, noise(3 * FRAMES)
    assert track.start_threshold == track.ring.capacity_frames == 2 * FRAMES
    track.start()
    assert track.write(sound[:100]) == 100
    assert not player.cycle().any()
    assert track.write(sound[100:]) == 2 * FRAMES - 100
    assert track.write(sound) == track.ring.room == 0
    assert track.frames_ready == 2 * FRAMES
    assert player.cycle().any()


def test_a_starving_track_is_skipped_counted_and_continues_where_it_was() -> None:
    player = Player(ring_frames=4 * FRAMES, start_threshold=FRAMES)
    sound = noise(4 * FRAMES)
    player.track.start()
    player.track.write(sound[: FRAMES + 500])
    player.cycle()
    assert not player.cycle().any()
    assert player.report.underruns == 1
    assert found(player) is MixerState.ENABLED
    assert (player.track.underruns, player.track.underrun_frames) == (1, FRAMES)
    assert player.track.frames_ready == 500
    player.track.write(sound[FRAMES + 500 : 2 * FRAMES])
    np.testing.assert_array_equal(player.cycle(), sound[FRAMES : 2 * FRAMES])


def test_fifty_missed_cycles_in_a_row_disable_a_track_until_it_writes_again() -> None:
    player = Player(start_threshold=FRAMES)
    track = player.track
    track.start()
    track.write(noise(FRAMES))
    player.cycle(RETRIES)  # one played, 49 missed
    assert not track.disabled
    track.write(noise(FRAMES))
    player.cycle(RETRIES)  # the row was broken
    assert not track.disabled
    player.cycle()
    assert track.disabled
    assert track.underruns == 2 * RETRIES - 1
    underruns = track.underruns
    player.cycle(10)
    assert track.underruns == underruns
    assert found(player) is MixerState.IDLE
    track.write(noise(FRAMES - 1))
    player.cycle()
    assert not track.disabled
    track.write(noise(1))
    assert player.cycle().any()


def test_a_track_that_was_disabled_fills_up_to_its_threshold_again() -> None:
    player = Player(start_threshold=2 * FRAMES)
    player.track.write(noise(2 * FRAMES))
    player.track.start()
    player.cycle(2 + RETRIES)
    assert player.track.disabled
    player.track.write(noise(2 * FRAMES - 1))
    assert not player.cycle(3).any()
    assert not player.track.disabled
    assert player.track.underruns == RETRIES, "to fill up is no underrun"
    player.track.write(noise(1))
    assert player.cycle().any()


def test_a_track_that_never_fills_up_does_not_keep_the_mixer_awake() -> None:
    player = Player()
    player.track.start()
    player.cycle(RETRIES)
    assert player.track.disabled
    assert player.track.underruns == 0
    player.cycle(200)
    assert found(player) is MixerState.STANDBY


def steady(player: Player) -> np.ndarray:
    """Play a constant 1 until it is heard, and keep the ring full."""
    ones = np.ones((player.track.ring.room, player.track.channels), np.float32)
    player.track.write(ones)
    player.track.start()
    player.cycle()
    player.track.write(ones)
    return ones


def test_pause_ramps_down_over_one_buffer_and_resume_up_over_one() -> None:
    player = Player()
    ones = steady(player)
    player.track.pause()
    assert stands(player) is TrackState.PAUSING
    rise = np.arange(FRAMES, dtype=np.float32) / np.float32(FRAMES)
    falling = player.cycle()
    np.testing.assert_allclose(falling[:, 0], 1 - rise, rtol=0, atol=1e-6)
    assert stands(player) is TrackState.PAUSED
    kept = player.track.frames_ready
    assert not player.cycle(5).any()
    assert player.track.frames_ready == kept
    assert found(player) is MixerState.IDLE
    player.track.start()
    assert stands(player) is TrackState.RESUMING
    np.testing.assert_allclose(player.cycle()[:, 1], rise, rtol=0, atol=1e-6)
    assert stands(player) is TrackState.ACTIVE
    player.track.write(ones)
    assert (player.cycle() == 1.0).all()


@pytest.mark.parametrize("rate", [RATE, 44_100])
def test_pause_and_resume_make_no_click(rate: int) -> None:
    player = Player(rate, ring_frames=4_000)
    steady(player)
    player.cycle(2)
    heard: list[np.ndarray] = []
    for cycle in range(60):
        if cycle in (10, 30):
            player.track.pause()
        if cycle in (20, 31):
            player.track.start()
        player.track.write(np.ones((player.track.ring.room, 2), np.float32))
        heard.append(player.cycle())
    steps = np.abs(np.diff(np.concatenate(heard), axis=0))
    # the steepest ramp is 1 over one buffer; float32 and the resampler's ripple on top
    assert steps.max() < 1.05 / FRAMES
    assert player.track.underruns == 0


def test_a_starved_track_that_is_paused_is_paused_and_still_ramps_up() -> None:
    player = Player()
    ones = steady(player)
    player.cycle(3)
    player.track.pause()
    player.cycle()
    assert stands(player) is TrackState.PAUSED
    player.track.write(ones)
    player.track.start()
    assert (player.cycle()[0] == 0.0).all()


def test_pause_and_start_between_two_cycles_change_nothing() -> None:
    player = Player()
    steady(player)
    player.track.pause()
    player.track.start()
    assert (player.cycle() == 1.0).all()
    assert stands(player) is TrackState.ACTIVE


@pytest.mark.parametrize("extra", [0, 1, 500, FRAMES - 1, FRAMES, FRAMES + 1])
def test_stop_plays_every_frame_and_pads_the_last_buffer(extra: int) -> None:
    player = Player(ring_frames=3 * FRAMES, start_threshold=1)
    sound = noise(FRAMES + extra)
    player.track.write(sound)
    player.track.start()
    player.track.stop()
    assert stands(player) is TrackState.STOPPING
    heard = player.cycle(3)
    np.testing.assert_array_equal(heard[: len(sound)], sound)
    assert not heard[len(sound) :].any()
    assert stands(player) is TrackState.STOPPED
    assert player.track.frames_ready == 0
    assert player.track.underruns == 0


@pytest.mark.parametrize("rate", [RATE, 44_100])
def test_after_the_last_frame_comes_silence_and_nothing_of_earlier_turns_of_the_ring(rate) -> None:
    # a ring that is no multiple of the period, so that periods lie across its end
    player = Player(rate, ring_frames=1_300, start_threshold=1)
    player.track.start()
    for _ in range(12):
        player.track.write(np.ones((player.track.ring.room, 2), np.float32))
        player.cycle()
    player.track.stop()
    left = player.track.frames_ready * RATE // rate
    heard = player.cycle(4)
    # behind the last frame only the resampler's tail
    assert not heard[left + 160 :].any()
    assert np.abs(heard[: left - 160]).min() > 0.5


def test_stop_plays_what_never_reached_the_start_threshold() -> None:
    player = Player()
    sound = noise(10)
    player.track.write(sound)
    player.track.start()
    player.cycle()
    player.track.stop()
    np.testing.assert_array_equal(player.cycle()[:10], sound)


@pytest.mark.parametrize("rate", [44_100, 96_000, 8_000, 47_999])
def test_stop_brings_out_what_the_resampler_holds(rate: int) -> None:
    # as long as whole periods, so that the tail needs one more
    count = 3 * FRAMES * rate // RATE
    player = Player(rate, ring_frames=2 * count, start_threshold=1)
    # low-passed noise away from the edges: what comes out is what went in
    window = np.hanning(count)[:, None].astype(np.float32)
    player.track.write(noise(count) * window)
    player.track.start()
    player.track.stop()
    heard = player.cycle(6)
    assert stands(player) is TrackState.STOPPED
    # the mean passes a resampler as it is, if nothing is cut off
    expected = (noise(count) * window).sum(axis=0, dtype=np.float64) / rate
    np.testing.assert_allclose(heard.sum(axis=0, dtype=np.float64) / RATE, expected, atol=1e-7)


def test_what_is_written_after_a_stop_waits_for_the_next_start() -> None:
    player = Player(ring_frames=4 * FRAMES, start_threshold=FRAMES)
    first, second = noise(100, seed=1), noise(FRAMES, seed=2)
    player.track.write(first)
    player.track.start()
    player.track.stop()
    player.track.write(second)
    heard = player.cycle(3)
    np.testing.assert_array_equal(heard[:100], first)
    assert not heard[100:].any()
    player.track.start()
    np.testing.assert_array_equal(player.cycle(), second)


def test_a_flush_drops_what_was_written_before_it_and_nothing_else() -> None:
    player = Player(ring_frames=4 * FRAMES, start_threshold=FRAMES)
    player.track.write(noise(FRAMES, seed=1))
    player.track.flush()
    after_it = noise(FRAMES, seed=2)
    player.track.write(after_it)
    assert stands(player) is TrackState.FLUSHED
    player.track.start()
    np.testing.assert_array_equal(player.cycle(), after_it)


def test_a_playing_track_ignores_a_flush() -> None:
    player = Player()
    steady(player)
    player.track.flush()
    assert stands(player) is TrackState.ACTIVE
    assert (player.cycle() == 1.0).all()


@pytest.mark.parametrize("end", ["pause", "stop"])
def test_pause_or_stop_and_flush_in_one_go_ramp_down_first(end: str) -> None:
    player = Player(ring_frames=8 * FRAMES)
    steady(player)
    getattr(player.track, end)()
    player.track.flush()
    assert stands(player) is TrackState.FLUSHED
    heard = player.cycle(3)[:, 0]
    assert heard[0] == 1.0, "goes on where it was"
    assert np.abs(np.diff(heard)).max() < 1.05 / FRAMES
    assert player.track.frames_ready == 0
    assert stands(player) is TrackState.FLUSHED
    # a flushed track starts anew: no ramp
    player.track.write(np.ones((8 * FRAMES, 2), np.float32))
    player.track.start()
    assert (player.cycle() == 1.0).all()


def test_a_stop_from_a_pause_drops_what_is_left() -> None:
    player = Player()
    steady(player)
    player.track.pause()
    player.track.stop()
    player.cycle(2)
    assert stands(player) is TrackState.STOPPED
    assert player.track.frames_ready == 0


def test_a_removed_track_ramps_down_and_is_gone() -> None:
    player = Player()
    steady(player)
    player.mixer.remove_track(player.track)
    heard = player.cycle(2)[:, 0]
    assert heard[0] == 1.0, "goes on where it was"
    assert np.abs(np.diff(heard)).max() < 1.05 / FRAMES
    assert player.mixer.tracks == ()
    player.mixer.remove_track(player.track)
    player.cycle()


def test_a_track_removed_after_its_stop_still_plays_to_its_end() -> None:
    player = Player(ring_frames=3 * FRAMES, start_threshold=1)
    sound = noise(2 * FRAMES + 5)
    player.track.write(sound)
    player.track.start()
    player.track.stop()
    player.mixer.remove_track(player.track)
    np.testing.assert_array_equal(player.cycle(3)[: len(sound)], sound)
    player.cycle()
    assert player.mixer.tracks == ()


def test_a_new_volume_is_reached_over_exactly_one_buffer() -> None:
    player = Player(ring_frames=6 * FRAMES)
    steady(player)
    player.track.set_volume((0.5, 7.0))
    changing, steady_again = player.cycle(), player.cycle()
    assert changing[0, 0] == 1.0
    assert (np.diff(changing[:, 0]) < 0).all()
    assert (changing[:, 1] == 1.0).all()
    assert (steady_again == [0.5, 1.0]).all()


def test_wrong_volumes_are_refused() -> None:
    track = Player().track
    with pytest.raises(UsageError, match=r"0 gains .* 'one'"):
        track.set_volume(())
    with pytest.raises(UsageError, match="65 gains"):
        track.set_volume([1.0] * 65)
    assert track.volume == (1.0,)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"samplerate": 999}, ["samplerate=999 Hz: want 1000 to 768000 Hz"]),
        ({"samplerate": 768_001}, ["samplerate=768001 Hz"]),
        ({"samplerate": 48_000.0}, ["samplerate=48000.0 is not a whole number"]),
        ({"samplerate": True}, ["samplerate=True"]),
        (
            {"channels": 65, "ring_frames": 959, "session": -4, "pcm_format": "mp3"},
            ["'t'", "'mp3'", "channels=65: want 1 to 64", "ring_frames=959: want at least 960",
             "session=-4"],
        ),
        ({"start_threshold": 1_921}, ["start_threshold=1921: want 1 to 1920"]),
    ],
)  # fmt: skip
def test_a_wrong_track_is_refused_with_everything_that_is_wrong(
    wrong: dict[str, Any], said: list[str]
) -> None:
    mixer = Mixer(RATE, 2)
    good: dict[str, Any] = {"pcm_format": PcmFormat.FLOAT, "samplerate": RATE, "channels": 2}
    with pytest.raises(UsageError) as refused:
        mixer.create_track("t", **(good | wrong))
    for part in said:
        assert part in str(refused.value)
    assert mixer.tracks == ()


def test_a_track_that_changes_its_format_is_refused_and_plays_on() -> None:
    player = Player()
    ones = steady(player)
    for other in (ones.astype(np.float64), np.ones((10, 3), np.float32), b"\0" * 13):
        with pytest.raises(UsageError):
            player.track.write(other)
    assert (player.cycle() == 1.0).all()


@pytest.mark.parametrize("state", list(TrackState))
@pytest.mark.parametrize("request_made", list(Request))
def test_every_request_has_an_answer_in_every_state(state, request_made) -> None:
    reached = after(state, request_made)
    assert after(reached, request_made) is reached, "asking again changes nothing"
    if request_made is Request.PAUSE:
        assert reached is not TrackState.ACTIVE
    if request_made is Request.FLUSH:
        assert reached in (TrackState.FLUSHED, state)


def test_one_thread_writes_while_another_mixes_and_no_frame_is_lost() -> None:
    player = Player(ring_frames=2_000, start_threshold=FRAMES)
    sound = np.arange(1, 60 * FRAMES + 1, dtype=np.float32)[:, None] @ np.ones((1, 2), np.float32)

    def client() -> None:
        sent = 0
        player.track.start()
        while sent < len(sound):
            sent += player.track.write(sound[sent : sent + 333])
        player.track.stop()

    thread = threading.Thread(target=client)
    thread.start()
    heard: list[np.ndarray] = []
    while player.track.mixed_state is not TrackState.STOPPED and player.cycles < 1_000_000:
        audio = player.cycle()[:, 0]
        if player.report.tracks_mixed:
            heard.append(audio)
    thread.join()
    played = np.concatenate(heard)
    np.testing.assert_array_equal(played[: len(sound)], sound[:, 0])
    assert not played[len(sound) :].any()


class AnyClient(RuleBasedStateMachine):
    """Whatever a client does, in any order: frames come out once, in order, or were dropped."""

    def __init__(self) -> None:
        super().__init__()
        self.player = Player(ring_frames=2_500, start_threshold=1_000)
        self.track: Track = self.player.track
        self.sent = 0
        self.heard_last = 0

    @rule(count=st.integers(0, 3_000))
    def write(self, count: int) -> None:
        # frame number n has the value n, exact in float32
        values = np.arange(self.sent + 1, self.sent + 1 + count, dtype=np.float32)
        taken = self.track.write(np.repeat(values[:, None], 2, axis=1))
        assert taken == min(count, taken + self.track.ring.room)
        self.sent += taken

    @rule()
    def start(self) -> None:
        self.track.start()

    @rule()
    def pause(self) -> None:
        self.track.pause()

    @rule()
    def stop(self) -> None:
        self.track.stop()

    @rule()
    def flush(self) -> None:
        self.track.flush()

    @rule(count=st.integers(1, 4))
    def cycle(self, count: int) -> None:
        for _ in range(count):
            was = self.track.ring.read
            before = self.track.mixed_state
            audio = self.player.cycle()[:, 0]
            report = self.player.report
            assert report.tracks_mixed in (0, 1)
            if not report.tracks_mixed:
                assert not audio.any()
                continue
            ramped = TrackState.PAUSED in (before, self.track.mixed_state) or (
                before is TrackState.RESUMING
            )
            if not ramped and audio[0]:
                sounding = audio[audio != 0.0]
                expected = np.arange(sounding[0], sounding[0] + len(sounding))
                np.testing.assert_array_equal(sounding, expected)
                assert sounding[0] > self.heard_last
                self.heard_last = sounding[-1]
            assert self.track.ring.read > was

    @precondition(lambda self: self.track.requests)
    @rule()
    def settle(self) -> None:
        """What the client sees is where the mixer gets to, given time and frames."""
        seen = self.track.state
        for _ in range(4):
            self.player.cycle()
        reached = {
            TrackState.PAUSING: {TrackState.PAUSED},
            TrackState.RESUMING: {TrackState.RESUMING, TrackState.ACTIVE},
            TrackState.STOPPING: {TrackState.STOPPED},
        }
        assert self.track.mixed_state in reached.get(seen, {seen})
        assert not self.track.requests

    @invariant()
    def the_ring_is_bounded_and_adds_up(self) -> None:
        ring = self.track.ring
        assert 0 <= self.track.frames_ready <= ring.capacity_frames
        assert ring.written == self.sent
        assert ring.read <= ring.written


TestAnyClient = AnyClient.TestCase
TestAnyClient.settings = settings(max_examples=120, stateful_step_count=30, deadline=None)
