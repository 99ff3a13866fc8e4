"""The private ALSA configuration: PCMs by name, in a file that ends with the process."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from device.errors import LostError
from device.stream import pcms
from device.stream.pcms import TAG, PcmConfig, ServerDevice
from tests.support.commands import open_files


def configuration() -> str:
    return Path(os.environ["ALSA_CONFIG_PATH"]).read_text()


def test_opening_leads_a_pcm_to_its_target_and_the_environment_is_restored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PULSE_LATENCY_MSEC", "5")
    monkeypatch.setenv("PULSE_PROP", "a=b")
    before = dict(os.environ)
    config = PcmConfig("one", "two")
    first = os.environ["ALSA_CONFIG_PATH"]
    assert "PULSE_LATENCY_MSEC" not in os.environ
    assert "pcm.one { type null }" in configuration()
    config.pcms["one"].target = ServerDevice("haptic", "unix:/run/x")
    with config.opening(config.pcms["one"], "tag-1", output=True):
        assert os.environ["ALSA_CONFIG_PATH"] != first  # ALSA reads only a new path again
        text = configuration().splitlines()
        assert text[0] == 'pcm.one { type pulse device "haptic" server "unix:/run/x" }'
        assert text[1:] == ["pcm.two { type null }", "pcm.default { type null }"]
        assert os.environ["PULSE_PROP"].startswith("a=b application.id=")
        assert f"{TAG}=tag-1" in os.environ["PULSE_PROP"]
    assert os.environ["PULSE_PROP"] == "a=b"
    config.close()
    config.close()
    assert dict(os.environ) == before


def test_children_read_the_same_configuration_and_no_file_stays_open() -> None:
    before = open_files()
    config = PcmConfig("one")
    for _ in range(3):
        with config.opening(config.pcms["one"], "tag", output=False):
            path = os.environ["ALSA_CONFIG_PATH"]
            assert subprocess.check_output(["cat", path], text=True) == configuration()
    config.close()
    assert open_files() == before


def test_without_memory_for_the_file_the_error_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> int:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(pcms, "memory_file", refuse)
    before = dict(os.environ)
    with pytest.raises(LostError, match="Too many open files"):
        PcmConfig("one")
    os.environ.clear()
    os.environ.update(before)
