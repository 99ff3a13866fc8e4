import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config import file as config
from audioflinger_hook.config import profiles
from audioflinger_hook.config.profiles import LIVE_DEFAULT, PROFILES, parameters_of, values_of
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.recording import facts_of, settings_from
from audioflinger_hook.offline.render import render_file
from audioflinger_hook.transform import HapticTransform, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from device.drive import ActuatorSettings
from device.errors import UsageError
from tests.support import signals
from tests.support.commands import call, document, noise, sound
from tests.support.signals import joined, one_sample, played, silence, tone, white_noise
from tests.transform.test_kernel import SOUNDS, assert_agree

OTHERS = [name for name in PROFILES if name != "paper"]
RATES = [rate for rate in signals.SAMPLERATES if rate != 48_000]


def test_the_default_is_the_paper_s_and_changes_nothing():
    assert len({parameters_of(name) for name in PROFILES}) == len(PROFILES), "all are different"
    assert next(iter(PROFILES)) == Settings().profile == "paper"
    assert values_of("paper") == {}
    assert parameters_of("paper") == TransformParameters() == Settings().parameters
    assert tuple(PROFILES) == ("paper", "cinema", "game", "music", "speech")


@pytest.mark.parametrize("name", OTHERS)
def test_a_profile_says_something_else_than_the_paper_and_why(name):
    for parameter, choice in PROFILES[name].items():
        assert choice.value != getattr(TransformParameters(), parameter), parameter
        assert len(choice.reason) > 20
    assert Settings(profile=name).parameters == parameters_of(name)


def loaded(tmp_path, text):
    path = tmp_path / "config.toml"
    path.write_text(text)
    return config.load(path).settings


def test_what_a_config_says_goes_over_the_profile_and_the_rest_is_the_profile_s(tmp_path):
    settings = loaded(tmp_path, 'profile = "game"\n[transform]\npartials_max = 3\n')
    assert settings.parameters == parameters_of("game", {"partials_max": 3})
    assert settings.parameters.window_s == 0.033
    assert settings.choosing(gain_db=-3.0).parameters == settings.parameters
    other = settings.choosing(profile="music").parameters
    assert other == parameters_of("music", {"partials_max": 3})
    assert Settings(profile="game").choosing(profile="paper") == Settings()


def test_even_the_paper_s_own_value_goes_over_the_profile_where_a_config_says_it(tmp_path):
    own = {name: getattr(TransformParameters(), name) for name in values_of("game")}
    said = "\n".join(f"{name} = {json.dumps(value)}" for name, value in own.items())
    settings = loaded(tmp_path, f'profile = "game"\n[transform]\n{said}\n')
    assert (settings.profile, settings.parameters) == ("game", TransformParameters())


@pytest.mark.parametrize("wrong", ["Cinema", "", "loud"])
@pytest.mark.parametrize("made", [Settings, Settings().choosing])
def test_a_profile_that_does_not_exist_is_refused_with_those_that_do(wrong, made):
    with pytest.raises(UsageError, match=r"profile=.*allowed: paper, cinema, game, music, speech"):
        made(profile=wrong)


@pytest.mark.parametrize("name", PROFILES)
def test_a_recording_s_facts_bring_the_profile_and_what_was_said_back(name):
    said = {"partials_max": 5, "mapping": "jnd"}
    settings = Settings(profile=name, parameters=parameters_of(name, said), said=tuple(said))
    again = settings_from(facts_of(settings))
    assert again == settings
    assert again.choosing(profile="paper").parameters == parameters_of("paper", said)


@pytest.mark.parametrize("name", PROFILES)
def test_render_plays_a_profile_and_tells_its_name(tmp_path, name):
    source, out, again = (tmp_path / one for one in ("in.wav", "out.wav", "again.wav"))
    sound(source, noise(20_000, 1))
    assert document("render", source, out, "--profile", name)["profile"] == name
    report = render_file(source, again, Settings(profile=name))
    assert (report.profile, again.read_bytes()) == (name, out.read_bytes())
    assert report.latency_s == HapticTransform(48_000, 1, parameters_of(name)).latency_s


