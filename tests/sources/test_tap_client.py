import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal.windows import blackmanharris

from audioflinger_hook.capture import CaptureWriter
from audioflinger_hook.mixer.resampler import tail_frames_out
from audioflinger_hook.sources import FramesTap, Tap, TapClient
from audioflinger_hook.sources.address import GRAMMAR, KINDS, TapAddress, parse_tap
from audioflinger_hook.sources.file import CaptureTap
from device.errors import UsageError
from tests.support.taps import BufferTap, cut, mixed, mixer_for, noise

RATE = 48_000


def tone(hz, frames, samplerate, first=0.0):
    """A steady tone of half full scale, one channel, from frame number `first` on."""
    phase = 2 * np.pi * hz / samplerate * (np.arange(frames) + first)
    return (0.5 * np.sin(phase)).astype(np.float32)[:, None]


def connected(tap, samplerate=0, channels=0):
    """A client on a mix of its own, by default the one that suits it."""
    client = TapClient(tap)
    return client, mixer_for(client, samplerate, channels)


def heard(client, mixer):
    blocks = mixed(client, mixer)
    assert client.play() is None
    return blocks


@settings(max_examples=60)
@given(
    st.lists(st.one_of(st.just(0), st.integers(1, 200), st.integers(900, 4_000)), max_size=12),
    st.sampled_from([1, 2, 6]),
    st.sampled_from([8_000, 44_100, 48_000]),
)
def test_sound_passes_bit_for_bit_through_any_split_into_buffers(lengths, channels, samplerate):
    frames = noise(5_000, channels)
    odd = [np.nan, np.inf, -np.inf, -0.0, 1e-44, 3e38, -1_000.0]
    frames[: len(odd), 0] = odd
    client, mixer = connected(cut(frames, lengths, samplerate))
    assert np.concatenate(heard(client, mixer)).tobytes() == frames.tobytes()
    assert client.buffers == len(lengths) + 1


def test_a_buffer_is_one_cycle_or_as_few_as_can_be_and_expectations_are_the_tap_s():
    lengths = [1, 959, 960, 961, 0, 2_000]
    client, mixer = connected(cut(noise(sum(lengths)), lengths))
    assert mixer.frames == 960
    done = []
    while played := client.play():
        mixer.cycle(0.0, played)
        done.append((played, client.buffers))
    assert done == [(1, 1), (959, 2), (960, 3), (960, 4), (1, 4), (960, 6), (960, 6), (80, 6)]
    tap = cut(noise(500), [100])
    client = TapClient(tap)
    assert client.frames_expected == 500
    client.close()
    assert tap.closed == 1


