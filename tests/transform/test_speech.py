import functools

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design.speech import SpeechDesign
from tests.oracle.speech import Speech, cues
from tests.support.recordings import require_recordings
from tests.support.signals import identical, joined, low_noise, played, silence, tone, white_noise
from tests.transform.test_kernel import assert_agree

RATE = 16_000
OFF, ON = TransformParameters(), TransformParameters(speech_suppression_db=18.0)
KNOWN_S = 1.0
"""By when speech must have been recognised; `cushion bench` says by when it usually is."""


@functools.cache
def track(name):
    """Return one sound of the demo scene alone, (frames,) float64 at RATE."""
    (found,) = [each for each in demo_scene().tracks if each.name == name]
    step = found.samplerate / RATE
    mono = np.asarray(found.frames, dtype=np.float64).mean(axis=1)
    # Aliases of what lies above 8 kHz do no harm here.
    return np.interp(np.arange(0.0, mono.size - 1, step), np.arange(mono.size), mono)


@functools.cache
def talk(seconds):
    return np.resize(track("speech"), round(seconds * RATE))


def energy_db(vibration, from_s, to_s, samplerate=RATE):
    part = vibration[round(from_s * samplerate) : round(to_s * samplerate)]
    return 10.0 * np.log10((part**2).mean())


def test_recorded_speech_is_lowered_once_it_is_known():
    paths = [path for path in require_recordings() if path.stem.startswith(("Front", "Rear"))]
    sound = np.concatenate([soundfile.read(path)[0] for path in paths])
    plain, lowered = (played(sound, 48_000, parameters=p)[:, 0] for p in (OFF, ON))
    seconds = sound.size / 48_000
    before, after = (energy_db(each, KNOWN_S, seconds, 48_000) for each in (plain, lowered))
    # Of the 18 dB some is left: beginnings of words after a pause, what lies under 120 Hz.
    assert after < before - 8.0


@pytest.mark.parametrize(
    "name", ["engine", "footsteps", "explosion", "chord", "noise", "beeps", "hiss and rumble"]
)
def test_what_is_no_speech_keeps_every_byte(name):
    if name == "noise":
        sound = white_noise(2.0, RATE, 0.5)
    elif name == "hiss and rumble":
        # Everything of speech but its pitch.
        hiss, rumble = white_noise(0.12, RATE, 0.3, 1), low_noise(0.12, RATE, 0.1)
        sound = np.tile(joined(np.diff(hiss), silence(0.06, RATE), rumble), 10)
    elif name == "beeps":
        sound = np.tile(joined(tone(800, 0.15, RATE, 0.5), silence(0.15, RATE)), 8)
    else:
        sound = track(name)
    plain, same = (played(sound, RATE, parameters=p) for p in (OFF, ON))
    assert plain.any()
    assert identical(same, plain)


def test_an_explosion_is_felt_while_somebody_speaks():
    speech, effect = talk(6), np.zeros(6 * RATE)
    bang = track("explosion")[: 2 * RATE]
    effect[3 * RATE : 3 * RATE + bang.size] = bang
    alone, both = (played(sound, RATE, parameters=ON)[:, 0] for sound in (effect, effect + speech))
    assert energy_db(both, 3.0, 4.0) > energy_db(alone, 3.0, 4.0) - 2.0
    assert energy_db(both, 2.0, 3.0) < energy_db(both, 3.0, 4.0) - 15.0


def test_the_core_lowers_as_its_oracle_does():
    # Speech behind hiss and between steady notes, so that each cue is sure in part; and a bang. In
    # the first pause vibration ends, and speech is remembered; in the second it is forgotten.
    speech, bang = talk(4), np.resize(track("explosion")[:RATE], RATE)
    hiss, time = np.diff(white_noise(4.0, RATE, 0.05, 1), prepend=0.0), np.arange(4 * RATE) / RATE
    hum = np.sum([tone(130.0 * k, 4.0, RATE, 0.1 / k, 0.0) for k in range(1, 9)], axis=0)
    hum *= 1.0 + np.sin(2.0 * np.pi * 4.0 * time)
    notes = np.where(time % 1.0 < 0.5, hum, speech)
    sound = joined(speech + hiss, silence(0.8001, RATE), notes, silence(2.1, RATE))
    sound = joined(sound, talk(1), bang + talk(1))
    assert_agree(sound, RATE, parameters=ON)


