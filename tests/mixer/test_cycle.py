"""The cycle: what is mixed with what, in which order, when it sleeps, and what it costs."""

from __future__ import annotations

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.mixer import (
    EffectsPort,
    Mixer,
    MixerState,
    PcmFormat,
)
from audioflinger_hook.mixer.mix_buffer import MixBuffer
from audioflinger_hook.mixer.pcm import decode, encode
from device.errors import InternalError, UsageError

RATE = 48_000
FRAMES = 960
CYCLE_S = FRAMES / RATE


class Effects(EffectsPort):
    """Chains that write down their calls; what they do to a buffer is given by session."""

    def __init__(self, *sessions: int, **treatments) -> None:
        self.has = set(sessions)
        self.treatments = treatments
        self.calls: list[tuple[object, float]] = []
        self.seen: dict[int, list[np.ndarray]] = {}
        self.format: tuple[int, ...] = ()

    def sessions(self):
        return self.has

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        self.calls.append((session, now_s))
        self.seen.setdefault(session, []).append(buffer.samples.copy())
        treatment = self.treatments.get(f"s{session}".replace("-", "_"))
        if treatment is not None:
            treatment(buffer)

    def end_of_cycle(self, now_s: float) -> None:
        self.calls.append(("end", now_s))

    def set_format(self, *stream: int) -> None:
        self.format = stream


class Recorder:
    """A sink that keeps its buffers."""

    def __init__(self) -> None:
        self.blocks: list[np.ndarray] = []
        self.standbys = 0

    def write(self, buffer: MixBuffer) -> None:
        self.blocks.append(buffer.samples.copy())

    def standby(self) -> None:
        self.standbys += 1


def noise(frames: int, channels: int = 2, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (frames, channels)).astype(np.float32)


def playing(mixer: Mixer, sound: np.ndarray, rate: int = RATE, **options):
    """A started track whose ring holds the whole sound."""
    track = mixer.create_track(
        "sound",
        PcmFormat.FLOAT,
        rate,
        sound.shape[1],
        ring_frames=max(len(sound), 2_000),
        start_threshold=1,
        **options,
    )
    assert track.write(sound) == len(sound)
    track.start()
    return track


# the mix ------------------------------------------------------------------------------------------


@settings(max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    channels=st.integers(1, 32),
    hal_frames=st.sampled_from([192, 240, 256, 512, 600, 960, 1920]),
)
def test_one_float_track_passes_bit_identically(seed: int, channels: int, hal_frames: int) -> None:
    # any bits at all: negative zeros, subnormals, infinities, NaN
    rng = np.random.default_rng(seed)
    bits = rng.integers(0, 2**32, (4_000, channels), dtype=np.uint32)
    mixer = Mixer(RATE, channels, hal_frames=hal_frames, haptic_channels=2, effects=Effects(0))
    playing(mixer, bits.view(np.float32))
    for first in range(0, 4_000 - mixer.frames, mixer.frames):
        audio = mixer.cycle(0.0).buffer.audio
        np.testing.assert_array_equal(audio.view(np.uint32), bits[first : first + mixer.frames])


def test_tracks_of_any_rate_and_layout_add_up() -> None:
    mixer = Mixer(RATE, 2)
    alone = []
    sounds = [
        (noise(2_000, 1, 1), 44_100),
        (noise(2_000, 2, 2), 32_000),
        (noise(2_000, 6, 3), RATE),
    ]
    for sound, rate in sounds:
        single = Mixer(RATE, 2)
        playing(single, sound, rate)
        alone.append(single.cycle(0.0).buffer.audio.copy())
        playing(mixer, sound, rate)
    report = mixer.cycle(0.0)
    assert report.tracks_mixed == 3
    np.testing.assert_allclose(report.buffer.audio, np.sum(alone, axis=0), rtol=0, atol=1e-6)


def test_the_accumulator_neither_limits_nor_clips() -> None:
    mixer = Mixer(RATE, 1)
    for _ in range(20):
        playing(mixer, np.ones((FRAMES, 1), np.float32))
    assert (mixer.cycle(0.0).buffer.audio == 20.0).all()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_the_same_graph_in_integers_and_in_float_is_the_same(seed: int) -> None:
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


