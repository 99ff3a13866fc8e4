import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from audioflinger_hook.mixer import CycleReport, Mixer, PcmFormat, Track, TrackState
from audioflinger_hook.mixer.track_mixer import RETRIES
from device.errors import UsageError
from tests.support.taps import noise

RATE = 48_000
FRAMES = 960
STEEPEST = 1.05 / FRAMES
"""A ramp from 1 to 0 over one buffer; float32 and the resampler's ripple on top."""


class Player:
    def __init__(self, rate: int = RATE, *, sound: Any = None, **options) -> None:
        """Sound: what is written, whose first frame may sound, and played to its end."""
        self.mixer = Mixer(RATE, 2)
        if sound is not None:
            options = {"ring_frames": 2 * FRAMES + len(sound), "start_threshold": 1} | options
        self.track = self.mixer.create_track("one", PcmFormat.FLOAT, rate, 2, **options)
        self.cycles = 0
        self.report: CycleReport
        if sound is not None:
            self.track.write(sound)
            self.track.start()
            self.track.stop()

    def cycle(self, count: int = 1) -> np.ndarray:
        heard: list[np.ndarray] = []
        for _ in range(count):
            self.report = self.mixer.cycle(self.cycles * FRAMES / RATE)
            self.cycles += 1
            heard.append(self.report.buffer.audio.copy())
        return np.concatenate(heard)


def test_nothing_is_heard_before_the_start_and_before_the_threshold_is_filled():
    player = Player(ring_frames=4 * FRAMES, start_threshold=3 * FRAMES)
    sound = noise(4 * FRAMES)
    player.track.write(sound[: 3 * FRAMES - 1])
    player.cycle()
    assert player.report.state.name == "STANDBY"
    player.track.start()
    player.cycle(3)
    assert player.report.state.name == "ENABLED"
    assert player.report.underruns == player.track.underruns == 0
    player.track.write(sound[3 * FRAMES - 1 : 3 * FRAMES])
    np.testing.assert_array_equal(player.cycle(), sound[:FRAMES])
    # once started it needs only a period
    np.testing.assert_array_equal(player.cycle(2), sound[FRAMES : 3 * FRAMES])
    assert player.track.underruns == 0


def test_the_ring_takes_what_fits_and_by_default_has_to_be_full_before_it_sounds():
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


def test_a_starving_track_is_skipped_counted_and_continues_where_it_was():
    player = Player(ring_frames=4 * FRAMES, start_threshold=FRAMES)
    sound = noise(4 * FRAMES)
    player.track.start()
    player.track.write(sound[: FRAMES + 500])
    player.cycle()
    assert not player.cycle().any()
    assert (player.report.underruns, player.report.state.name) == (1, "ENABLED")
    assert (player.track.underruns, player.track.underrun_frames) == (1, FRAMES)
    assert player.track.frames_ready == 500
    player.track.write(sound[FRAMES + 500 : 2 * FRAMES])
    np.testing.assert_array_equal(player.cycle(), sound[FRAMES : 2 * FRAMES])


def test_fifty_missed_cycles_in_a_row_disable_a_track_until_it_fills_up_to_its_threshold_again():
    player = Player(start_threshold=2 * FRAMES)
    track = player.track
    track.start()
    track.write(noise(2 * FRAMES))
    player.cycle(RETRIES)  # two played, 48 missed
    assert not track.disabled
    track.write(noise(FRAMES))
    player.cycle(RETRIES)  # the row was broken
    assert not track.disabled
    player.cycle()
    assert track.disabled
    assert track.underruns == 2 * RETRIES - 2
    player.cycle(10)
    assert player.report.state.name == "IDLE"
    track.write(noise(2 * FRAMES - 1))
    assert not player.cycle(3).any()
    assert not track.disabled
    assert track.underruns == 2 * RETRIES - 2, "neither to be disabled nor to fill up is one"
    track.write(noise(1))
    assert player.cycle().any()


def steady(**options: int) -> Player:
    """A track that is heard as a constant 1, with a full ring."""
    player = Player(**options)
    player.track.start()
    for _ in range(2):
        fill(player)
        player.cycle()
    fill(player)
    return player


def fill(player: Player) -> None:
    player.track.write(np.ones((player.track.ring.room, 2), np.float32))


