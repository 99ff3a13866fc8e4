import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.mixer import PcmFormat
from audioflinger_hook.mixer.pcm import decode, encode
from audioflinger_hook.scenes import Scene, SceneTrack
from audioflinger_hook.sources import SceneClient, mixdown
from tests.support.taps import mixed, mixer_for, noise

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
