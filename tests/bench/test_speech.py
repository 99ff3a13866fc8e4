"""The benches on speech suppression: they count what they say, on halves that share nothing."""

import numpy as np
import pytest

from tests.support.recordings import require_recordings
from tests.support.signals import joined, silence, tone, white_noise
from tools.bench.sections import speech_suppression
from tools.bench.sounds import speech_sounds
from tools.bench.sounds.signals import RECORDINGS_COMMAND, SAMPLERATE, examine_recordings
from tools.bench.workbench import QUICK, SUBJECTS, Workbench


@pytest.mark.exhaustive
def test_no_sound_is_in_both_halves():
    require_recordings()
    recordings = examine_recordings()[0]
    one, other = (
        {item.name for item in speech_sounds.desktop(recordings)[half]}
        for half in speech_sounds.HALVES
    )
    assert one
    assert other
    assert not one & other
    assert not any("channel" in name or name.startswith(("Front", "Rear")) for name in one | other)
    one, other = (set(speech_sounds.no_speech(2.0)[half]) for half in speech_sounds.HALVES)
    assert not one & other
    speech = speech_sounds.spoken(recordings)
    assert set(speech) == set(speech_sounds.HALVES)
    seconds = sum(len(item.frames) for item in recordings if item.is_speech) / SAMPLERATE
    # Every recording once, each with a pause of 0.1 s behind it.
    assert sum(sound.size for sound in speech.values()) == pytest.approx(
        SAMPLERATE * (seconds + 0.8), abs=1.0
    )


def test_sounds_are_as_loud_while_they_sound_whatever_silence_is_beside():
    sound = tone(300, 1.0, SAMPLERATE, 0.01)
    between = speech_sounds.even(joined(silence(1.0, SAMPLERATE), sound, silence(2.0, SAMPLERATE)))
    middle = between[SAMPLERATE + 4_800 : 2 * SAMPLERATE - 4_800]
    assert 10 * np.log10((middle**2).mean()) == pytest.approx(speech_sounds.LOUDNESS_DB, abs=0.3)


@pytest.mark.exhaustive
def test_hops_with_sound_are_counted_and_belief_is_that_of_the_live_form():
    speech = joined(speech_sounds.scene_track("speech"), silence(1.0, SAMPLERATE))
    found = speech_suppression.heard(speech)
    seconds = found.sounding.sum() * found.hop_s
    assert 1.5 < seconds < 2.2
    assert found.belief.max() == pytest.approx(1.0)
    assert not speech_suppression.heard(white_noise(1.0, SAMPLERATE, 0.3)).belief.any()


@pytest.mark.exhaustive
def test_without_recordings_the_rest_is_measured_and_what_is_missing_is_named():
    found = speech_suppression.speech_suppression(Workbench(QUICK, SUBJECTS, ()))
    (gone,) = found.missing
    assert gone.command == RECORDINGS_COMMAND
    assert "recorded speech" in gone.name
    assert not any("recorded" in row.name for row in found.rows)
    values = {row.name: row.value or 0.0 for row in found.rows}
    assert values["synthetic speech, known"] > 90.0
    assert values["no speech: engine"] == 0.0
