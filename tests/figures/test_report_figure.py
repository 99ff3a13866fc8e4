import io
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from PIL import Image

from audioflinger_hook.figures import columns, palette, panels
from audioflinger_hook.figures.report import HEIGHT_PX, WIDTH_PX, report_png
from tests.support.costs import cost_ffts
from tools.bench.cost import in_ffts

SAMPLERATE = 8_000


def arguments(duration_s=2.0, samplerate=SAMPLERATE, **changes):
    time_s = np.arange(round(duration_s * samplerate)) / samplerate
    tone = 0.5 * np.sin(2.0 * np.pi * 950.0 * time_s)
    vibration = 0.2 * np.sin(2.0 * np.pi * 128.2 * time_s)
    plain = {
        "title": "A tone",
        "samplerate": samplerate,
        "audio": np.stack([tone, 0.5 * tone], axis=1).astype(np.float32),
        "vibration": vibration,
        "acceleration_m_s2": 12.0 * vibration,
        "principals": [(at_s, 950.0, 128.2, 0.7) for at_s in np.arange(0.0, duration_s, 0.0464)],
        "events": [(0.1 * duration_s, 0.9 * duration_s, "tone")],
        "facts": ["8 kHz stereo", "a test"],
    }
    return plain | changes


def decoded(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def picture_of(duration_s=2.0, samplerate=SAMPLERATE, **changes):
    return decoded(report_png(**arguments(duration_s, samplerate, **changes)))


def rgb_of(colours):
    return np.array([[int(one[at : at + 2], 16) for at in (1, 3, 5)] for one in colours])


def test_the_report_is_a_png_of_1600_by_1500_pixels_and_at_most_a_megabyte():
    png = report_png(**arguments(description="peak 1"))
    with Image.open(io.BytesIO(png)) as picture:
        assert picture.format == "PNG"
        assert picture.size == (WIDTH_PX, HEIGHT_PX) == (1600, 1500)
        assert picture.info["Description"] == "peak 1"
    assert len(png) <= 1_000_000


@pytest.mark.exhaustive
def test_white_noise_which_no_png_compresses_still_fits_in_a_megabyte():
    noise = np.random.default_rng(1).uniform(-1.0, 1.0, (15 * 48_000, 2))
    assert len(report_png(**arguments(15.0, audio=noise, samplerate=48_000))) <= 1_000_000


@pytest.mark.exhaustive
def test_the_same_input_gives_the_same_bytes():
    assert report_png(**arguments()) == report_png(**arguments())


LITTLE = np.random.default_rng(2).uniform(-1.0, 1.0, (500, 6))
SILENT: dict[str, Any] = {"vibration": np.zeros(16_000), "acceleration_m_s2": np.zeros(16_000)}
SILENT |= {"audio": np.zeros((16_000, 2)), "principals": [], "events": [], "facts": []}


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("duration_s", "changes"),
    [
        # a formula that would not parse, signs the font lacks, far too many letters
        (
            2.0,
            {
                "title": "$\\frac{ 日本語 🎧",
                "facts": ["$x"] * 200,
                "events": [(0.0, 1.0, "日本 $_" * 90)],
            },
        ),
        (2.0, {"vibration": np.zeros(500), "acceleration_m_s2": np.zeros(7)}),
        *((frames / SAMPLERATE, {"audio": LITTLE[:frames, :2]}) for frames in (1, 16)),
        (0.5, {"audio": LITTLE[:, :1], "samplerate": 1_000}),
        *((0.002, {"audio": LITTLE[:384], "samplerate": 192_000}), (2.0, SILENT)),
    ],
)
def test_whatever_comes_is_drawn_without_a_warning(duration_s, changes):
    assert picture_of(duration_s, **changes).shape == (1500, 1600, 3)


@pytest.mark.exhaustive
def test_samples_that_are_not_finite_are_drawn_as_zero():
    audio = arguments()["audio"].copy()
    clean = audio.copy()
    audio[100], clean[100] = np.nan, 0.0
    audio[200, 0], clean[200, 0] = np.inf, 0.0
    assert np.array_equal(picture_of(audio=audio), picture_of(audio=clean))


@pytest.mark.exhaustive
def test_vibration_and_principal_frequencies_appear_in_the_accent_colour():
    far = [(at_s, 200.0, 71.7, 1.0) for at_s in np.arange(0.1, 2.0, 0.1)]
    changes: tuple[Any, ...] = (SILENT, {"principals": []}, {"principals": far})
    off = (np.abs(picture_of(**one).astype(int) - rgb_of([palette.FELT])) for one in changes)
    silent, without, dotted = (np.all(one <= 1, axis=2).sum() for one in off)
    assert 4 * silent < without < dotted - 100


