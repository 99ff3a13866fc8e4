import shutil
from pathlib import Path

import pytest

from audioflinger_hook.cli.terminal import as_typed
from tests.support.commands import call, cushion, noise, refused, sound


def test_a_simulated_run_needs_no_server_and_no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("PULSE_SERVER", "unix:/nonexistent")
    done = cushion("run", "--tap", "scene:demo", "--device", "twin", "--seconds", "0.2")
    assert done.code == 0, done.stderr
    assert "peak acceleration" in done.stdout


def test_removing_no_service_says_so_and_the_rule_for_usb_devices_needs_no_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    removed, ruled = (call("install-service", option) for option in ("--remove", "--udev"))
    assert (removed.code, removed.stderr) == (ruled.code, ruled.stderr) == (0, "")
    assert "was not installed" in removed.stdout
    assert "next, type:" not in removed.stdout
    assert "70-cushion.rules" in ruled.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["dump", "capture"])
def test_the_help_names_only_taps_that_the_command_takes(command: str) -> None:
    told = " ".join(call(command, "--help").stdout.split())
    live = "sink:NAME" in told or "app:NAME" in told
    assert live == (command == "capture")


@pytest.mark.parametrize("name", ["vibration.mp3", "vibration.flac", "vibration.ogg"])
def test_a_name_never_promises_another_format_than_its_bytes(tmp_path: Path, name: str) -> None:
    error = refused(call("render", sound(tmp_path / "in.wav", noise(500)), tmp_path / name))
    assert "written as WAV; allowed: a name that ends in .wav, .wave, .rf64" in error
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    "command",
    ["demo", "render", "inspect", "check", "run", "dump", "catalogue", "export", "monitor"],
)
def test_a_commands_help_ends_with_an_example_and_without_the_exit_codes(command: str) -> None:
    done = call(command, "--help")
    assert (done.code, done.stderr) == (0, "")
    assert done.stdout.rstrip().split("\n\n")[-1].startswith(f"example: cushion {command}")
    assert "130" not in done.stdout
    whole = " ".join(call("--help").stdout.split())
    assert command in whole
    assert "130 interrupted" in whole


def test_no_error_is_longer_than_a_few_lines_of_a_terminal() -> None:
    for word in ("bench", "", "x" * 400):
        assert len(refused(call(word))) < 800


@pytest.mark.parametrize(
    ("started", "found", "expected"),
    [
        (".venv/bin/cushion", None, ".venv/bin/cushion setup"),
        ("/home/a b/cushion", None, "'/home/a b/cushion' setup"),
        (".venv/bin/cushion", "/usr/bin/cushion", "cushion setup"),
        ("/usr/lib/audioflinger_hook/__main__.py", None, "cushion setup"),
    ],
)
def test_a_command_to_type_has_the_path_that_the_shell_needs(monkeypatch, started, found, expected):
    monkeypatch.setattr("sys.argv", [started])
    monkeypatch.setattr(shutil, "which", lambda _: found)
    assert as_typed("setup") == expected
