import numpy as np
import pytest

from audioflinger_hook.scenes import Scene, demo_scene
from audioflinger_hook.sources import mixdown
from tests.support.costs import cost_ffts
from tools.bench.cost import in_ffts

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
