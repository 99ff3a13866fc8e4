"""`cushion setup` on a real terminal and a real sound server: what is asked, heard and written."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config import file as config
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from tests.servers.daemons import FELT, environment, felt_now, pitch_hz
from tests.servers.listening import RATE_HZ, recording, wait_for
from tests.support.commands import cushion, refused
from tests.support.terminal import Terminal
from tools.sound_server import SoundServer

on_pulse = pytest.mark.parametrize("server", ["pulse"], indirect=True)

CTRL_C, CTRL_D = b"\x03", b"\x04"

STEPS = {"Output:": "2", "Felt it?": "y", "Played:": "2", "Write it?": "y", "Start the daemon": "n"}
"""Every question of a first run, with an answer."""

MINE = """\
# mine
gain_db = -3.0   # as I like it

[transform] # of my own
merge_ratio = 0.6
"""


def config_of(server: SoundServer) -> Path:
    return Path(server.environment["XDG_CONFIG_HOME"]) / "cushion" / "config.toml"


def written(server: SoundServer) -> list[Path]:
    """Every file in the folders of config and state that is ours."""
    folders = [server.environment[name] for name in ("XDG_CONFIG_HOME", "XDG_STATE_HOME")]
    found = [path for folder in folders for path in Path(folder).rglob("*") if path.is_file()]
    return [path for path in found if "cushion" in str(path.relative_to(server.folder))]


def set_up(server: SoundServer, *options: str) -> Terminal:
    return Terminal("setup", *options, env=environment(server))


def answer_until(terminal: Terminal, last: str) -> None:
    for question, answer in STEPS.items():
        terminal.expect(question)
        if question == last:
            return
        terminal.type("1" if question == "Output:" else answer)


def test_a_first_run_vibrates_where_it_was_told_and_writes_what_was_answered(server, tmp_path):
    with (
        recording(server, "desktop.monitor", tmp_path / "desktop") as heard,
        recording(server, "haptic.monitor", tmp_path / "haptic") as felt,
        set_up(server) as terminal,
    ):
        terminal.expect("Output:")
        assert "sink:desktop: plays the computer's sound" in terminal.shown
        terminal.type("1")
        terminal.expect("Felt it?")
        wait_for(lambda: felt_now(felt), "vibration")
        terminal.type("louder")
        terminal.expect("-18 dB. Felt it?")
        # Twice the first level is reached 2 s later at the latest.
        wait_for(lambda: float(np.abs(felt()[-4_800:]).max(initial=0.0)) > 0.12, "a louder tone")
        terminal.type("y")
        terminal.expect("Played:")
        wait_for(lambda: not felt_now(felt), "silence")
        terminal.type("2")
        terminal.expect("Write it?")
        terminal.type("")
        terminal.expect("Start the daemon")
        terminal.type("n")
        assert terminal.wait() == 0, terminal.shown
        vibration = felt()
    assert not np.any(heard())
    sounding = vibration[np.abs(vibration).max(axis=1) > FELT]
    assert pitch_hz(sounding[-RATE_HZ:]) == pytest.approx(60.0, abs=1.5)
    # It fades in: the first tenth of a second that can be felt is a tenth as strong as the end.
    assert np.abs(sounding[:4_800]).max() < 0.25 * np.abs(sounding).max()
    assert float(np.abs(vibration).max()) < 0.13  # -18 dB is 0.126
    found, mistakes = config.check(config_of(server), LIVE_DEFAULT)
    assert found is not None
    assert not mistakes
    assert found.live.device == "sink:haptic"
    assert (found.settings.profile, found.settings.gain_db) == ("game", -18.0)
    assert "will go to sink:haptic, with profile game at -18 dB" in terminal.shown
    assert "cushion run " in terminal.shown


@on_pulse
def test_without_alsas_plugin_for_servers_it_says_what_to_install_before_it_asks(server, tmp_path):
    without = environment(server) | {"ALSA_PLUGIN_DIR": str(tmp_path)}
    with Terminal("setup", env=without) as terminal:
        assert terminal.wait() == 3, terminal.shown
    assert "plugin for sound servers" in terminal.shown
    assert "libasound2-plugins" in terminal.shown
    assert "Output:" not in terminal.shown
    tone = cushion("test-tone", "--device", "sink:haptic", env=without)
    assert "libasound2-plugins" in refused(tone, code=3)


@contextmanager
def asked(server, question, folder):
    """A set-up that waits at a question, and what is felt meanwhile; the tone plays by then."""
    with recording(server, "haptic.monitor", folder / "haptic") as felt, set_up(server) as terminal:
        answer_until(terminal, question)
        if question == "Felt it?":
            wait_for(lambda: felt_now(felt), "vibration")
        yield terminal, felt


@on_pulse
@pytest.mark.parametrize(
    ("question", "key"), [("Output:", CTRL_D), *((question, CTRL_C) for question in STEPS)]
)
def test_an_interrupted_setup_has_written_nothing_and_is_silent(server, tmp_path, question, key):
    with asked(server, question, tmp_path) as (terminal, felt):
        terminal.press(key)
        assert terminal.wait() == 130, terminal.shown
        assert terminal.shown.endswith("cushion: interrupted\n")
        wait_for(lambda: not felt_now(felt), "silence")
    assert written(server) == []


@on_pulse
@pytest.mark.parametrize("question", ["Output:", "Felt it?"])
def test_a_closed_terminal_ends_the_setup_and_leaves_nothing(server, tmp_path, question):
    sinks, modules = server.names("sinks"), server.pactl("list", "short", "modules")
    with asked(server, question, tmp_path) as (terminal, felt):
        terminal.close()
        assert terminal.wait() == 130
        wait_for(lambda: not felt_now(felt), "silence")
        vibration = felt()
    # It fades out: at 60 Hz and -24 dB a sample differs from the one before by 0.0005.
    assert np.abs(np.diff(vibration, axis=0)).max(initial=0.0) < 0.001
    assert (server.names("sinks"), server.pactl("list", "short", "modules")) == (sinks, modules)
    assert written(server) == []


@on_pulse
def test_a_tone_without_questions_is_stopped_by_ctrl_c_too(server, tmp_path):
    with (
        recording(server, "desktop.monitor", tmp_path / "desktop") as heard,
        recording(server, "haptic.monitor", tmp_path / "haptic") as felt,
        set_up(server, "--yes", "--device", "haptic") as terminal,
    ):
        wait_for(lambda: felt_now(felt), "vibration")
        terminal.press(CTRL_C)
        assert terminal.wait() == 130, terminal.shown
        wait_for(lambda: not felt_now(felt), "silence")
        assert not np.any(heard())
    assert written(server) == []


@on_pulse
def test_a_tone_that_is_stopped_ends_the_setup_with_nothing_written(server, tmp_path):
    with asked(server, "Felt it?", tmp_path) as (terminal, felt):
        terminal.type("s")
        assert terminal.wait() == 0
        wait_for(lambda: not felt_now(felt), "silence")
    assert "nothing was written" in terminal.shown
    assert written(server) == []


@on_pulse
def test_the_only_sink_plays_the_sound_so_it_is_asked_before_anything_is_heard(server, tmp_path):
    server.remove("haptic")
    desktop = recording(server, "desktop.monitor", tmp_path / "desktop")
    with desktop as heard, set_up(server) as terminal:
        terminal.expect("Output:")
        terminal.type("1")
        terminal.expect("vibration would be heard there")
        terminal.expect("Use it anyway? [no]")
        terminal.type("")
        assert terminal.wait() == 3
        assert not np.any(heard())
    assert "no output for vibration was chosen, and nothing was written" in terminal.shown
    with set_up(server, "--yes") as terminal:
        assert terminal.wait() == 2
    assert "name one with --device: sink:desktop" in terminal.shown
    assert written(server) == []


def test_a_device_that_vanishes_is_reported_and_nothing_plays_elsewhere(server, tmp_path):
    desktop = recording(server, "desktop.monitor", tmp_path / "desktop")
    with desktop as heard, set_up(server) as terminal:
        answer_until(terminal, "Felt it?")
        server.remove("haptic")
        terminal.expect("the device was lost")  # nothing was answered
        terminal.expect("Output:")
        terminal.press(CTRL_C)
        assert terminal.wait() == 130
        assert not np.any(heard())


@on_pulse
def test_an_existing_config_keeps_its_comments_and_comes_back(server):
    path = config_of(server)
    path.parent.mkdir(parents=True)
    path.write_text(MINE)
    with set_up(server, "--device", "haptic", "--no-test", "--profile", "music") as terminal:
        terminal.expect('+device = "sink:haptic"')
        terminal.expect("Write it? [no]")
        terminal.type("")
        assert terminal.wait() == 0
    assert [found.read_text() for found in written(server)] == [MINE]
    options = ("--yes", "--device", "haptic", "--no-test", "--profile", "music", "--no-service")
    with set_up(server, *options) as terminal:
        assert terminal.wait() == 0, terminal.shown
    changed = path.read_text()
    assert "# as I like it" in changed
    assert "[transform] # of my own\nmerge_ratio = 0.6\n" in changed
    found, _ = config.check(path, LIVE_DEFAULT)
    assert found is not None
    assert (found.live.device, found.settings.profile) == ("sink:haptic", "music")
    assert found.settings.gain_db == -3.0
    assert path.with_name("config.toml.before-setup").read_text() == MINE
    with set_up(server, *options) as terminal:  # the same again
        assert terminal.wait() == 0
    assert "has these settings already" in terminal.shown
    assert path.read_text() == changed
    with set_up(server, "--undo") as terminal:
        assert terminal.wait() == 0, terminal.shown
    assert path.read_text() == MINE
    with set_up(server, "--undo") as terminal:
        assert terminal.wait() == 2
    assert "there is nothing to undo" in terminal.shown
