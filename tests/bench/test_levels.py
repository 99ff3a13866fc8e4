"""The bench on levels: its measures on sounds whose level is known, and the settled sound."""

import numpy as np
import pytest

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.transform import TransformParameters
from tests.support.signals import joined, tone
from tools.bench.sections.profiles import (
    Way,
    loudest_db,
    units_db,
    ways,
)
from tools.bench.sounds.signals import SAMPLERATE


def test_a_full_scale_tone_has_every_level_at_0_db():
    sound = tone(1_000, 1.0, SAMPLERATE)
    assert units_db(sound) == pytest.approx(np.zeros(21), abs=0.05)
    assert loudest_db(sound) == pytest.approx(0.0, abs=0.05)


def test_the_loudest_tenth_is_that_of_a_short_loud_part():
    sound = joined(tone(300, 9.0, SAMPLERATE, 0.01), tone(300, 1.0, SAMPLERATE, 0.5))
    assert loudest_db(sound) == pytest.approx(-6.0, abs=0.2)


def test_every_profile_and_the_mapping_alone_are_measured():
    assert [way.name for way in ways()] == ["paper", "by energy", *list(PROFILES)[1:]]


def test_a_settled_sound_has_its_own_length_and_knows_what_was_played_before():
    sound = tone(440, 0.7, SAMPLERATE, 0.05)
    cinema = Way("cinema", parameters_of("cinema"))
    fresh, settled = cinema.settled(sound, 0.0), cinema.settled(sound, 8.0)
    assert fresh.size == settled.size == sound.size
    # The programme's level has moved, and a sound that goes on has no onset.
    assert settled.tobytes() != fresh.tobytes()
    paper = Way("paper", TransformParameters())
    assert paper.settled(sound, 8.0).tobytes() == paper.felt(sound)[: sound.size].tobytes()