@pytest.mark.exhaustive
def test_a_hundred_thousand_principal_frequencies_are_drawn_at_a_low_cost():
    rng = np.random.default_rng(3)
    at_s, hz = rng.uniform(0.0, 2.0, 100_000), rng.uniform(50.0, 12_000.0, 100_000)
    many = np.stack([at_s, hz, hz / 60.0, rng.random(100_000)], axis=1)
    assert cost_ffts(lambda: picture_of(principals=many)) < in_ffts(6.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"audio": np.zeros((0, 2))}, r"audio has shape \(0, 2\), want \(frames, channels\)"),
        ({"vibration": np.zeros((5, 1))}, r"vibration has shape \(5, 1\), want \(frames,\)"),
        ({"acceleration_m_s2": np.zeros(0)}, "with at least one frame"),
        ({"samplerate": 0}, "samplerate=0 is not above 0 Hz"),
        ({"audio": np.zeros((5, 1), np.int16)}, "audio is of int16, want floating point"),
    ],
)
def test_what_cannot_be_drawn_is_refused_in_words(changes, words):
    with pytest.raises(ValueError, match=words):
        report_png(**(arguments() | changes))


def test_no_two_event_labels_share_a_place():
    events = [(0.2 * at, 0.2 * at + 0.5, f"event {at}") for at in range(40)] + [(9.9, 30.0, "last")]
    placed = panels.place_events(events, 10.0, 660.0)
    assert len(placed) > 10
    for lane in range(panels.MAX_EVENT_LANES):
        mine = [(text_s, event) for at, text_s, event in placed if at == lane]
        for (_, event), (next_text_s, _) in pairwise(mine):
            assert event[1] <= next_text_s
    assert all(0.0 <= start_s < end_s <= 10.0 for _, _, (start_s, end_s, _) in placed)


@pytest.mark.parametrize("frames", [1, 3, 100, 1381, 50_000])
def test_an_envelope_holds_every_sample(frames):
    signal = np.random.default_rng(frames).standard_normal(frames)
    lowest, highest = columns.envelope(signal, 1380)
    assert lowest.shape == highest.shape == (1380,)
    assert np.all(lowest <= highest)
    assert (lowest.min(), highest.max()) == (signal.min(), signal.max())


@pytest.mark.parametrize("frames", [1, 700, 48_000, 480_001])
def test_the_short_time_rms_of_a_constant_is_that_constant(frames):
    rms = columns.short_time_rms(np.full(frames, -0.25), 48_000, 1380, 0.05)
    # an einsum and a running sum over at most half a million frames
    assert np.allclose(rms, 0.25, rtol=1e-9)


@pytest.mark.parametrize("rows_hz", [np.geomspace(50, 12_000, 200), np.linspace(0, 8_000, 161)])
@pytest.mark.parametrize("duration_s", [1.0, 15.0])
def test_a_full_scale_tone_is_0_dbfs_in_the_row_of_its_frequency(rows_hz, duration_s):
    time_s = np.arange(round(duration_s * 48_000)) / 48_000
    level_db = columns.spectrogram_db(
        np.sin(2.0 * np.pi * 1_000.0 * time_s),
        48_000,
        window_s=0.04643,
        columns=40,
        rows_hz=rows_hz,
    )
    middle = level_db[:, 10:30]
    # between two bins of a spectrum padded to double length a Hamming window loses 0.45 dB
    assert np.all(np.abs(middle.max(axis=0)) < 0.5)
    assert np.all(np.abs(rows_hz[np.argmax(middle, axis=0)] / 1_000.0 - 1.0) < 0.06)


def test_rows_above_half_the_samplerate_are_empty():
    noise = np.random.default_rng(4).standard_normal(8_000)
    level_db = columns.spectrogram_db(
        noise, 8_000, window_s=0.05, columns=10, rows_hz=np.array([1_000.0, 4_500.0, 9_000.0])
    )
    assert np.all(level_db[0] > -60.0)
    assert np.all(level_db[1:] == -200.0)


def test_the_level_map_falls_in_lightness_by_equal_steps():
    linear = rgb_of(palette.LEVEL_COLOURS) / 255
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    lightness = 116.0 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16.0
    # colours are rounded to 8 bits, which is up to 0.2 of lightness
    assert np.allclose(np.diff(lightness), np.diff(lightness).mean(), atol=0.5)


def test_an_indexed_picture_keeps_the_colours_of_the_figures():
    own = (palette.INK, palette.GREY, palette.HEARD, palette.FELT, palette.FELT_LIGHT)
    rgb = rgb_of((*own, *palette.LEVEL_COLOURS)).astype(np.uint8)
    rgba = np.concatenate([rgb, np.full((len(rgb), 1), 255, np.uint8)], axis=1)[None]
    drawn = decoded(palette.indexed_png(rgba, 150))[0]
    # half a step between two of the levels, and Pillow looks for the nearest colour only roughly
    assert np.max(np.abs(drawn.astype(int) - rgb)) <= 6
