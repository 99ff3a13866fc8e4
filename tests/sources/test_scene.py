import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.mixer import PcmFormat
from audioflinger_hook.mixer.pcm import decode, encode
from audioflinger_hook.scenes import Scene, SceneTrack, demo_scene
from audioflinger_hook.sources import SceneClient, VoicesClient, mixdown
from audioflinger_hook.sources.applications import PACE_LOST_S, WAITING_S
from tests.support.costs import cost_ffts
from tests.support.taps import mixed, mixer_for, noise
from tests.support.taps import mixed as cycles
from tools.bench.cost import in_ffts

RATE = 48_000


def scene_of(*tracks, frames=10_000):
    return Scene("test", RATE, tracks, frames / RATE)


def track(frames, start=0, **options):
    return SceneTrack("one", RATE, frames, start / RATE, **options)


def played(scene, cycle_frames):
    client = SceneClient(scene, cycle_frames)
    blocks = mixed(client, mixer_for(client))
    assert max(map(len, blocks)) <= cycle_frames
    return np.concatenate(blocks)


@pytest.mark.parametrize("cycle_frames", [37, 256, 960])
@pytest.mark.parametrize("samplerate", [16_000, 44_100, 96_000])
def test_a_track_of_another_rate_starts_within_a_frame_of_its_own(samplerate, cycle_frames):
    click = np.zeros((2_000, 1), np.float32)
    click[0] = 1.0
    for start in (0, 1_000, 1_001, 2_047):
        made = played(scene_of(SceneTrack("click", samplerate, click, start / RATE)), cycle_frames)
        late = 64 * max(1.0, RATE / samplerate)  # the resampler's filter, half of it
        assert abs(np.abs(made[:, 0]).argmax() - start - late) <= max(1.0, RATE / samplerate)


@settings(max_examples=50)
@given(
    st.lists(st.tuples(st.integers(0, 4_000), st.integers(1, 5_000)), min_size=1, max_size=6),
    st.integers(8, 2_000),
)
def test_tracks_start_on_their_frames_and_add_up_exactly_whatever_the_cycle(places, cycle_frames):
    tracks = [track(noise(length, seed=seed), start) for seed, (start, length) in enumerate(places)]
    wanted = np.zeros((10_000, 2), np.float32)
    for one, (start, length) in zip(tracks, places, strict=True):
        wanted[start : start + length] += one.frames
    for made in (played(scene_of(*tracks), cycle_frames), mixdown(scene_of(*tracks))):
        assert np.array_equal(made, wanted)


@pytest.mark.parametrize("pcm_format", PcmFormat)
def test_a_track_sounds_as_its_format_stores_it(pcm_format):
    frames = noise(3_000)
    stored = decode(encode(frames, pcm_format), pcm_format, 2)
    made = mixdown(scene_of(track(frames, 1_000, pcm_format=pcm_format)))
    assert np.array_equal(made, np.pad(stored, ((1_000, 6_000), (0, 0))))