def test_after_a_long_silence_nothing_is_remembered():
    first = played(talk(3), RATE, parameters=ON)
    twice = played(joined(talk(3), silence(3.2179, RATE), talk(3)), RATE, parameters=ON)
    assert identical(twice[-len(first) :], first)


def test_belief_does_not_depend_on_the_volume():
    def beliefs(level):
        speech, heard = Speech(DESIGN), []
        for hop in cues(DESIGN, spectra(level * talk(4))):
            speech.hear(*hop)
            heard.append(speech.belief)
        return np.array(heard)[round(KNOWN_S / HOP_S) :]

    loud = beliefs(1.0)
    assert loud.max() == 1.0
    # The floor of all levels is all that does not follow the volume; 20 dB down little is felt.
    assert np.abs(beliefs(0.1) - loud).max() < 0.1


BIN_HZ, BINS, HOP_S = 10.0, 800, 0.017
DESIGN = SpeechDesign.of(18.0, BIN_HZ, BINS, HOP_S)


def spectra(sound):
    """Return (hops, BINS) spectra as the live form makes them, a full-scale sine having 1."""
    frames, hop = round(0.04643 * RATE), round(HOP_S * RATE)
    window = np.hamming(frames)
    windows = np.lib.stride_tricks.sliding_window_view(sound, frames)[::hop] * window
    return np.fft.rfft(windows, round(RATE / BIN_HZ))[:, :BINS] * (2.0 / window.sum())


def convinced():
    """Return what is remembered in the middle of a clear vowel, sure of speech."""
    speech = Speech(DESIGN)
    for hop in cues(DESIGN, spectra(talk(4))):
        speech.hear(*hop)
        if speech.belief == 1.0 and speech.voiced == 1.0 and speech.balance > 9.0:
            return speech
    raise AssertionError("no hop like that")


def test_harmonics_of_a_voice_are_lowered_and_neither_what_lies_between_nor_what_hides_it():
    speech = convinced()
    pitch_hz = float(np.exp(speech.log_pitch))
    assert 100.0 < pitch_hz < 160.0  # the speaker's
    on, between = speech.gains(pitch_hz * np.array([[3.0, 4.0], [3.5, 4.5]]).ravel()).reshape(2, 2)
    assert (on < 10 ** (-14.0 / 20.0)).all()
    assert (between == 1.0).all()
    # What is known coarsely alone may be either.
    assert (speech.gains(pitch_hz * np.array([3.5, 4.5]), coarse=True) < 0.2).all()
    speech = convinced()
    # A flat spectrum is a click's.
    speech.hear(*cues(DESIGN, np.full((1, BINS), 0.3 + 0.0j))[0])
    assert (speech.belief, speech.voiced) == (1.0, 0.0)
    assert (speech.gains(np.array([150.0, 300.0, 700.0, 2_000.0])) > 0.99).all()


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["nothing", "silence", "noise", "comb", "flat", "denormal", "huge"]),
            st.integers(0, 200),
        ),
        max_size=60,
    ),
    st.floats(0.0, 24.0),
)
@settings(max_examples=100)
def test_every_gain_is_a_number_between_the_suppression_and_one(hops, suppression_db):
    design = SpeechDesign.of(suppression_db, BIN_HZ, BINS, HOP_S)
    speech = Speech(design)
    audio_hz = np.array([20.0, 50.0, 79.0, 100.0, 123.0, 200.0, 999.0, 4_000.0, 19_000.0])
    for kind, number in hops:
        level = {"silence": 0.0, "flat": 1e-3, "denormal": 1e-300, "huge": 1e6j}.get(kind, 1.0)
        spectrum = np.full(BINS, level, dtype=complex)
        if kind == "noise":
            spectrum *= np.random.default_rng(number).standard_normal(BINS)
        elif kind == "comb":
            spectrum *= 0.1 * (np.arange(BINS) % (8 + number % 20) == 0)
        if kind == "nothing":
            speech.pause()
        else:
            speech.hear(*cues(design, spectrum[None])[0])
        gains = speech.gains(audio_hz)
        assert (gains >= 10 ** (-suppression_db / 20) * (1 - 1e-12)).all()
        assert (gains <= 1.0).all()
        assert (gains[:3] == 1.0).all()  # under 80 Hz nothing is a voice's
        assert 0.0 <= speech.belief <= 1.0
