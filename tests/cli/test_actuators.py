"""Several actuators through the commands: what stands in the files of `render` and `replay`."""

import hashlib
import json
import re

import numpy as np
import pytest
import soundfile

from audioflinger_hook.capture import CaptureWriter
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.recording import facts_of, settings_from
from device.drive import ActuatorSettings
from device.drive.outputs import FADE_S
from tests.support.commands import RATE, call, listing, noise, refused, sound, vibration

TWO_SHAKERS = """\
[[actuator]]
source = "left"
channels = [0]

[[actuator]]
source = "right"
channels = [1]
"""


def tone(hz):
    """One second of a sine."""
    return np.sin(2.0 * np.pi * hz * np.arange(RATE) / RATE)


@pytest.fixture
def config(tmp_path):
    """Writes a config and returns its path."""

    def write(text):
        path = tmp_path / "config.toml"
        path.write_text(text)
        return path

    return write


@pytest.fixture
def stereo(tmp_path):
    """Sound whose left is a tone and whose right is another, of one second."""
    left, right = 0.4 * tone(110.0), 0.2 * tone(400.0)
    return sound(tmp_path / "in.wav", np.column_stack([left, right]))


def rendered(source, out, *options):
    done = call("render", source, out, "--json", *options)
    assert (done.code, done.stderr) == (0, "")
    return json.loads(done.stdout)


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_mix_on_one_channel_is_byte_for_byte_what_is_rendered_without_any_table(
    tmp_path, config, stereo
):
    plain, one = tmp_path / "plain.wav", tmp_path / "one.wav"
    report = rendered(stereo, plain)
    again = rendered(stereo, one, "--config", config("[[actuator]]\nchannels = [0]\n"))
    assert digest(plain) == digest(one)
    assert report == again


def test_a_config_without_actuators_changes_no_byte(tmp_path, config, stereo):
    plain, other = tmp_path / "plain.wav", tmp_path / "other.wav"
    options = ("--damping", "auto", "--channels", "each")
    rendered(stereo, plain, *options)
    rendered(stereo, other, *options, "--config", config('protection = "off"\n'))
    assert digest(plain) == digest(other)


def test_left_and_right_are_what_each_channel_gives_alone(tmp_path, config, stereo):
    each, two = tmp_path / "each.wav", tmp_path / "two.wav"
    rendered(stereo, each, "--channels", "each")
    report = rendered(stereo, two, "--config", config(TWO_SHAKERS))
    assert report["channels"] == 2
    assert digest(each) == digest(two)


def test_each_channel_has_its_level_polarity_and_delay_and_the_others_silence(
    tmp_path, config, stereo
):
    each, out = tmp_path / "each.wav", tmp_path / "out.wav"
    rendered(stereo, each, "--channels", "each")
    text = (
        '[[actuator]]\nsource = "right"\nchannels = [3, 0]\ngain_db = -12\n'
        '[[actuator]]\nsource = "left"\nchannels = [2]\npolarity = "inverted"\ndelay_ms = 20\n'
    )
    report = rendered(stereo, out, "--config", config(text))
    wanted, got = vibration(each), vibration(out)
    assert got.shape == (RATE, 4)
    assert report["channels"] == 4
    late = round(0.02 * RATE)
    quieter = 10.0 ** (-12.0 / 20.0) * wanted[:, 1].astype(float)
    np.testing.assert_allclose(got[:, 0], quieter, atol=1e-7)  # float32 below 1
    assert np.array_equal(got[:, 3], got[:, 0])
    assert not got[:, 1].any()
    unfaded = len(got) - round(FADE_S * RATE)
    assert np.array_equal(got[late:unfaded, 2], -wanted[: unfaded - late, 0])
    # What is felt before the sound begins is late as well.
    assert np.abs(got[:late, 2]).max() <= np.abs(wanted[:late, 0]).max()
    assert report["peak"] == float(np.abs(got).max())


