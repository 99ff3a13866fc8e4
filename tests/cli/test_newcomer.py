"""What somebody meets who types their first commands."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook import HapticTransform
from device.errors import UsageError
from tests.support.commands import RATE, call, cushion, refused
from tests.support.terminal import Terminal

SIMULATED = ("run", "--tap", "scene:demo", "--device", "twin", "--seconds", "1")


@pytest.fixture
def sound(tmp_path: Path) -> Path:
    path = tmp_path / "scene.wav"
    soundfile.write(path, 0.1 * np.sin(np.arange(RATE) / 50.0), RATE)
    return path


def test_a_simulated_run_needs_no_sound_server_and_no_runtime_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("PULSE_SERVER", "unix:/nonexistent")
    done = cushion(*SIMULATED)
    assert done.code == 0, done.stderr
    assert "peak acceleration" in done.stdout


def test_a_wrong_line_of_a_config_is_named_with_its_file(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text('gain_db = "loud"\n')
    error = refused(call("run", "--config", bad))
    assert f"{bad}: line 1: gain_db" in error
    # the command that checks without a path reads another file
    assert "`cushion check`" not in error


def test_removing_a_service_twice_says_that_none_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    for _ in range(2):
        done = call("install-service", "--remove")
        assert (done.code, done.stderr) == (0, "")
        assert "was not installed" in done.stdout
        assert "next, type:" not in done.stdout


@pytest.mark.parametrize("command", ["dump", "capture"])
def test_the_help_names_only_taps_that_the_command_takes(command: str) -> None:
    told = " ".join(call(command, "--help").stdout.split())
    live = "sink:NAME" in told or "app:NAME" in told
    assert live == (command == "capture")


@pytest.mark.parametrize("name", ["vibration.mp3", "vibration.flac", "vibration.ogg"])
def test_a_name_never_promises_another_format_than_its_bytes(
    sound: Path, tmp_path: Path, name: str
) -> None:
    error = refused(call("render", sound, tmp_path / name))
    assert "written as WAV" in error
    assert not (tmp_path / name).exists()


def test_a_moment_after_the_end_is_refused_by_every_command(sound: Path) -> None:
    for arguments in (("dump", "--tap", f"file:{sound}"), ("inspect", sound)):
        error = refused(call(*arguments, "--at", "300"))
        assert "time 300 s is after the end of the sound; allowed: 0 to 1.000 s" in error


def test_what_is_not_there_has_the_same_exit_code_as_a_file_and_as_a_scene(
    tmp_path: Path,
) -> None:
    assert "unknown scene" in refused(call("dump", "--tap", "scene:nope"), 2)
    assert "unknown scene" in refused(call("run", "--tap", "scene:nope", "--device", "twin"), 2)
    assert "does not exist" in refused(call("render", "/nope.wav", tmp_path / "out.wav"), 2)


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (("rendr",), "render"),
        (("render", "in.wav", "out.wav", "--profile", "cinma"), "cinema"),
        (("run", "--profile", "muisc"), "music"),
    ],
)
def test_a_mistyped_word_is_answered_with_the_nearest_one(
    arguments: tuple[str, ...], meant: str
) -> None:
    assert f"did you mean {meant}?" in refused(call(*arguments))


def test_a_path_without_its_kind_is_offered_as_a_file(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(sound.parent.parent)
    path = sound.relative_to(sound.parent.parent)
    assert f"did you mean file:{path}?" in refused(call("dump", "--tap", path))


def test_a_list_is_taken_or_refused_in_words_but_never_an_attribute_error() -> None:
    transform = HapticTransform(RATE, channels=1)
    with pytest.raises(UsageError, match="not sound in full scale"):
        transform.process([1, 2, 3])  # type: ignore[arg-type]


def test_the_table_of_a_dump_fits_120_columns() -> None:
    assert max(map(len, call("dump").stdout.splitlines())) <= 120


def test_a_run_on_a_terminal_shows_its_level() -> None:
    with Terminal(*SIMULATED, env={"TERM": "xterm", "COLUMNS": "100"}) as terminal:
        terminal.expect("█")
        terminal.expect(" → ")


@pytest.mark.parametrize("command", ["render", "run", "dump", "catalogue", "export", "monitor"])
def test_a_commands_help_ends_with_an_example_and_leaves_the_exit_codes_to_the_whole(
    command: str,
) -> None:
    told = call(command, "--help").stdout
    assert told.rstrip().split("\n\n")[-1].startswith(f"example: cushion {command}")
    assert "130" not in told


def test_no_error_is_longer_than_a_few_lines_of_a_terminal() -> None:
    for word in ("bench", "", "x" * 400):
        assert len(refused(call(word))) < 800
