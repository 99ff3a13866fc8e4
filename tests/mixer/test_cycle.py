import time
import tracemalloc
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.mixer import EffectsPort, Mixer, MixerState, PcmFormat
from audioflinger_hook.mixer.mix_buffer import MixBuffer, normal_buffer_frames
from audioflinger_hook.mixer.pcm import decode, encode
from device.errors import InternalError, UsageError
from tests.support.taps import noise

RATE = 48_000
FRAMES = 960
CYCLE_S = FRAMES / RATE


@pytest.mark.parametrize(
    ("hal_frames", "expected"),
    [(192, 960), (240, 960), (256, 768), (512, 1024), (600, 1152), (960, 960), (1920, 1920)],
)
def test_the_buffer_sizes_of_audioflinger_at_48_khz(hal_frames, expected):
    assert normal_buffer_frames(RATE, hal_frames) == expected


@given(samplerate=st.integers(1_000, 768_000), hal_frames=st.integers(1, 100_000))
def test_a_buffer_is_whole_sixteens_of_13_to_24_ms_or_like_a_hal_buffer(samplerate, hal_frames):
    frames = normal_buffer_frames(samplerate, hal_frames)
    assert frames % 16 == 0
    assert frames >= hal_frames
    # floor(20 ms / h) leaves at least two thirds: 2 h to 3 h for 2 < 20 ms / h < 3
    assert frames > samplerate * 0.020 * 2 / 3 - 16
    if hal_frames <= samplerate * 0.020:
        assert frames <= max(samplerate * 0.024, samplerate * 0.020 + 32)


class Effects(EffectsPort):
    """Chains that write down their calls; treatments: what a session does to a buffer."""

    def __init__(self, *sessions: int, treatments: Any = None) -> None:
        self.treatments = treatments or {}
        self.has = {*sessions, *self.treatments}
        self.calls: list[tuple[object, float]] = []
        self.seen: dict[int, list[np.ndarray]] = {}
        self.format: tuple[int, ...] = ()

    def sessions(self):
        return self.has

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        self.calls.append((session, now_s))
        self.seen.setdefault(session, []).append(buffer.samples.copy())
        if session in self.treatments:
            self.treatments[session](buffer)

    def end_of_cycle(self, now_s: float) -> None:
        self.calls.append(("end", now_s))

    def set_format(self, *stream: int) -> None:
        self.format = stream


def playing(mixer: Mixer, sound: np.ndarray, rate: int = RATE, **options):
    options |= {"ring_frames": max(len(sound), 2_000), "start_threshold": 1}
    track = mixer.create_track("sound", PcmFormat.FLOAT, rate, sound.shape[1], **options)
    assert track.write(sound) == len(sound)
    track.start()
    return track


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    channels=st.integers(1, 32),
    hal_frames=st.sampled_from([192, 240, 256, 512, 600, 960, 1920]),
    session=st.sampled_from([0, 9]),
)
def test_one_float_track_passes_idle_chains_bit_identically(seed, channels, hal_frames, session):
    # any bits at all: negative zeros, subnormals, infinities, NaN
    bits = np.random.default_rng(seed).integers(0, 2**32, (4_000, channels), dtype=np.uint32)
    mixer = Mixer(RATE, channels, hal_frames=hal_frames, haptic_channels=2, effects=Effects(0, 9))
    playing(mixer, bits.view(np.float32), session=session)
    for first in range(0, 4_000 - mixer.frames, mixer.frames):
        audio = mixer.cycle(0.0).buffer.audio
        np.testing.assert_array_equal(audio.view(np.uint32), bits[first : first + mixer.frames])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_the_same_graph_in_integers_and_in_float_is_the_same(seed):
    rng = np.random.default_rng(seed)
    stored = rng.integers(-(2**15), 2**15, (4, FRAMES, 2)).astype("<i2")
    volumes = rng.uniform(0, 1, 4)
    mixers = Mixer(RATE, 2), Mixer(RATE, 2)
    for samples, volume in zip(stored, volumes, strict=True):
        as_float = decode(samples, PcmFormat.I16, 2)
        for mixer, pcm_format, sound in zip(
            mixers, (PcmFormat.I16, PcmFormat.FLOAT), (samples, as_float), strict=True
        ):
            track = mixer.create_track("t", pcm_format, RATE, 2, start_threshold=1)
            track.write(sound)
            track.set_volume(volume)
            track.start()
    in_int, in_float = (mixer.cycle(0.0).buffer.audio for mixer in mixers)
    np.testing.assert_array_equal(in_int.view(np.uint32), in_float.view(np.uint32))
    # AudioFlinger's integer mixer: U4.12 gains, a 32-bit accumulator, clamped to 16 bits at the end
    gains = np.round(volumes * 2**12).astype(np.int64)
    accumulated = (stored.astype(np.int64) * gains[:, None, None]).sum(axis=0)
    expected = np.clip(accumulated / 2**12, -(2**15), 2**15 - 1)
    mixed = np.frombuffer(encode(in_float, PcmFormat.I16), "<i2").reshape(-1, 2)
    # each gain is up to half of 2^-12 off, each sample up to 2^15: 4 steps a track, and a rounding
    assert np.abs(mixed - expected).max() <= 4 * 4 + 1