def test_hundreds_of_tracks_come_and_go() -> None:
    mixer = Mixer(RATE, 2)
    tracks = [playing(mixer, np.full((3 * FRAMES, 2), 1e-3, np.float32)) for _ in range(300)]
    report = mixer.cycle(0.0)
    assert report.tracks_mixed == 300
    np.testing.assert_allclose(report.buffer.audio, 0.3, rtol=1e-5)
    assert len({track.id for track in tracks}) == 300
    for track in tracks[::2]:
        mixer.remove_track(track)
    mixer.cycle(0.02)
    assert len(mixer.tracks) == 300
    assert mixer.cycle(0.04).tracks_mixed == 150
    assert mixer.tracks == tuple(tracks[1::2])


def test_a_starving_track_leaves_the_others_alone() -> None:
    mixer = Mixer(RATE, 2)
    sound = noise(4 * FRAMES)
    playing(mixer, sound)
    starving = playing(mixer, np.full((FRAMES, 2), 0.5, np.float32))
    mixer.cycle(0.0)
    report = mixer.cycle(0.02)
    assert (report.tracks_mixed, report.underruns) == (1, 1)
    np.testing.assert_array_equal(report.buffer.audio, sound[FRAMES : 2 * FRAMES])
    assert starving.underrun_frames == FRAMES


# standby ------------------------------------------------------------------------------------------


def test_a_mixer_sleeps_until_a_track_becomes_active() -> None:
    sink = Recorder()
    mixer = Mixer(RATE, 2, sinks=[sink])
    report = mixer.cycle(1e6)
    assert (report.state, report.frames_written) == (MixerState.STANDBY, 0)
    assert not sink.blocks
    assert not sink.standbys
    playing(mixer, noise(FRAMES))
    report = mixer.cycle(1e6 + 1)
    assert (report.state, report.frames_written) == (MixerState.READY, FRAMES)
    assert len(sink.blocks) == 1


@pytest.mark.parametrize("start_s", [0.0, 1e5])
def test_standby_comes_three_seconds_after_the_last_ready_mix(start_s: float) -> None:
    sink, effects = Recorder(), Effects(0)
    mixer = Mixer(RATE, 2, sinks=[sink], effects=effects)
    playing(mixer, noise(FRAMES)).stop()
    assert mixer.cycle(start_s).state is MixerState.READY
    for now_s in (0.02, 1.0, 2.0, 2.99):
        report = mixer.cycle(start_s + now_s)
        assert (report.state, report.frames_written) == (MixerState.IDLE, FRAMES)
        assert not report.buffer.samples.any()
    written, calls = len(sink.blocks), len(effects.calls)
    for now_s in (3.0, 3.02, 50.0):
        report = mixer.cycle(start_s + now_s)
        assert (report.state, report.frames_written) == (MixerState.STANDBY, 0)
    assert len(sink.blocks) == written
    assert len(effects.calls) == calls, "effects run only in cycles that write"
    assert sink.standbys == 1


def test_a_paused_track_lets_the_mixer_sleep_and_wakes_it() -> None:
    mixer = Mixer(RATE, 2)
    track = playing(mixer, np.ones((4 * FRAMES, 2), np.float32))
    mixer.cycle(0.0)
    track.pause()
    mixer.cycle(0.02)
    assert mixer.cycle(3.01).state is MixerState.IDLE
    assert mixer.cycle(3.03).state is MixerState.STANDBY
    assert not mixer.buffer.samples.any()
    track.start()
    report = mixer.cycle(60.0)
    assert report.state is MixerState.READY
    assert (report.buffer.audio[0] == 0.0).all(), "it ramps up"


def test_a_track_that_fills_slowly_is_awaited_and_its_wait_counts_from_waking() -> None:
    mixer = Mixer(RATE, 2)
    track = mixer.create_track("slow", PcmFormat.FLOAT, RATE, 2)
    track.start()
    assert mixer.cycle(100.0).state is MixerState.ENABLED
    for cycle in range(1, 60):
        state = mixer.cycle(100.0 + cycle * CYCLE_S).state
    assert track.disabled
    assert state is MixerState.IDLE
    assert mixer.cycle(103.0).state is MixerState.STANDBY


# effects ------------------------------------------------------------------------------------------


def test_effects_learn_the_format_before_the_first_buffer() -> None:
    effects = Effects()
    Mixer(44_100, 6, hal_frames=441, haptic_channels=2, effects=effects)
    assert effects.format == (44_100, 6, 2, 896)