@pytest.mark.parametrize("cycle_frames", [64, 256, 300, 960])
@pytest.mark.parametrize(
    ("start", "pause", "resume"), [(0, 2_000, 5_000), (100, 1_920, 5_760), (4_000, 5_760, 9_000)]
)
def test_a_paused_track_is_silent_and_goes_on_where_it_stopped(start, pause, resume, cycle_frames):
    frames = noise(4_000)
    paused = track(frames, start, pause_s=(pause / RATE, resume / RATE))
    made = played(scene_of(paused, frames=13_000), cycle_frames)
    # the cycles that ramp down and up
    down, up = (at // cycle_frames * cycle_frames for at in (pause, resume))
    silent = down + cycle_frames
    whole, gone_on = np.zeros((2, 13_000, 2), np.float32)
    whole[start : start + 4_000] = frames
    gone_on[up - silent :] = whole[: 13_000 - up + silent]
    assert np.array_equal(made[:down], whole[:down])
    assert not made[silent:up].any()
    assert np.array_equal(made[up + cycle_frames :], gone_on[up + cycle_frames :])
    for ramp, source in ((slice(down, silent), whole), (slice(up, up + cycle_frames), gone_on)):
        # Nothing is louder than the sound it ramps, and nothing of it is another sound.
        assert np.all(np.abs(made[ramp]) <= np.abs(source[ramp]) + 1e-6)
        assert np.all(made[ramp] * source[ramp] >= 0.0)


def test_a_pause_in_the_last_cycle_of_a_sound_keeps_what_is_left_until_it_goes_on():
    frames = noise(4_000)
    made = played(scene_of(track(frames, 0, pause_s=(3_950 / RATE, 7_000 / RATE))), 256)
    down, up = 3_950 // 256 * 256, 7_000 // 256 * 256
    left = 4_000 - down
    assert np.array_equal(made[:down], frames[:down])
    assert not made[down:up].any()
    rising = np.arange(left)[:, None] / 256 * frames[down:]
    assert np.allclose(made[up : up + left], rising, atol=1e-6)
    assert not made[up + left :].any()


BLOCK = 256
BLOCK_S = BLOCK / RATE


def a_mix(*names):
    client = VoicesClient(RATE, 1)
    return mixer_for(client), client, [client.add(name) for name in names]


def due(mixer, client):
    return np.concatenate([level(0.0, 0), *cycles(client, mixer)])[:, 0]


def level(value, count=BLOCK):
    return np.full((count, 1), value, np.float32)


def test_one_voice_passes_bit_for_bit_and_a_second_is_added_a_block_late_at_most():
    mixer, client, (voice,) = a_mix("player")
    counts, sound, parts = np.cumsum([256, 7, 1, 960, 5_000, 333]), noise(7_000, 1), []
    for part in np.split(sound, counts):
        client.push(voice, part, 0.0)
        parts.append(due(mixer, client))
    np.testing.assert_array_equal(np.concatenate(parts), sound[:, 0])
    mixer, client, (one, other) = a_mix("one", "other")
    heard = []
    for block in range(20):
        client.push(one, level(0.25), block * BLOCK_S)
        heard.append(due(mixer, client))
        client.push(other, level(0.5), block * BLOCK_S)
        assert not client.pending_frames
    assert (heard[0] == 0.25).all()
    assert (np.array(heard[1:]) == 0.75).all()


def test_when_the_voice_that_set_the_pace_is_silent_or_removed_another_does():
    mixer, client, (one, other) = a_mix("one", "other")
    client.push(one, level(0.25), 0.0)
    due(mixer, client)
    client.push(other, level(0.5), PACE_LOST_S / 2)
    assert not client.pending_frames
    client.push(other, level(0.5), PACE_LOST_S * 1.1)
    assert due(mixer, client)[-1] == 0.5
    mixer, client, (one, other) = a_mix("one", "other")
    client.push(one, level(0.25), 0.0)
    due(mixer, client)
    client.remove(one)
    client.push(other, level(0.5), BLOCK_S)
    assert (due(mixer, client)[-1], len(mixer.cycle(1.0, BLOCK).buffer.audio)) == (0.5, BLOCK)


def test_what_waits_longer_than_it_should_is_dropped_and_counted():
    mixer, client, (one, other) = a_mix("one", "other")
    client.push(one, level(0.25), 0.0)
    for _ in range(100):
        client.push(other, level(0.5), 0.01)
    assert other.frames <= WAITING_S * RATE + BLOCK
    assert (other.frames + other.dropped, due(mixer, client)[-1]) == (100 * BLOCK, 0.75)


pushes = st.tuples(st.integers(0, 2), st.integers(1, 3_000), st.floats(0.0, 0.1))


@settings(max_examples=50)
@given(st.lists(pushes, max_size=40))
def test_no_order_of_buffers_loses_a_cycle(calls):
    mixer, client, voices = a_mix("a", "b", "c")
    now_s = paced = heard = 0
    for number, count, seconds in calls:
        now_s += seconds
        client.push(voices[number], level(0.1, count), now_s)
        paced = paced + count if client.pending_frames else paced
        samples = due(mixer, client)
        heard += len(samples)
        assert np.abs(samples).max(initial=0.0) < 0.31
    assert heard == paced


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_is_due_before_anything_came(count):
    _, client, _ = a_mix(*["voice"] * count)
    assert client.play() is None
    client.close()


SAMPLERATE = 48_000
NAMES = ["engine", "footsteps", "speech", "explosion", "chord"]


@pytest.fixture(scope="module")
def scene():
    return demo_scene()


@pytest.fixture(scope="module")
def mix(scene):
    return mixdown(scene)


def track_named(scene, name):
    return next(track for track in scene.tracks if track.name == name)


def rms_between(frames, start_s, end_s, samplerate=SAMPLERATE):
    part = frames[round(start_s * samplerate) : round(end_s * samplerate)]
    return np.sqrt(np.mean(part.astype(np.float64) ** 2, axis=0))


def test_the_demo_scene_is_15_loud_seconds_of_stereo_with_a_second_of_exact_silence(scene, mix):
    assert (scene.name, scene.samplerate, scene.duration_s) == ("demo", 48_000, 15.0)
    assert (mix.shape, mix.dtype) == ((15 * 48_000, 2), np.float32)
    assert -3.0 <= 20.0 * np.log10(np.max(np.abs(mix))) <= -1.0  # of full scale, and finite
    assert 0.9 <= np.diff(np.flatnonzero(mix.any(axis=1))).max() / SAMPLERATE <= 1.5


@pytest.mark.sweep
@pytest.mark.parametrize("name", NAMES)
def test_each_voice_can_be_heard_over_all_others_in_a_second_of_its_own(scene, name):
    own = track_named(scene, name)
    rest = tuple(track for track in scene.tracks if track is not own)
    alone, others = (
        mixdown(Scene("part", SAMPLERATE, tracks, scene.duration_s)) for tracks in ((own,), rest)
    )
    margins = [
        rms_between(alone, at_s, at_s + 1.0).max()
        / max(rms_between(others, at_s, at_s + 1.0).max(), 1e-9)
        for at_s in np.arange(own.start_s, own.end_s - 1.0, 0.1)
    ]
    assert max(margins) > 10.0  # 20 dB
    # -40 dBFS over the whole track: nobody has to search for it
    assert np.max(rms_between(alone, own.start_s, own.end_s)) > 0.01


@pytest.mark.parametrize("name", NAMES)
def test_each_track_starts_and_ends_at_exactly_zero_and_keeps_no_offset(scene, name):
    frames = track_named(scene, name).frames
    assert not frames[0].any()
    assert not frames[-1].any()
    # an offset of -60 dBFS would already waste the coil's travel
    assert np.all(np.abs(frames.mean(axis=0, dtype=np.float64)) < 1e-3)


def test_the_engine_moves_from_left_to_right_and_footsteps_fall_left_and_right_in_turn(scene):
    engine = track_named(scene, "engine")
    left, right = rms_between(engine.frames, 1.0, 2.0, engine.samplerate)
    later_left, later_right = rms_between(engine.frames, 3.8, 4.3, engine.samplerate)
    assert left > 2.0 * right
    assert later_right > 2.0 * later_left
    steps, starts_s = track_named(scene, "footsteps"), [0.42 * step for step in range(6)]
    sides = [rms_between(steps.frames, at_s, at_s + 0.2, steps.samplerate) for at_s in starts_s]
    assert [left > right for left, right in sides] == [True, False] * 3


def test_the_explosion_is_the_loudest_second_of_the_scene(scene, mix):
    seconds = [np.max(rms_between(mix, start_s, start_s + 1.0)) for start_s in range(15)]
    assert 9 <= int(np.argmax(seconds)) <= 10
    assert max(scene.tracks, key=lambda track: track.frames.max()).name == "explosion"


def test_the_events_are_the_sounding_stretches_of_tracks_that_cannot_be_changed(scene):
    events = scene.events()
    assert [label for _, _, label in events] == ["engine", *NAMES]
    first, second, *others = events
    assert (first[1], second[0]) == track_named(scene, "engine").pause_s
    for start_s, end_s, name in others:
        track = track_named(scene, name)
        assert (start_s, end_s) == (track.start_s, track.end_s)
    assert all(0.0 <= start_s < end_s <= scene.duration_s for start_s, end_s, _ in events)
    assert events == sorted(events)
    with pytest.raises(ValueError, match="read-only"):
        scene.tracks[0].frames[0, 0] = 1.0


@pytest.mark.exhaustive
def test_making_the_demo_scene_takes_less_than_a_second_and_a_half_of_a_quick_machine():
    assert cost_ffts(lambda: demo_scene()) < in_ffts(1.5)
