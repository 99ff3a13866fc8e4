"""One long file on several cores: sections, and the bytes that one core gives."""

import dataclasses
import os
import signal
from itertools import pairwise

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline import sections
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.offline.sections import Plan, plan_for
from audioflinger_hook.offline.workers import AHEAD, Workers
from audioflinger_hook.sources import FileTap
from audioflinger_hook.transform import HapticTransform, TransformParameters
from device.errors import InternalError, UsageError
from tests.support.commands import listing, noise, sound
from tests.support.signals import tone

RATE = 8_000
REFERENCE = Settings(form="reference")


@pytest.fixture
def short_sections(monkeypatch):
    """Sections of 5 s of one channel, so that a sound of 20 s has several."""
    monkeypatch.setattr(sections, "SECTION_SAMPLES", 5 * RATE)
    monkeypatch.setattr(sections, "WORTH_EARLY", 0.1)


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder / "vibration.wav"


def file_of(tmp_path, samples, **options):
    return sound(tmp_path / "in.wav", samples, RATE, **options)


def fading():
    """Noise, then a tone, then silence, then one sample, then noise: every way to forget."""
    return np.concatenate(
        (
            noise(5 * RATE)[:, 0],
            tone(440.0, 6.0, RATE, 0.5),
            np.zeros(6 * RATE),
            [1.0],
            np.zeros(2 * RATE + 17),
            noise(3 * RATE)[:, 0],
        )
    )


def plan_of(source, settings=REFERENCE):
    plan = plan_for(source, settings)
    assert plan is not None
    return plan


def both(source, out, settings=REFERENCE, **options):
    """The bytes and the reports of one worker and of two."""
    made = []
    for workers in (1, 2):
        report = render_file(source, out, settings, workers=workers, **options)
        made.append((out.read_bytes(), report))
    return made


@pytest.mark.sweep
@pytest.mark.parametrize("early_s", [4.0, 0.05], ids=["long enough to forget", "too short for it"])
@pytest.mark.parametrize("channels", ["mono", "each"])
def test_the_bytes_do_not_depend_on_the_number_of_workers(
    tmp_path, out, monkeypatch, short_sections, early_s, channels
):
    monkeypatch.setattr(sections, "EARLY_S", early_s)
    samples = np.stack((fading(), noise(fading().size)[:, 0]), axis=1)
    source = file_of(tmp_path, samples)
    settings = Settings(form="reference", channels=channels)
    assert plan_of(source, settings).sections > 3
    (alone, told), (together, told_together) = both(source, out, settings)
    assert together == alone
    assert told_together == told


def test_a_section_that_began_in_another_state_is_rendered_again_from_the_right_one(
    tmp_path, monkeypatch, short_sections
):
    monkeypatch.setattr(sections, "EARLY_S", 0.05)
    plan = plan_of(file_of(tmp_path, fading()))
    again: list[int] = []
    ours = sections.render_section

    def noted(plan, index, past=None):
        if past is not None:
            again.append(index)
        return ours(plan, index, past)

    monkeypatch.setattr(sections, "render_section", noted)
    found = list(sections.sections_of(plan, 2))
    assert again
    for one, next_ in pairwise(found):
        assert next_.before == one.after
    # What is compared is not for nothing: as it began, a section had another past.
    assert ours(plan, again[0]).before != found[again[0]].before


def test_after_some_seconds_a_section_begins_in_the_state_that_the_one_before_ended_in(
    tmp_path, monkeypatch, short_sections
):
    monkeypatch.setattr(sections, "EARLY_S", 4.0)
    plan = plan_of(file_of(tmp_path, noise(20 * RATE)[:, 0]))
    found = [sections.render_section(plan, index) for index in range(plan.sections)]
    for one, next_ in pairwise(found):
        assert next_.before == one.after


def test_a_body_that_is_short_ends_the_vibration_where_it_ends(tmp_path, out, short_sections):
    source = file_of(tmp_path, noise(20 * RATE)[:, 0])
    for kept in (0.9, 0.5, 0.26):
        os.truncate(source, round(source.stat().st_size * kept))
        (alone, told), (together, told_together) = both(source, out)
        assert together == alone
        assert told_together == told
        assert "shorter than its header says" in told.warnings[0]