def test_chains_run_players_first_by_falling_ids_then_mix_stage_and_device() -> None:
    effects = Effects(-2, 3, -1, 17, 0)
    mixer = Mixer(RATE, 2, effects=effects)
    for session in (3, 17):
        playing(mixer, noise(FRAMES), session=session)
    mixer.cycle(1.5)
    assert effects.calls == [(s, 1.5) for s in (17, 3, 0, -1, -2, "end")]


def test_a_players_track_passes_its_own_chain_and_the_others_do_not() -> None:
    def halve(buffer: MixBuffer) -> None:
        buffer.audio *= 0.5

    effects = Effects(5, s5=halve)
    mixer = Mixer(RATE, 2, effects=effects)
    treated, direct, unchained = (noise(FRAMES, seed=seed) for seed in range(3))
    playing(mixer, treated, session=5)
    playing(mixer, direct)
    playing(mixer, unchained, session=6)
    audio = mixer.cycle(0.0).buffer.audio
    expected = treated * np.float32(0.5) + (direct + unchained)
    np.testing.assert_allclose(audio, expected, rtol=0, atol=3e-7)
    np.testing.assert_array_equal(effects.seen[5][0].reshape(-1, 2), treated)


def test_a_players_only_track_passes_an_idle_chain_bit_identically() -> None:
    mixer = Mixer(RATE, 2, haptic_channels=1, effects=Effects(9))
    bits = np.random.default_rng(4).integers(0, 2**32, (FRAMES, 2), dtype=np.uint32)
    playing(mixer, bits.view(np.float32), session=9)
    np.testing.assert_array_equal(mixer.cycle(0.0).buffer.audio.view(np.uint32), bits)


def test_a_players_chain_gets_one_second_of_zeros_after_its_last_track() -> None:
    effects = Effects(4)
    mixer = Mixer(RATE, 2, effects=effects)
    playing(mixer, noise(2 * FRAMES), session=4).stop()
    for cycle in range(120):
        mixer.cycle(cycle * CYCLE_S)
    runs = effects.seen[4]
    assert len(runs) == 2 + RATE // FRAMES
    assert all(not samples.any() for samples in runs[2:])


def test_the_mixs_chain_runs_on_silence_until_standby() -> None:
    effects = Effects(0)
    mixer = Mixer(RATE, 2, effects=effects)
    playing(mixer, noise(FRAMES)).stop()
    written = sum(mixer.cycle(cycle * CYCLE_S).frames_written for cycle in range(400))
    assert len(effects.seen[0]) * FRAMES == written
    assert written == pytest.approx(3.0 * RATE, abs=FRAMES)
    assert all(not samples.any() for samples in effects.seen[0][1:])


def test_the_haptic_region_is_fresh_in_every_cycle() -> None:
    wrote: list[bool] = []

    def once(buffer: MixBuffer) -> None:
        assert not buffer.haptic.any()
        if not wrote:
            wrote.append(True)
            buffer.haptic[:] = 0.7

    mixer = Mixer(RATE, 2, haptic_channels=2, effects=Effects(0, s0=once))
    playing(mixer, noise(4 * FRAMES))
    assert (mixer.cycle(0.0).buffer.haptic == np.float32(0.7)).all()
    assert not mixer.cycle(0.02).buffer.haptic.any()


def test_haptics_of_player_chains_add_up() -> None:
    def buzz(buffer: MixBuffer) -> None:
        buffer.haptic[:] += 0.25

    mixer = Mixer(RATE, 2, haptic_channels=1, effects=Effects(2, 1, s1=buzz, s2=buzz))
    for session in (1, 2):
        playing(mixer, noise(2 * FRAMES), session=session)
    for cycle in range(2):
        assert (mixer.cycle(cycle * CYCLE_S).buffer.haptic == 0.5).all()


def test_chains_may_come_and_go_between_cycles() -> None:
    def mute(buffer: MixBuffer) -> None:
        buffer.audio[:] = 0.0

    effects = Effects(s3=mute)
    mixer = Mixer(RATE, 2, effects=effects)
    playing(mixer, np.ones((5 * FRAMES, 2), np.float32), session=3)
    levels = []
    for cycle in range(5):
        effects.has = {3} if cycle in (1, 2) else set()
        levels.append(float(mixer.cycle(cycle * CYCLE_S).buffer.audio.max()))
    assert levels == [1.0, 0.0, 0.0, 1.0, 1.0]