def test_hundreds_of_tracks_come_and_go():
    mixer = Mixer(RATE, 2)
    tracks = [playing(mixer, np.ones((3 * FRAMES, 2), np.float32)) for _ in range(300)]
    report = mixer.cycle(0.0)
    assert report.tracks_mixed == 300
    assert (report.buffer.audio == 300.0).all(), "the sum is neither limited nor clipped"
    assert len({track.id for track in tracks}) == 300
    for track in tracks[::2]:
        mixer.remove_track(track)
    mixer.cycle(0.02)
    assert (len(mixer.tracks), mixer.cycle(0.04).tracks_mixed) == (300, 150)
    assert mixer.tracks == tuple(tracks[1::2])


def test_a_starving_track_leaves_the_others_alone():
    mixer, sound = Mixer(RATE, 2), noise(4 * FRAMES)
    playing(mixer, sound)
    starving = playing(mixer, np.full((FRAMES, 2), 0.5, np.float32))
    mixer.cycle(0.0)
    report = mixer.cycle(0.02)
    assert (report.tracks_mixed, report.underruns) == (1, 1)
    np.testing.assert_array_equal(report.buffer.audio, sound[FRAMES : 2 * FRAMES])
    assert starving.underrun_frames == FRAMES


@pytest.mark.parametrize("start_s", [0.0, 1e5])
def test_a_mixer_sleeps_until_a_track_plays_and_again_three_seconds_after_its_end(start_s):
    sink, effects = Mock(), Effects(0)
    mixer = Mixer(RATE, 2, sinks=[sink], effects=effects)
    report = mixer.cycle(start_s - 1.0)
    assert (report.state, report.frames_written) == (MixerState.STANDBY, 0), "nothing plays yet"
    assert sink.mock_calls == []
    playing(mixer, noise(FRAMES)).stop()
    assert mixer.cycle(start_s).state is MixerState.READY
    for now_s in (0.02, 1.0, 2.0, 2.99):
        report = mixer.cycle(start_s + now_s)
        assert (report.state, report.frames_written) == (MixerState.IDLE, FRAMES)
        assert not report.buffer.samples.any()
    written, calls = sink.write.call_count, len(effects.calls)
    assert written == 5
    for now_s in (3.0, 3.02, 50.0):
        report = mixer.cycle(start_s + now_s)
        assert (report.state, report.frames_written) == (MixerState.STANDBY, 0)
    assert sink.write.call_count == written
    assert len(effects.calls) == calls, "effects run only in cycles that write"
    assert sink.standby.call_count == 1


def test_a_track_that_fills_slowly_is_awaited_and_its_wait_counts_from_waking():
    mixer = Mixer(RATE, 2)
    track = mixer.create_track("slow", PcmFormat.FLOAT, RATE, 2)
    track.start()
    assert mixer.cycle(100.0).state is MixerState.ENABLED
    for cycle in range(1, 60):
        state = mixer.cycle(100.0 + cycle * CYCLE_S).state
    assert (track.disabled, track.underruns) == (True, 0)
    assert state is MixerState.IDLE
    assert mixer.cycle(103.0).state is MixerState.STANDBY


def test_chains_learn_the_format_and_run_players_first_by_falling_ids_then_mix_stage_and_device():
    effects = Effects(-2, 3, -1, 17, 0)
    mixer = Mixer(44_100, 6, hal_frames=441, haptic_channels=2, effects=effects)
    assert effects.format == (44_100, 6, 2, 896)
    for session in (3, 17):
        playing(mixer, noise(2 * FRAMES), session=session)
    mixer.cycle(1.5)
    assert effects.calls == [(s, 1.5) for s in (17, 3, 0, -1, -2, "end")]


def test_a_players_track_passes_its_own_chain_and_the_others_do_not():
    effects = Effects(treatments={5: lambda buffer: np.divide(buffer.audio, 2.0, buffer.audio)})
    mixer = Mixer(RATE, 2, effects=effects)
    treated, direct, unchained = (noise(FRAMES, seed=seed) for seed in range(3))
    playing(mixer, treated, session=5)
    playing(mixer, direct)
    playing(mixer, unchained, session=6)
    audio = mixer.cycle(0.0).buffer.audio
    expected = treated * np.float32(0.5) + (direct + unchained)
    np.testing.assert_allclose(audio, expected, rtol=0, atol=3e-7)
    np.testing.assert_array_equal(effects.seen[5][0].reshape(-1, 2), treated)