def test_front_and_back_of_four_channels_are_felt_where_they_are_heard(tmp_path, config):
    sound4 = np.zeros((RATE, 4))
    sound4[:, 2:] = 0.4 * tone(110.0)[:, None]
    source = sound(tmp_path / "in.wav", sound4)
    text = (
        '[[actuator]]\nsource = "front"\nchannels = [0]\n'
        '[[actuator]]\nsource = "back"\nchannels = [1]\n'
        '[[actuator]]\nsource = "all"\nchannels = [2]\n'
    )
    rendered(source, tmp_path / "out.wav", "--config", config(text))
    got = vibration(tmp_path / "out.wav")
    assert not got[:, 0].any()
    # In the mix, surrounds are 3 dB lower than what is in front.
    loudest = np.abs(got[:, 1]).max()
    assert loudest > 0.0
    assert np.abs(got[:, 2]).max() == pytest.approx(0.5**0.5 * loudest, rel=0.01)


def test_protection_of_one_takes_no_time_from_the_others(tmp_path, config, stereo):
    plain, out = tmp_path / "plain.wav", tmp_path / "out.wav"
    rendered(stereo, plain, "--config", config(TWO_SHAKERS))
    rendered(stereo, out, "--config", config(TWO_SHAKERS + 'protection = "on"\n'))
    # Below what any rig limits protection changes nothing, and its time is taken out.
    assert np.array_equal(vibration(out), vibration(plain))


def test_the_acceleration_is_that_of_each_one_s_own_rig(tmp_path, config, stereo):
    def accelerations(text):
        path = tmp_path / "acceleration.wav"
        options = ("--acceleration", path, "--config", config(text))
        report = rendered(stereo, tmp_path / "out.wav", *options)
        return soundfile.read(path)[0], report["peak_acceleration_m_s2"]

    alike, _ = accelerations(TWO_SHAKERS)
    own, peak = accelerations(TWO_SHAKERS + 'rig = "consumer"\n')
    assert alike.shape == own.shape == (RATE, 2)
    assert np.array_equal(alike[:, 0], own[:, 0])
    assert not np.array_equal(alike[:, 1], own[:, 1])
    assert peak > 0.0


def test_replay_gives_what_render_gives_and_settings_come_back_from_a_recording(
    tmp_path, config, stereo
):
    actuators = (
        ActuatorSettings((1, "lfe"), "left", "consumer", -3.0, "inverted", 7.5),
        ActuatorSettings((0,), "right", damping="auto", protection="on"),
    )
    settings = Settings(actuators=actuators, rig="consumer")
    assert settings_from(facts_of(settings)) == settings
    assert "actuators" not in facts_of(Settings())
    with CaptureWriter(tmp_path / "cap") as writer:
        samples = soundfile.read(stereo, dtype="float32")[0]
        for number, start in enumerate(range(0, len(samples), 480)):
            writer.write_buffer("tap", samples[start : start + 480], RATE, 0.01 * number)
    path = config(TWO_SHAKERS)
    rendered(stereo, tmp_path / "one.wav", "--config", path)
    assert call("replay", tmp_path / "cap", tmp_path / "two.wav", "--config", path).code == 0
    assert digest(tmp_path / "one.wav") == digest(tmp_path / "two.wav")


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ('[[actuator]]\nchannels = ["front-left"]\n', (), "channel front-left.*numbers only"),
        (TWO_SHAKERS, ("--channels", "each"), "'each' cannot be used with .*actuator"),
        (TWO_SHAKERS + 'rig = "loud"\n', (), r"actuator\[2\].rig = \"loud\" is not known"),
        (TWO_SHAKERS.replace("[1]", "[0]"), (), r"line 7: actuator\[2\].channels = \[0\] wants"),
    ],
)
def test_what_cannot_be_is_one_line_and_leaves_no_file(
    tmp_path, config, stereo, text, options, words
):
    path = config(text)
    before = listing(tmp_path)
    done = call("render", stereo, tmp_path / "out.wav", "--config", path, *options)
    assert re.search(words, refused(done))
    assert listing(tmp_path) == before


def test_low_rates_take_actuators_but_no_protection(tmp_path, config):
    source = sound(tmp_path / "in.wav", noise(2_000, 2), 4_000)
    rendered(source, tmp_path / "out.wav", "--config", config(TWO_SHAKERS))
    path = config(TWO_SHAKERS + 'protection = "on"\n')
    error = refused(call("render", source, tmp_path / "out.wav", "--config", path))
    assert "samplerate=4000" in error
