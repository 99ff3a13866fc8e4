"""ALSA's plugin for sound servers, where it is missing."""

from __future__ import annotations

import ctypes

import pytest

from device.stream import pcms


def test_without_the_plugin_the_advice_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        ctypes.CDLL("libasound.so.2")
    except OSError:
        pytest.skip("ALSA's library is not installed")
    monkeypatch.setattr(pcms, "PLUGIN", "libasound_module_pcm_nobodys.so")
    assert "install the package libasound2-plugins" in pcms.missing_plugin()


def test_where_alsa_cannot_be_asked_nothing_is_called_missing() -> None:
    assert pcms.missing_plugin("libnobodys.so.2") == ""