# config events ------------------------------------------------------------------------------------


def test_events_run_in_order_at_the_start_of_the_next_cycle() -> None:
    mixer = Mixer(RATE, 2)
    ran = []
    mixer.post(lambda: ran.append(1))
    mixer.post(lambda: mixer.post(lambda: ran.append(3)))
    mixer.post(lambda: ran.append(2))
    assert ran == []
    mixer.cycle(0.0)
    assert ran == [1, 2]
    mixer.cycle(0.02)
    assert ran == [1, 2, 3]


def test_an_event_that_raises_is_counted_and_the_sound_goes_on() -> None:
    mixer = Mixer(RATE, 2)
    sound = noise(FRAMES)
    playing(mixer, sound)

    def wrong() -> None:
        raise ValueError("no such thing")

    mixer.post(wrong)
    np.testing.assert_array_equal(mixer.cycle(0.0).buffer.audio, sound)
    assert mixer.failed_events == 1
    assert mixer.last_failure == "ValueError: no such thing"


def test_a_wrong_mix_is_refused_with_everything_that_is_wrong() -> None:
    with pytest.raises(UsageError) as refused:
        Mixer(10, 0, hal_frames=0, haptic_channels=-1)
    for part in ("samplerate=10 Hz", "channels=0", "hal_frames=0", "haptic_channels=-1"):
        assert part in str(refused.value)


# sinks --------------------------------------------------------------------------------------------


def test_what_a_sink_raises_ends_the_cycle_and_the_next_one_goes_on() -> None:
    class Failing(Recorder):
        def write(self, buffer: MixBuffer) -> None:
            super().write(buffer)
            if len(self.blocks) == 1:
                raise InternalError("full")

    mixer = Mixer(RATE, 2, sinks=[Failing()])
    sound = noise(2 * FRAMES)
    playing(mixer, sound)
    with pytest.raises(InternalError, match="full"):
        mixer.cycle(0.0)
    np.testing.assert_array_equal(mixer.cycle(0.02).buffer.audio, sound[FRAMES:])


# cost ---------------------------------------------------------------------------------------------


def fastest_cycle_s(count: int, rate: int = RATE) -> float:
    """The fastest of many cycles, so that what else the machine does hardly counts."""
    mixer = Mixer(RATE, 2, haptic_channels=2, effects=Effects())
    sound = noise(4_000)
    tracks = []
    for _ in range(count):
        track = mixer.create_track("t", PcmFormat.FLOAT, rate, 2)
        track.write(sound)
        track.set_volume(0.7)
        track.start()
        tracks.append(track)
    times = []
    for cycle in range(60):
        began_s = time.thread_time()
        report = mixer.cycle(cycle * CYCLE_S)
        times.append(time.thread_time() - began_s)
        assert report.tracks_mixed == count
        for track in tracks:
            track.write(sound[: track.ring.room])
    return min(times)


def test_eight_tracks_cost_under_two_percent_and_the_cost_grows_linearly() -> None:
    one, eight, many = (fastest_cycle_s(count) for count in (1, 8, 32))
    assert eight < 0.02 * CYCLE_S
    # 24 tracks more cost no more than 24 times what 7 more cost each, with room for noise
    assert (many - eight) / 24 < 3 * (eight - one) / 7


def test_cycles_leave_no_memory_behind() -> None:
    class QuietChain(EffectsPort):
        def sessions(self):
            return (1,)

    mixer = Mixer(RATE, 2, haptic_channels=2, effects=QuietChain())
    sound = noise(4_000)
    tracks = [
        mixer.create_track("t", PcmFormat.FLOAT, rate, channels, session=session)
        for rate, channels, session in ((RATE, 2, 0), (44_100, 2, 0), (RATE, 1, 1), (RATE, 6, 0))
    ]
    chunks = [noise(4_000, track.channels) for track in tracks]

    def run(cycles: int) -> None:
        for _ in range(cycles):
            for track, chunk in zip(tracks, chunks, strict=True):
                track.write(chunk[: track.ring.room])
            mixer.cycle(0.0)

    for track in tracks:
        track.start()
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
    assert peak - before < 4 * sound.nbytes
