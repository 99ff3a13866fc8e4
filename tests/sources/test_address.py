"""What a user may write for a tap, and what it opens."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.capture import CaptureWriter
from audioflinger_hook.sources import CaptureTap, FileTap, FramesTap, SceneClient, TapClient
from audioflinger_hook.sources.address import (
    GRAMMAR,
    KINDS,
    TapAddress,
    open_client,
    open_tap,
    parse_tap,
)
from device.errors import NotFoundError, UsageError
from device.wav_output import WavOutput

names = st.text(min_size=1).filter(str.strip)


@pytest.mark.parametrize(
    ("text", "kind", "name"),
    [
        ("default", "default", ""),
        ("sink:alsa_output.pci-0000_00_1f.3", "sink", "alsa_output.pci-0000_00_1f.3"),
        ("sink:default", "sink", "default"),
        ("sink:a:b", "sink", "a:b"),
        ("app:Firefox", "app", "Firefox"),
        ("file:a/b c.wav", "file", "a/b c.wav"),
        ("file:capture:x", "file", "capture:x"),
        ("capture:out", "capture", "out"),
        ("scene:demo", "scene", "demo"),
        ("alsa_output.usb", "sink", "alsa_output.usb"),
        ("demo", "sink", "demo"),
        ("Default", "sink", "Default"),
        (" default", "sink", " default"),
        ("sink: x ", "sink", " x "),
    ],
)
def test_an_address_is_taken_as_it_is_written(text, kind, name):
    assert parse_tap(text) == TapAddress(kind, name)


@given(st.sampled_from([kind for kind in KINDS if kind != "default"]), names)
def test_an_address_written_out_is_the_same_address(kind, name):
    address = TapAddress(kind, name)
    assert parse_tap(str(address)) == address


@pytest.mark.parametrize("path", ["film.wav", "d1/scene.WAV", "out/", "./film"])
def test_a_path_alone_is_refused_with_the_address_that_was_meant(path):
    with pytest.raises(UsageError, match=f"did you mean file:{path}\\?"):
        parse_tap(path)


@given(names.filter(lambda name: not set(":/.") & set(name) and name != "default"))
def test_a_word_alone_is_a_sinks_name(name):
    assert parse_tap(name) == TapAddress("sink", name)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "has an empty name"),
        (" ", "has an empty name"),
        ("sink:", "has an empty name"),
        ("file: ", "has an empty name"),
        ("default:", "has a name, but default has none"),
        ("default:x", "has a name, but default has none"),
        ("Sink:x", "unknown kind 'Sink'"),
        ("usb:1234:5678", r"unknown kind 'usb' \(for a sink of that name write sink:usb:1234"),
        (":x", "has the unknown kind ''"),
    ],
)
def test_what_is_no_address_is_refused_with_the_grammar(text, what):
    with pytest.raises(UsageError, match=what) as caught:
        parse_tap(text)
    assert f"tap {text!r}" in str(caught.value) or not text.strip()
    assert GRAMMAR in str(caught.value)
    assert caught.value.exit_code == 2


@pytest.mark.exhaustive
def test_a_file_a_capture_and_the_scene_are_opened(tmp_path):
    frames = np.ones((10, 2), np.float32)
    output = WavOutput(tmp_path / "a.wav", 48_000, 2)
    output.write(frames)
    output.close()
    with CaptureWriter(tmp_path / "c") as writer:
        writer.write_buffer("tap", frames, 48_000, 0.0)
    for text, kind, player in [
        (f"file:{tmp_path / 'a.wav'}", FileTap, TapClient),
        (f"capture:{tmp_path / 'c'}", CaptureTap, TapClient),
        ("scene:demo", FramesTap, SceneClient),
    ]:
        tap = open_tap(parse_tap(text))
        assert isinstance(tap, kind)
        assert (tap.samplerate, tap.channels) == (48_000, 2)
        assert tap.read() is not None
        tap.close()
        client = open_client(parse_tap(text))
        assert isinstance(client, player)
        assert (client.samplerate, client.channels) == (48_000, 2)
        assert client.frames_expected == tap.frames_expected
        client.close()


@pytest.mark.parametrize("opened", [open_tap, open_client])
def test_live_sound_and_another_scene_are_refused_with_what_can_be_opened(opened):
    words = r"cannot capture live sound; use file:PATH, capture:DIR or"
    for text in ("default", "sink:x", "app:Firefox", "demo"):
        with pytest.raises(NotFoundError, match=words):
            opened(parse_tap(text))
    assert NotFoundError.exit_code == 3
    with pytest.raises(UsageError, match=r"'scene:Demo': unknown scene.*scene:demo"):
        opened(parse_tap("scene:Demo"))


@pytest.mark.parametrize("text", ["file:{}/none.wav", "capture:{}/none", "capture:{}"])
@pytest.mark.parametrize("opened", [open_tap, open_client])
def test_what_cannot_be_opened_is_the_users_mistake(tmp_path, text, opened):
    with pytest.raises(UsageError, match=str(tmp_path)):
        opened(parse_tap(text.format(tmp_path)))