def test_pause_ramps_down_over_one_buffer_and_resume_up_over_one():
    player = steady()
    player.track.pause()
    assert player.track.state.name == "PAUSING"
    rise = np.arange(FRAMES, dtype=np.float32) / np.float32(FRAMES)
    np.testing.assert_allclose(player.cycle()[:, 0], 1 - rise, rtol=0, atol=1e-6)
    assert player.track.state.name == "PAUSED"
    kept = player.track.frames_ready
    assert not player.cycle(5).any()
    assert (player.track.frames_ready, player.report.state.name) == (kept, "IDLE")
    player.track.start()
    assert player.track.state.name == "RESUMING"
    np.testing.assert_allclose(player.cycle()[:, 1], rise, rtol=0, atol=1e-6)
    assert player.track.state.name == "ACTIVE"
    fill(player)
    assert (player.cycle() == 1.0).all()


@pytest.mark.parametrize("rate", [RATE, 44_100])
def test_pause_and_resume_make_no_click(rate):
    player = steady(rate=rate, ring_frames=4_000)
    heard: list[np.ndarray] = []
    for cycle in range(60):
        if cycle in (10, 30):
            player.track.pause()
        if cycle in (20, 31):
            player.track.start()
        fill(player)
        heard.append(player.cycle())
    assert np.abs(np.diff(np.concatenate(heard), axis=0)).max() < STEEPEST
    assert player.track.underruns == 0


def test_a_starved_track_that_is_paused_is_paused_and_still_ramps_up():
    player = steady()
    player.cycle(3)
    player.track.pause()
    player.cycle()
    assert player.track.state.name == "PAUSED"
    fill(player)
    player.track.start()
    assert (player.cycle()[0] == 0.0).all()


@pytest.mark.parametrize("requests", [("pause", "start"), ("flush",)])
def test_what_a_playing_track_need_not_heed_changes_nothing(requests):
    player = steady()
    for request_made in requests:
        getattr(player.track, request_made)()
    assert (player.cycle() == 1.0).all()
    assert player.track.state.name == "ACTIVE"


@pytest.mark.parametrize("removed", [False, True])
@pytest.mark.parametrize("extra", [0, 1, 500, FRAMES - 1, FRAMES, FRAMES + 1])
def test_stop_plays_every_frame_even_if_removed_and_pads_the_last_buffer(extra, removed):
    sound = noise(FRAMES + extra)
    player = Player(sound=sound)
    assert player.track.state.name == "STOPPING"
    if removed:
        player.mixer.remove_track(player.track)
    heard = player.cycle(4)
    np.testing.assert_array_equal(heard[: len(sound)], sound)
    assert not heard[len(sound) :].any()
    assert player.track.state.name == "STOPPED"
    assert player.track.frames_ready == player.track.underruns == 0
    assert len(player.mixer.tracks) == 1 - removed


@pytest.mark.parametrize("rate", [RATE, 44_100])
def test_after_the_last_frame_comes_silence_and_nothing_of_earlier_turns_of_the_ring(rate):
    # a ring that is no multiple of the period, so that periods lie across its end
    player = Player(rate, ring_frames=1_300, start_threshold=1)
    player.track.start()
    for _ in range(12):
        fill(player)
        player.cycle()
    player.track.stop()
    left, heard = player.track.frames_ready * RATE // rate, player.cycle(4)
    # behind the last frame only the resampler's tail
    assert not heard[left + 160 :].any()
    assert np.abs(heard[: left - 160]).min() > 0.5


def test_stop_plays_what_never_reached_the_threshold_and_what_is_written_later_waits():
    first, second = noise(100, seed=1), noise(FRAMES, seed=2)
    player = Player(sound=first, ring_frames=4 * FRAMES, start_threshold=FRAMES)
    player.track.write(second)
    heard = player.cycle(3)
    np.testing.assert_array_equal(heard[:100], first)
    assert not heard[100:].any()
    player.track.start()
    np.testing.assert_array_equal(player.cycle(), second)


def test_a_flush_drops_what_was_written_before_it_and_nothing_else():
    player = Player(ring_frames=4 * FRAMES, start_threshold=FRAMES)
    player.track.write(noise(FRAMES, seed=1))
    player.track.flush()
    after_it = noise(FRAMES, seed=2)
    player.track.write(after_it)
    assert player.track.state.name == "FLUSHED"
    player.track.start()
    np.testing.assert_array_equal(player.cycle(), after_it)