@pytest.mark.parametrize(("session", "after_s"), [(4, 1.0), (0, 3.0)])
def test_a_players_chain_gets_a_second_of_silence_and_the_mixs_all_until_standby(session, after_s):
    effects = Effects(session)
    mixer = Mixer(RATE, 2, effects=effects)
    playing(mixer, noise(FRAMES), session=session).stop()
    written = sum(mixer.cycle(cycle * CYCLE_S).frames_written for cycle in range(400))
    runs = effects.seen[session]
    assert all(not samples.any() for samples in runs[1:])
    assert (len(runs) - 1) * FRAMES == pytest.approx(after_s * RATE, abs=FRAMES)
    assert session or len(runs) * FRAMES == written


def test_haptics_of_player_chains_add_up_and_begin_anew_in_every_cycle():
    def buzz(buffer: MixBuffer) -> None:
        assert not buffer.haptic.any()
        buffer.haptic[:] = 0.25

    mixer = Mixer(RATE, 2, haptic_channels=1, effects=Effects(treatments={1: buzz, 2: buzz}))
    for session in (1, 2):
        playing(mixer, noise(2 * FRAMES), session=session)
    for cycle in range(2):
        assert (mixer.cycle(cycle * CYCLE_S).buffer.haptic == 0.5).all()


def test_chains_may_come_and_go_between_cycles():
    effects = Effects(treatments={3: lambda buffer: buffer.audio.fill(0.0)})
    mixer = Mixer(RATE, 2, effects=effects)
    playing(mixer, np.ones((5 * FRAMES, 2), np.float32), session=3)
    levels = []
    for cycle in range(5):
        effects.has = {3} if cycle in (1, 2) else set()
        levels.append(float(mixer.cycle(cycle * CYCLE_S).buffer.audio.max()))
    assert levels == [1.0, 0.0, 0.0, 1.0, 1.0]


def test_events_run_in_order_at_the_start_of_the_next_cycle_and_one_that_raises_is_counted():
    mixer, ran = Mixer(RATE, 2), []
    mixer.post(lambda: ran.append(1))
    mixer.post(lambda: ran.remove(0))
    mixer.post(lambda: mixer.post(lambda: ran.append(3)))
    mixer.post(lambda: ran.append(2))
    assert ran == []
    mixer.cycle(0.0)
    assert (ran, mixer.failed_events) == ([1, 2], 1)
    assert mixer.last_failure.startswith("ValueError: ")
    mixer.cycle(0.02)
    assert ran == [1, 2, 3]


def test_a_wrong_mix_is_refused_with_everything_that_is_wrong():
    with pytest.raises(UsageError) as refused:
        Mixer(10, 0, hal_frames=0, haptic_channels=-1)
    for part in ("samplerate=10 Hz", "channels=0", "hal_frames=0", "haptic_channels=-1"):
        assert part in str(refused.value)


def test_what_a_sink_raises_ends_the_cycle_and_the_next_one_goes_on():
    sink = Mock()
    sink.write.side_effect = [InternalError("full"), None]
    mixer, sound = Mixer(RATE, 2, sinks=[sink]), noise(2 * FRAMES)
    playing(mixer, sound)
    with pytest.raises(InternalError, match="full"):
        mixer.cycle(0.0)
    np.testing.assert_array_equal(mixer.cycle(0.02).buffer.audio, sound[FRAMES:])


def fastest_cycle_s(count: int) -> float:
    """The fastest of many cycles, so that what else the machine does hardly counts."""
    mixer, sound = Mixer(RATE, 2, haptic_channels=2, effects=Effects()), noise(4_000)
    tracks = [playing(mixer, sound) for _ in range(count)]
    for track in tracks:
        track.set_volume(0.7)
    times = []
    for cycle in range(60):
        began_s, report = time.thread_time(), mixer.cycle(cycle * CYCLE_S)
        times.append(time.thread_time() - began_s)
        assert report.tracks_mixed == count
        for track in tracks:
            track.write(sound[: track.ring.room])
    return min(times)


def test_eight_tracks_cost_under_two_percent_and_the_cost_grows_linearly():
    one, eight, many = (fastest_cycle_s(count) for count in (1, 8, 32))
    assert eight < 0.02 * CYCLE_S
    # 24 tracks more cost no more than 24 times what 7 more cost each, with room for noise
    assert (many - eight) / 24 < 3 * (eight - one) / 7


def test_cycles_leave_no_memory_behind():
    class QuietChain(EffectsPort):
        def sessions(self):
            return (1,)

    mixer = Mixer(RATE, 2, haptic_channels=2, effects=QuietChain())
    sounds = [noise(4_000, channels) for channels in (2, 2, 1, 6)]
    formats = zip(sounds, (RATE, 44_100, RATE, RATE), (0, 0, 1, 0), strict=True)
    tracks = [playing(mixer, sound, rate, session=session) for sound, rate, session in formats]

    def run(cycles: int) -> None:
        for _ in range(cycles):
            for track, sound in zip(tracks, sounds, strict=True):
                track.write(sound[: track.ring.room])
            mixer.cycle(0.0)

    run(20)
    tracemalloc.start()
    try:
        run(20)
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        run(300)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 4_096
    # no more at a time than the client's own decoding and a few views
    assert peak - before < 4 * sounds[0].nbytes