def test_unusable_samples_are_counted_once_wherever_they_lie(tmp_path, out, short_sections):
    samples = noise(20 * RATE)[:, 0]
    samples[:: RATE // 2] = np.nan
    (alone, told), (together, told_together) = both(file_of(tmp_path, samples), out)
    assert together == alone
    assert told_together.replaced_samples == told.replaced_samples == 40


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "settings",
    [
        Settings(form="reference", damping="auto", protection="on"),
        Settings(form="reference", parameters=TransformParameters(window_s=0.1, partials_max=3)),
    ],
)
def test_what_comes_after_the_transform_is_the_same(tmp_path, out, short_sections, settings):
    source = file_of(tmp_path, fading())
    assert plan_for(source, settings)
    felt = out.with_name("felt.wav")
    render_file(source, out, settings, acceleration=felt)
    alone, moved = out.read_bytes(), felt.read_bytes()
    render_file(source, out, settings, acceleration=felt, workers=3)
    assert out.read_bytes() == alone
    assert felt.read_bytes() == moved


def test_nothing_is_cut_where_that_could_change_something_or_gains_nothing(
    tmp_path, short_sections
):
    source = file_of(tmp_path, noise(20 * RATE)[:, 0])
    assert isinstance(plan_for(source, REFERENCE), Plan)
    for changed in (
        Settings(),
        dataclasses.replace(REFERENCE, gain_db=-3.0),
        dataclasses.replace(REFERENCE, effects_file=tmp_path / "effects.xml"),
    ):
        assert plan_for(source, changed) is None
    packed = sound(tmp_path / "a.ogg", noise(20 * RATE), RATE, format="OGG", subtype="VORBIS")
    assert plan_for(packed, REFERENCE) is None
    assert plan_for(file_of(tmp_path, noise(6 * RATE)), REFERENCE) is None
    with pytest.raises(UsageError, match="does not exist"):
        plan_for(tmp_path / "none.wav", REFERENCE)


def test_a_section_holds_few_enough_samples_whatever_the_channels(tmp_path):
    source = sound(tmp_path / "a.wav", np.zeros((200_000, 64), np.float32), RATE, subtype="PCM_U8")
    each = Settings(form="reference", channels="each")
    assert plan_for(source, each) is None  # its sections would be shorter than they begin early


def buffers_of(tap):
    while (buffer := tap.read()) is not None:
        yield buffer


@pytest.mark.parametrize("subtype", ["PCM_U8", "PCM_16", "PCM_24", "FLOAT"])
def test_a_file_from_some_frame_on_is_the_rest_of_the_whole(tmp_path, subtype):
    source = file_of(tmp_path, noise(50_000, 2), subtype=subtype)
    whole, rest = FileTap(source), FileTap(source, first=12_345)
    assert whole.divisible
    frames, later = (np.concatenate(list(buffers_of(tap))) for tap in (whole, rest))
    assert np.array_equal(later, frames[12_345:])
    assert whole.warnings == rest.warnings == []
    for tap in (whole, rest):
        tap.close()
    with pytest.raises(UsageError, match="60000"):
        FileTap(source, first=60_000)


def test_a_stream_that_takes_over_the_past_of_another_goes_on_as_that_one():
    unit = TransformParameters().window_frames(RATE)
    first, second = noise(40 * unit)[:, 0], noise(20 * unit, seed=2)[:, 0]
    one, other = (HapticTransform(RATE, 1, form="reference") for _ in range(2))
    one.process(first)
    other.past = one.past
    expected = one.process(second)[unit:]
    assert np.array_equal(other.process(second)[unit:], expected)
    one.process(second[:1])
    with pytest.raises(InternalError, match="has begun"):
        _ = one.past


def test_a_worker_that_dies_or_fails_ends_the_rendering_and_leaves_nothing(
    tmp_path, out, monkeypatch, short_sections
):
    source = file_of(tmp_path, noise(20 * RATE)[:, 0])
    us = os.getpid()

    def dies(*_):
        assert os.getpid() != us
        os.kill(os.getpid(), signal.SIGKILL)

    def fails(*_):
        raise ZeroDivisionError("by nothing")

    for broken, words in ((dies, "SIGKILL"), (fails, "ZeroDivisionError: by nothing")):
        monkeypatch.setattr(sections, "_render_section", broken)
        with pytest.raises(InternalError, match=words):
            render_file(source, out, REFERENCE, workers=2)
        assert not listing(out.parent)


def test_no_more_is_begun_than_a_few_results_ahead_of_what_was_taken(tmp_path):
    def begun() -> int:
        return len(list(tmp_path.iterdir()))

    def work(item, _):
        (tmp_path / str(item)).touch()
        return item

    with Workers(work, 50, 2) as pool:
        for taken, result in enumerate(pool.results(), 1):
            assert result == taken - 1
            assert begun() <= taken + AHEAD * 2
    assert begun() == 50
