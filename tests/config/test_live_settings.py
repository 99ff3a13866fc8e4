import dataclasses
from pathlib import Path
from typing import Any

import pytest

from audioflinger_hook.config.file import load
from audioflinger_hook.config.settings import LiveSettings
from device.errors import UsageError
from tests.support.commands import call, refused


@pytest.mark.parametrize("volume_db", [0.5, -97.0, float("nan"), float("inf"), True, "loud"])
def test_the_device_is_never_set_above_0_db(volume_db: object) -> None:
    with pytest.raises(UsageError, match=r"device_volume_db=.* allowed: -96 to 0 dB"):
        LiveSettings(device_volume_db=volume_db)  # type: ignore[arg-type]
    assert LiveSettings.refusals({"device_volume_db": volume_db}).keys() == {"device_volume_db"}


def test_a_volume_that_is_off_is_left_alone_in_the_file_and_as_an_option(tmp_path: Path) -> None:
    path = tmp_path / "config.toml"
    path.write_text('device_volume_db = "off"\n')
    assert load(path).live.device_volume_db is None
    assert LiveSettings.from_values({"device_volume_db": "off"}) == LiveSettings()
    # What `--device-volume-db off` becomes, over a file that sets one.
    loud: Any = LiveSettings(device_volume_db=-6.0)
    assert dataclasses.replace(loud, device_volume_db="off").device_volume_db is None
    for wrong in ('"of"', '"OFF"', "false"):
        path.write_text(f"device_volume_db = {wrong}\n")
        with pytest.raises(UsageError, match="allowed: -96 to 0 dB, or off"):
            load(path)


def test_a_document_of_no_mistakes_becomes_settings() -> None:
    document = {"tap": "app:a", "device_volume_db": -6, "include": ["a"], "device": "b"}
    assert LiveSettings.refusals(document) == {}
    assert LiveSettings.from_values(document) == LiveSettings(
        tap=("app:a",), device_volume_db=-6.0, include=("a",), device="b"
    )
    assert LiveSettings.from_values({}) == LiveSettings()
    assert LiveSettings(offset_ms=-5.0, drop_in=True).offset_s == -0.005


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The user's own config, which is not there yet."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    (tmp_path / "cushion").mkdir()
    return tmp_path / "cushion" / "config.toml"


def test_without_a_device_the_error_says_three_ways_to_choose_one(config: Path) -> None:
    for text in ("", "gain_db = -3\n"):
        if text:
            config.write_text(text)
        error = refused(call("run"))
        for part in ("cushion devices", "--device", f"key device in {config}"):
            assert part in error


def test_options_are_checked_as_the_config_is(config: Path) -> None:
    config.write_text('device = "haptic"\n')
    for options, words in {
        "--offset-ms 2000": "offset_ms=2000 is out of range",
        "--device-volume-db 6": "device_volume_db=6 is out of range; allowed: -96 to 0 dB",
        "--offset-ms -5": "below 0 without drop_in",
        "--tap app:a --tap default": "tap=app:a,default has several taps",
        "--device card:x": "device 'card:x' has the unknown kind",
    }.items():
        assert words in refused(call("run", *options.split()))


def test_options_win_over_the_config(
    config: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "run").mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    config.write_text('device = "hw:a"\n')
    assert "no sound card 'a'" in refused(call("run"), 3)
    assert "no sound card 'b'" in refused(call("run", "--device", "hw:b"), 3)
    config.write_text('device = "hw:a"\ntap = "sink:a"\ndrop_in = true\n')
    assert "tap 'sink:a'" in refused(call("run", "--device", "haptic"))
    assert "tap 'scene:demo'" in refused(call("run", "--device", "b", "--tap", "scene:demo"))


def test_a_config_with_mistakes_starts_no_daemon(config: Path) -> None:
    config.write_text('device = "haptic"\nblock_frames = 3\nrealtime = 1\n')
    error = refused(call("run"))
    assert f"{config}: line 2: block_frames = 3" in error
    # The command that checks without a path may read another file.
    assert f"and 1 more; see `cushion check --config {config}`" in error


def test_the_service_takes_the_device_of_the_config(
    config: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert f"key device in {config}" in refused(call("install-service"))
    config.write_text('device = "haptic"\nloud = 1\n')
    assert "unknown key" in refused(call("install-service"))
    config.write_text('device = "haptic"\n')
    unit = tmp_path / "systemd" / "user" / "cushion.service"
    for arguments, started in (
        *(((), '"run" "--wait"'), (("--device", "seat"), '"run" "--wait" "--device" "sink:seat"')),
        (("--tap", "sink:a b"), '"run" "--wait" "--tap" "sink:a b"'),
    ):
        assert call("install-service", *arguments).code == 0
        (line,) = [one for one in unit.read_text().splitlines() if one.startswith("ExecStart=")]
        assert line.endswith(f" {started}")
    link = unit.parent / "default.target.wants" / unit.name
    link.parent.mkdir()
    link.symlink_to(unit)
    assert f"systemctl --user stop {unit.name}" in call("install-service", "--remove").stdout
    assert not link.is_symlink(), "another unit of this name would start by itself"
    assert not unit.exists()