def test_commands_on_files_take_the_paper_s_profile_unless_one_is_named(tmp_path):
    source, path = sound(tmp_path / "in.wav", noise(20_000, 1)), tmp_path / "config.toml"
    assert call("capture", tmp_path / "cap", "--tap", f"file:{source}").code == 0
    for command in (("render", source), ("replay", tmp_path / "cap")):
        for text, options, name in (
            ("gain_db = 0\n", (), profiles.OFFLINE_DEFAULT),
            ("gain_db = 0\n", ("--config", path), "paper"),
            ('profile = "game"\n', ("--config", path), "game"),
            ('profile = "game"\n', ("--config", path, "--profile", "paper"), "paper"),
        ):
            path.write_text(text)
            assert document(*command, tmp_path / "out.wav", *options)["profile"] == name


def test_a_config_that_names_no_profile_is_checked_and_loaded_with_the_command_s(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text("[transform]\npartials_max = 3\n")
    for default in PROFILES:
        settings = config.load(path, default).settings
        assert settings.profile == default
        assert settings.parameters == parameters_of(default, {"partials_max": 3})
    path.write_text("[transform]\nvibration_top_hz = 60\n")
    assert config.check(path, LIVE_DEFAULT)[1] == []
    assert "= 60 leaves no room above 1/window_s=30.3 Hz" in str(config.check(path, "game")[1][0])


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("samplerate", [8_000, pytest.param(48_000, marks=pytest.mark.exhaustive)])
def test_twins_agree_with_every_profile(name, samplerate):
    for kind in ("noise", "sweep", "gaps", "bursts", "clicks", "swelling", "a tone 60 dB over"):
        assert_agree(SOUNDS[kind](samplerate), samplerate, parameters=parameters_of(name))


@pytest.mark.parametrize(
    "samplerate", [48_000, *(pytest.param(rate, marks=pytest.mark.exhaustive) for rate in RATES)]
)
@pytest.mark.parametrize("name", OTHERS)
def test_hard_sounds_stay_finite_and_under_full_scale_at_every_samplerate(name, samplerate):
    parameters = parameters_of(name)
    assert not played(silence(0.2, samplerate), samplerate, parameters=parameters).any()
    damaged = white_noise(0.2, samplerate, 1.0)
    damaged[::5] = np.nan
    for mix in (
        *(white_noise(0.3, samplerate), signals.square(83, 0.3, samplerate), damaged),
        *(np.full(samplerate // 4, constant) for constant in (1.0, 1e-310)),
        one_sample(0.2, samplerate, 0.1),
        joined(tone(60, 0.2, samplerate), tone(samplerate / 3, 0.2, samplerate, 900.0)),
    ):
        vibration = played(mix, samplerate, parameters=parameters)
        assert np.isfinite(vibration).all()
        assert np.abs(vibration).max() < 1.0


@pytest.mark.parametrize("name", OTHERS)
def test_what_a_profile_plays_is_not_heard(name):
    mix = joined(
        white_noise(0.15, 48_000, 0.8),
        silence(0.55, 48_000),
        tone(310, 0.2, 48_000, 0.05),
        one_sample(0.1, 48_000, 0.03),
        tone(900, 0.15, 48_000, 0.7),
        silence(1.0, 48_000),
    )
    vibration = played(mix, 48_000, parameters=parameters_of(name))[:, 0]
    # What begins at once is as strong as it is loud within 2 ms, which leaves a little; half a
    # second of real sounds leaves under -55 dB.
    assert signals.energy_above_db(vibration, 250, 48_000) < -41


@pytest.mark.parametrize("name", OTHERS)
@pytest.mark.parametrize("hz", [55.0, 80.0, 150.0, 440.0])
def test_a_tone_is_pure_with_every_profile(name, hz):
    # A lower C_th lets side lobes of a loud low tone through; without care they are 40 dB down.
    parameters = parameters_of(name)
    hz = max(hz, 1.1 * parameters.band_low_hz)
    # In 0.2 s the programme's level moves by 0.06 dB at most. The end of a tone is felt at once.
    vibration = played(tone(hz, 4.0, 48_000, 0.5), 48_000, parameters=parameters)[:, 0]
    steady, rate = signals.thinned(vibration[-12_000:-2_400], 48_000)
    wanted_hz = float(vibration_hz(np.array(hz), parameters))
    found_hz, _, residual_db = signals.best_sinusoid(steady, rate, wanted_hz)
    assert found_hz == pytest.approx(wanted_hz, abs=0.01)
    # Windows of a low tone hold few cycles and differ a little in loudness: 0.05 dB at 55 Hz. A
    # narrow dead band lets some of what a tone wavers through.
    assert residual_db < (-45 if hz < 60 else -60 if parameters.jitter_db > 2.0 else -55)


@pytest.mark.parametrize("name", ["cinema", "game", "music"])
def test_a_profile_levels_the_resonance_of_a_rig_that_is_set(name: str) -> None:
    plain = Settings(profile=name)
    assert plain.transform_parameters.strength == "felt"
    for settings in (
        *(replace(plain, rig="consumer"), replace(plain, damping="auto")),
        replace(plain, protection="on"),
    ):
        levelled = settings.transform_parameters
        assert levelled.strength == "rig"
        assert levelled.resonance_hz > 0.0
        assert replace(settings, said=("strength",)).transform_parameters.strength == "felt"
    assert Settings(profile="paper", rig="consumer").transform_parameters.strength == "flat"
    felt = TransformParameters(strength="felt")
    assert Settings(profile="paper", damping="auto", parameters=felt).transform_parameters == felt


def test_the_rig_that_is_levelled_is_that_of_the_actuators_if_they_have_one() -> None:
    first, second = (ActuatorSettings((channel,), rig="consumer") for channel in (0, 1))
    alike = Settings(profile="cinema", damping="auto", actuators=(first, second))
    consumer = Settings(profile="cinema", damping="auto", rig="consumer")
    assert alike.transform_parameters == consumer.transform_parameters
    for other in (replace(second, rig="paper"), replace(second, damping="off")):
        assert replace(alike, actuators=(first, other)).transform_parameters.strength == "felt"
    damped = replace(alike, damping="off", actuators=(replace(first, damping="auto"),))
    assert damped.transform_parameters == consumer.transform_parameters


def test_a_rig_s_file_is_read_once(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes((files("device.rig") / "consumer.toml").read_bytes())
    settings = Settings(profile="cinema", rig=str(path))
    known = settings.transform_parameters
    path.unlink()
    assert settings.transform_parameters == known


def test_strength_rig_takes_the_rig_s_resonance_unless_one_is_set() -> None:
    settings = Settings(parameters=TransformParameters(strength="rig"))
    free, damped = (replace(settings, damping=one).transform_parameters for one in ("off", "auto"))
    assert free.resonance_hz == pytest.approx(91.8, abs=0.1)  # with the coil's inductance
    assert free.resonance_q > 2.0
    assert damped.resonance_q == 0.35
    # damping makes up for what it takes at the resonance
    gain = damped.resonance_q * 10.0 ** (damped.resonance_gain_db / 20.0)
    assert (gain, free.resonance_gain_db) == (pytest.approx(free.resonance_q), 0.0)
    assert replace(settings, rig="consumer").transform_parameters.resonance_hz < 60.0
    own = TransformParameters(strength="rig", resonance_hz=50.0, resonance_q=2.0)
    assert replace(settings, parameters=own).transform_parameters == own
    assert Settings(parameters=TransformParameters()).transform_parameters == TransformParameters()
