"""The private ALSA configuration: PCMs by name, in a file that ends with the process."""

import ctypes
import os
import subprocess
from pathlib import Path

import pytest

from device.errors import LostError
from device.stream import pcms
from device.stream.pcms import TAG, PcmConfig, ServerDevice
from tests.support.commands import open_files
from tests.support.programs import printed


def configuration() -> str:
    return Path(os.environ["ALSA_CONFIG_PATH"]).read_text()


def test_opening_leads_a_pcm_to_its_target_and_the_environment_is_restored(monkeypatch):
    monkeypatch.setenv("PULSE_LATENCY_MSEC", "5")
    monkeypatch.setenv("PULSE_PROP", "a=b")
    before, config = dict(os.environ), PcmConfig("one", "two")
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


def test_a_stream_with_another_role_is_not_taken_for_one_of_the_vibration(monkeypatch):
    monkeypatch.setenv("PULSE_PROP", "")
    config = PcmConfig("one", role="test")
    with config.opening(config.pcms["one"], "tag-1", output=True):
        properties = dict(one.split("=") for one in os.environ["PULSE_PROP"].split())
    config.close()
    assert (properties.pop("media.role"), properties) == ("test", {"node.dont-reconnect": "true"})


def test_children_read_the_same_configuration_and_no_file_stays_open():
    before, config = open_files(), PcmConfig("one")
    for _ in range(3):
        with config.opening(config.pcms["one"], "tag", output=False):
            path = os.environ["ALSA_CONFIG_PATH"]
            assert subprocess.check_output(["cat", path], text=True) == configuration()
    config.close()
    assert open_files() == before


def test_without_memory_for_the_file_the_error_is_one_line(monkeypatch):
    def refuse(name: str) -> int:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(os, "environ", dict(os.environ))
    monkeypatch.setattr(pcms, "memory_file", refuse)
    with pytest.raises(LostError, match="Too many open files"):
        PcmConfig("one")


def test_quietening_libraries_leaves_python_its_voice():
    out, err = printed(
        "import ctypes, os, sys\n"
        "from device.stream.portaudio import filter_stderr\n"
        "print(filter_stderr(), filter_stderr())\n"
        "ctypes.CDLL(None).perror(b'library')\n"
        "os.write(2, b'ours\\n'); print('also ours', file=sys.stderr, flush=True)\n"
    )
    if out == "False False":
        pytest.skip("needs the GNU C library")
    assert (out, err) == ("True True", ["ours", "also ours"])


def test_what_plays_or_asks_is_not_loaded_by_importing_the_packages_or_finding_devices():
    out, err = printed(
        "import sys, device.server, device.stream, device.usb; device.usb.find_devices()\n"
        "print([n for n in ('pulsectl', 'pyaudio', 'usb') if n in sys.modules])"
    )
    assert out == "[]", err


def test_without_the_plugin_the_advice_names_the_package(monkeypatch):
    try:
        ctypes.CDLL("libasound.so.2")
    except OSError:
        pytest.skip("ALSA's library is not installed")
    monkeypatch.setattr(pcms, "PLUGIN", "libasound_module_pcm_nobodys.so")
    assert "install the package libasound2-plugins" in pcms.missing_plugin()
    assert pcms.missing_plugin("libnobodys.so.2") == ""  # ALSA cannot be asked
