"""Float frames as bytes of a card, and what goes there through PortAudio: here a file of ALSA."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from audioflinger_hook.mixer.pcm import PcmFormat, decode
from audioflinger_hook.mixer.pcm import encode as mixer_encode
from device.errors import LostError, NotFoundError
from device.stream import portaudio
from device.stream.pcms import CardDevice, Pcm, PcmConfig, ServerDevice
from device.stream.sample_format import Encoder, SampleFormat
from device.stream.streams import PlaybackStream
from device.units import Float32Array
from tests.support.alsa_files import BLOCK_S, ToFile, portaudio_with, until

RATE = 48_000
FORMATS = {SampleFormat.FLOAT32: PcmFormat.FLOAT, SampleFormat.S16: PcmFormat.I16}
FORMATS |= {SampleFormat.S24_3: PcmFormat.I24, SampleFormat.S32: PcmFormat.I32}


@pytest.fixture(scope="module")
def pcms() -> Iterator[PcmConfig]:
    with portaudio_with("cushion_card") as config:
        yield config


@pytest.fixture
def pcm(pcms: PcmConfig, tmp_path: Path) -> Pcm:
    """A card that is a file, another one for each test, under the name that PortAudio knows."""
    pcms.pcms["cushion_card"].target = ToFile(tmp_path / "card.raw")
    return pcms.pcms["cushion_card"]


class Player:
    """Noise with clipped peaks, a block at a time; keeps what it gave and what was sent."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(1)
        self.given: list[Float32Array] = []
        self.sent: list[Float32Array] = []

    def opened(self, pcm: Pcm, channels: int, form: SampleFormat) -> PlaybackStream:
        return PlaybackStream(pcm, RATE, channels, self.fill, self.on_sent, sample_format=form)

    def fill(self, out: Float32Array, now_s: float) -> None:
        time.sleep(BLOCK_S)
        out[:] = self.rng.uniform(-1.2, 1.2, out.shape).astype(np.float32)
        self.given.append(out.copy())

    def on_sent(self, frames: Float32Array, now_s: float) -> None:
        self.sent.append(frames)


@pytest.mark.sweep
@pytest.mark.parametrize("channels", [1, 2, 8])
@pytest.mark.parametrize("sample_format", FORMATS)
def test_every_byte_arrives_as_it_was_encoded(pcm, tmp_path, sample_format, channels):
    player = Player()
    stream = player.opened(pcm, channels, sample_format)
    stream.audible = True
    until(lambda: len(player.sent) > 40)
    assert stream.close()
    assert stream.errors == {}
    sounding = [frames for frames in player.sent if frames.any()]
    # a block may have been filled before the stream was audible
    encoded = mixer_encode(np.concatenate(player.given[-len(sounding) :]), FORMATS[sample_format])
    meant = decode(encoded, FORMATS[sample_format], channels)
    np.testing.assert_array_equal(np.concatenate(sounding), meant)
    stored = (tmp_path / "card.raw").read_bytes()
    frame = channels * sample_format.bytes_per_sample
    # silence comes before, and what PortAudio had not passed on yet is cut off
    begin = stored.index(encoded[: 16 * frame])
    assert not any(stored[:begin])
    arrived = min(len(stored) - begin, len(encoded))
    assert arrived > 20 * 256 * frame
    assert stored[begin : begin + arrived] == encoded[:arrived]


def test_nothing_but_silence_goes_out_until_the_stream_is_audible(pcm, tmp_path):
    player = Player()
    stream = player.opened(pcm, 2, SampleFormat.S24_3)
    until(lambda: len(player.sent) > 5)
    assert stream.close()
    assert stream.silenced == len(player.sent)
    assert not np.concatenate(player.sent).any()
    assert not any((tmp_path / "card.raw").read_bytes())


def test_of_a_missing_card_it_is_said_what_may_be_wrong_and_of_a_missing_plugin_no_device_is_blamed(
    pcm, monkeypatch
):
    assert CardDevice(3, 1).definition == "type hw card 3 device 1"  # with nothing in between
    assert ServerDevice("a").definition == 'type pulse device "a"'
    pcm.target = CardDevice(31, 2)
    words = "cannot open hw:31,2 for playback.*2 channels at 48000 Hz in S16_LE.*card was unplugged"
    with pytest.raises(LostError, match=words):
        PlaybackStream(pcm, RATE, 2, lambda *_: None, sample_format=SampleFormat.S16)
    pcm.target = ServerDevice("desktop", "unix:/nowhere")
    monkeypatch.setattr(portaudio, "missing_plugin", lambda: "install its plugin")
    with pytest.raises(NotFoundError, match=r"^install its plugin$"):
        PlaybackStream(pcm, RATE, 2, lambda *_: None)


integers = pytest.mark.parametrize("sample_format", [*FORMATS][1:])
samples = (
    st.floats(-4.0, 4.0, width=32)
    | st.floats(-(2.0**-20), 2.0**-20, width=32)
    | st.sampled_from([1.0, -1.0, -0.0, np.inf, -np.inf, np.nan])
)
blocks = arrays(np.float32, st.tuples(st.integers(0, 9), st.just(3)), elements=samples)


@integers
@given(frames=blocks)
def test_cards_and_the_mixers_sinks_get_the_same_bytes(sample_format, frames):
    expected = mixer_encode(frames, FORMATS[sample_format])
    assert Encoder(sample_format, 3, 4).encode(frames) == expected


@pytest.mark.sweep
@integers
@given(frames=blocks)
def test_what_was_encoded_is_what_the_bytes_stand_for_and_gives_them_again(sample_format, frames):
    encoder = Encoder(sample_format, 3, 4)
    stored, meant = encoder.encode(frames), encoder.decode_last()
    assert meant.dtype == np.float32
    assert not meant.flags.writeable
    np.testing.assert_array_equal(meant, decode(stored, FORMATS[sample_format], 3))
    assert encoder.encode(meant) == stored


@integers
def test_blocks_do_not_depend_on_those_before_them(sample_format):
    encoder = Encoder(sample_format, 2, 8)
    first = np.linspace(-1.0, 1.0, 16, dtype=np.float32).reshape(8, 2)
    stored, meant = encoder.encode(first), encoder.decode_last()
    kept = meant.copy()
    for frames in (3, 8, 0):
        encoder.encode(np.zeros((frames, 2), np.float32))
        assert not encoder.decode_last().any()
    np.testing.assert_array_equal(meant, kept)
    assert encoder.encode(first) == stored
