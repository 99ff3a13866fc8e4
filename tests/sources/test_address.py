import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.sources.address import GRAMMAR, KINDS, TapAddress, parse_tap
from device.errors import UsageError

names = st.text(min_size=1).filter(str.strip)


@pytest.mark.parametrize(
    ("text", "kind", "name"),
    [
        ("default", "default", ""),
        *((f"sink:{name}", "sink", name) for name in ("default", "a:b", " x ")),
        *((name, "sink", name) for name in ("alsa_output.usb", "demo", "Default", " default")),
        *(("app:Firefox", "app", "Firefox"), ("file:a/b c.wav", "file", "a/b c.wav")),
        *(("file:capture:x", "file", "capture:x"), ("capture:out", "capture", "out")),
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
        *((text, "has an empty name") for text in ("", " ", "sink:", "file: ")),
        *((text, "has a name, but default has none") for text in ("default:", "default:x")),
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