@pytest.mark.parametrize("lengths", [[], [1] * 50, [0, 7, 441, 0, 5_000, 33]])
@pytest.mark.parametrize("samplerate", [8_000, 44_100, 44_101, 96_000])
def test_a_tone_of_another_rate_is_the_same_tone_without_a_gap(samplerate, lengths):
    frames = tone(1_000.0, samplerate // 2, samplerate)
    client, mixer = connected(cut(frames, lengths, samplerate), RATE, 1)
    made, tail = np.concatenate(heard(client, mixer)), tail_frames_out(samplerate, RATE)
    assert len(made) == math.ceil(len(frames) * RATE / samplerate) + tail
    # The resampler's own latency apart, every frame is where the tone is, but for its two ends.
    late = 64 * max(1.0, samplerate / RATE)  # in frames of the track: half the filter
    wanted = tone(1_000.0, len(made), RATE, -late * RATE / samplerate)
    inner = slice(2 * tail + 1, -2 * tail - 1)
    assert np.abs(made[inner] - wanted[inner]).max() < 1e-4
    # Nothing else in its spectrum: a gap or a repeated frame would leave -60 dB and more.
    seen = made[inner, 0] * blackmanharris(len(made[inner]))
    power, hz = np.abs(np.fft.rfft(seen)) ** 2, np.fft.rfftfreq(len(seen), 1 / RATE)
    assert power[np.abs(hz - 1_000.0) > 20.0].max() < 1e-8 * power.max()


@pytest.mark.parametrize("frames", [40, 4_800])
def test_the_rest_of_a_former_rate_sounds_under_what_follows(frames):
    click = np.zeros((4_410, 1), np.float32)
    click[-70] = 1.0
    silence = np.zeros((frames, 1), np.float32)
    client, mixer = connected(BufferTap((click, 44_100, False), (silence, RATE, False)), RATE)
    tail = tail_frames_out(44_100, RATE)
    assert 40 < tail < 4_800
    made = np.concatenate(heard(client, mixer))
    assert len(made) == 4_410 * RATE // 44_100 + max(frames, tail)
    assert made.sum() == pytest.approx(RATE / 44_100, rel=1e-3)


@pytest.mark.parametrize("samplerate", [1_000, 8_000, 44_100, 192_000])
def test_what_is_played_last_is_heard_too_however_long_the_resampler_holds_it(samplerate):
    frames = np.zeros((samplerate, 1), np.float32)
    frames[-round(64 * max(1, samplerate / RATE)) - 8] = 1.0  # the filter's half is heard after it
    client, mixer = connected(FramesTap(frames, samplerate, 100), RATE, 1)
    made = np.concatenate(heard(client, mixer))
    assert made.sum() == pytest.approx(RATE / samplerate, rel=1e-3)
    assert abs(made[-1, 0]) < 1e-3


@given(st.lists(st.integers(0, 2_500), max_size=10))
@settings(max_examples=20)
def test_the_split_into_buffers_changes_no_bit_of_resampled_sound(lengths):
    taps = [cut(noise(6_000, 2), split, 44_100) for split in (lengths, lengths[:0])]
    made = [np.concatenate(heard(*connected(tap, RATE, 2))).tobytes() for tap in taps]
    assert made[0] == made[1]


def test_another_format_goes_on_in_the_mix_of_the_first():
    stereo, mono = noise(2_000, 2), tone(500.0, 22_050, 44_100)
    tap = BufferTap(
        (stereo, RATE, False),
        *[(mono[first : first + 441], 44_100, False) for first in range(0, 22_050, 441)],
        (noise(700, 6), RATE, True),
        (noise(0, 6), RATE, False),
        (stereo[:960], RATE, True),
    )
    client, mixer = connected(tap)
    made = np.concatenate(heard(client, mixer))
    assert (mixer.samplerate, mixer.channels) == (RATE, 2)
    mixer.cycle(0.0)
    assert len(mixer.tracks) == 1, "tracks of formats that are over leave"
    assert made.shape == (2_000 + 24_000 + 700 + 960, 2)
    assert made[:2_000].tobytes() == stereo.tobytes()
    second = made[2_000:26_000]
    assert np.array_equal(second[:, 0], second[:, 1])
    wanted = tone(500.0, 24_000, RATE, -64 * RATE / 44_100)
    assert np.abs(second[200:, :1] - wanted[200:]).max() < 1e-4
    assert np.abs(made[26_100:26_700]).max() > 0.1  # six channels, folded
    assert np.array_equal(made[26_700:], stereo[:960])
    assert (client.buffers, client.format_changes, client.discontinuities) == (1 + 50 + 3, 3, 2)


def captured(folder, *buffers, stream="tap"):
    with CaptureWriter(folder, streams=(stream,)) as writer:
        for frames in buffers:
            writer.write_buffer(stream, frames, 48_000, 0.0)
    return folder


def test_buffers_formats_times_and_discontinuities_are_those_delivered(tmp_path):
    delivered = [
        *((noise(480), 48_000, 10.0, False), (noise(0), 48_000, 10.25, False)),
        *((noise(7, seed=1), 48_000, 10.5, True), (noise(5, 1), 48_000, 10.75, False)),
        *((noise(5, 1, 2), 44_100, 11.0, False), (noise(9, 1, 3), 44_100, 11.5, False)),
    ]
    with CaptureWriter(tmp_path) as writer:
        for frames, samplerate, time_s, discontinuity in delivered:
            writer.write_buffer("tap", frames, samplerate, time_s, discontinuity=discontinuity)
    tap = CaptureTap(tmp_path)
    as_a_tap: Tap = tap
    assert (as_a_tap.samplerate, as_a_tap.channels) == (48_000, 2)
    assert as_a_tap.frames_expected == 480 + 7 + 5 + 5 + 9
    found, changes = [], []
    while (buffer := tap.read()) is not None:
        assert buffer.shape[1] == tap.channels
        found.append((buffer.tobytes(), tap.samplerate, tap.time_s, tap.discontinuity))
        changes.append(tap.format_changed)
    assert found == [(frames.tobytes(), *rest) for frames, *rest in delivered]
    assert changes == [False, False, False, True, True, False]
    assert tap.read() is None
    assert tap.warnings == []
    tap.close()
    tap.close()
    assert tap.read() is None


def test_a_capture_without_sound_is_refused(tmp_path):
    for name, buffers in (("a", []), ("b", [noise(0)]), ("c", [noise(0), noise(0, 1)])):
        with pytest.raises(UsageError, match=r"has no sound \(0 frames\)"):
            CaptureTap(captured(tmp_path / name, *buffers))
    (tmp_path / "d").mkdir()
    (tmp_path / "d/index.jsonl").write_bytes(b'{"kind":"capt')
    with pytest.raises(UsageError, match="cut off before the first buffer"):
        CaptureTap(tmp_path / "d")
    with pytest.raises(UsageError, match="no stream 'tap', only effect"):
        CaptureTap(captured(tmp_path / "e", noise(3), stream="effect"))


def test_a_format_that_the_transform_does_not_take_is_refused_where_it_comes(tmp_path):
    with CaptureWriter(tmp_path / "first") as writer:
        writer.write_buffer("tap", noise(3), 8, 0.0)
    with pytest.raises(UsageError, match=r"first: samplerate=8 Hz is out of range"):
        CaptureTap(tmp_path / "first")
    tap = CaptureTap(captured(tmp_path / "second", noise(3), noise(3, 65)))
    assert tap.read() is not None
    with pytest.raises(UsageError, match=r"second: channels=65 is out of range"):
        tap.read()


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