@pytest.mark.parametrize("end", ["pause", "stop"])
def test_pause_or_stop_and_flush_in_one_go_ramp_down_first(end):
    player = steady(ring_frames=8 * FRAMES)
    getattr(player.track, end)()
    player.track.flush()
    assert player.track.state.name == "FLUSHED"
    heard = player.cycle(3)[:, 0]
    assert heard[0] == 1.0, "goes on where it was"
    assert np.abs(np.diff(heard)).max() < STEEPEST
    assert (player.track.frames_ready, player.track.state.name) == (0, "FLUSHED")
    # a flushed track starts anew: no ramp
    fill(player)
    player.track.start()
    assert (player.cycle() == 1.0).all()


def test_a_removed_track_ramps_down_and_a_stop_from_a_pause_drops_what_is_left():
    player = steady()
    player.mixer.remove_track(player.track)
    heard = player.cycle(2)[:, 0]
    assert heard[0] == 1.0, "goes on where it was"
    assert np.abs(np.diff(heard)).max() < STEEPEST
    assert player.mixer.tracks == ()
    player.mixer.remove_track(player.track)
    player.cycle()
    player = steady()
    player.track.pause()
    player.track.stop()
    player.cycle(2)
    assert (player.track.state.name, player.track.frames_ready) == ("STOPPED", 0)


def test_a_new_volume_is_reached_over_exactly_one_buffer_and_wrong_ones_are_refused():
    player = steady(ring_frames=6 * FRAMES)
    player.track.set_volume((0.5, 7.0))
    changing, steady_again = player.cycle(), player.cycle()
    assert changing[0, 0] == 1.0
    assert (np.diff(changing[:, 0]) < 0).all()
    assert (changing[:, 1] == 1.0).all()
    assert (steady_again == [0.5, 1.0]).all()
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
            ["'t'", "'mp3'", "channels=65: want 1 to 64", "frames=959: want at least 960", "n=-4"],
        ),
        ({"start_threshold": 1_921}, ["start_threshold=1921: want 1 to 1920"]),
    ],
)
def test_a_wrong_track_is_refused_with_everything_that_is_wrong(wrong, said):
    mixer = Mixer(RATE, 2)
    good: dict[str, Any] = {"pcm_format": PcmFormat.FLOAT, "samplerate": RATE, "channels": 2}
    with pytest.raises(UsageError) as refused:
        mixer.create_track("t", **(good | wrong))
    for part in said:
        assert part in str(refused.value)
    assert mixer.tracks == ()


def test_a_track_that_changes_its_format_is_refused_and_plays_on():
    player = steady()
    for other in (np.ones((10, 2)), np.ones((10, 3), np.float32), b"\0" * 13):
        with pytest.raises(UsageError):
            player.track.write(other)
    assert (player.cycle() == 1.0).all()


def test_one_thread_writes_while_another_mixes_and_no_frame_is_lost():
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
        self.sent, self.heard_last = 0, 0

    @rule(count=st.integers(0, 3_000))
    def write(self, count: int) -> None:
        # frame number n has the value n, exact in float32
        values = np.arange(self.sent + 1, self.sent + 1 + count, dtype=np.float32)
        taken = self.track.write(np.repeat(values[:, None], 2, axis=1))
        assert taken == min(count, taken + self.track.ring.room)
        self.sent += taken

    @rule(name=st.sampled_from(["start", "pause", "stop", "flush"]))
    def request(self, name: str) -> None:
        before = self.track.state
        getattr(self.track, name)()
        reached = self.track.state
        getattr(self.track, name)()
        assert self.track.state is reached, "asking again changes nothing"
        assert name != "pause" or reached is not TrackState.ACTIVE
        assert name != "flush" or reached in (TrackState.FLUSHED, before)

    @rule(count=st.integers(1, 4))
    def cycle(self, count: int) -> None:
        for _ in range(count):
            was, before = self.track.ring.read, self.track.mixed_state
            audio, report = self.player.cycle()[:, 0], self.player.report
            assert report.tracks_mixed in (0, 1)
            if not report.tracks_mixed:
                assert not audio.any()
                continue
            ramped = TrackState.PAUSED in (before, self.track.mixed_state)
            ramped |= before is TrackState.RESUMING
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
