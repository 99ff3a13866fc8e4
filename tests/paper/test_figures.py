import os
import sys
from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

if os.environ.get("CI") != "true":
    pytest.importorskip("matplotlib")

from matplotlib.axes import Axes
from matplotlib.text import Text

from device.errors import InternalError, UsageError
from device.rig import PAPER
from device.rig.parameters import vary
from tests.support.signals import FIVE_TONES_HZ
from tools.paper import __main__ as figures
from tools.paper import layout
from tools.paper.recording import SAMPLERATE, recording
from tools.paper.response import measure_response
from tools.paper.table import write_table
from tools.paper.units import unit_sequence

NAMES = ("figure6", "figure7", "figure8", "figure8_damped")
WINDOW_S = 0.05


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    out, sheets = tmp_path_factory.mktemp("figures") / "new", {}
    with pytest.MonkeyPatch.context() as patch:  # pictures are written by another test
        patch.setattr(layout, "save", lambda sheet, path: sheets.update({path.stem: sheet}))
        assert figures.main(["--out", str(out)]) == 0
    return out, sheets


def table(drawn, name):
    """The columns of a figure's table, by name; empty places are NaN."""
    return np.genfromtxt(drawn[0] / f"{name}.csv", delimiter=",", names=True)


def ends(felt):
    rows = np.flatnonzero(np.diff(felt["over"]) == 1) + 1
    frames = round(WINDOW_S * SAMPLERATE)
    return [row for row in rows if felt["over"][row : row + frames].all()]


def residuals_db(felt):
    """The energy of the acceleration in 50 ms after each end over that in 50 ms before it."""
    power, frames = felt["acceleration_m_s2"] ** 2, round(WINDOW_S * SAMPLERATE)
    return [
        10.0 * np.log10(power[row : row + frames].sum() / power[row - frames : row].sum())
        for row in ends(felt)
    ]


@pytest.mark.exhaustive
def test_each_figure_is_a_picture_and_a_table(tmp_path):
    assert figures.main(["--out", str(tmp_path)]) == 0
    expected = sorted(f"{name}.{kind}" for name in NAMES for kind in ("csv", "png"))
    assert sorted(path.name for path in tmp_path.iterdir()) == expected
    for name in NAMES:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", NAMES)
def test_no_words_leave_the_sheet_or_cover_others(drawn, name):
    sheet = drawn[1][name]
    sheet.canvas.draw()
    renderer = sheet.canvas.get_renderer()
    # ticks beyond an axis's end are there, but not drawn
    ticks = {
        label
        for axes in sheet.findobj(Axes)
        for label in (*axes.get_xticklabels(), *axes.get_yticklabels())
    }
    words = [
        (text.get_text(), text.get_window_extent(renderer))
        for text in sheet.findobj(Text)
        if text not in ticks and text.get_visible() and text.get_text().strip()
    ]
    assert len(words) > 6
    for said, box in words:
        assert sheet.bbox.x0 <= box.x0 < box.x1 <= sheet.bbox.x1, said
        assert sheet.bbox.y0 <= box.y0 < box.y1 <= sheet.bbox.y1, said
    for (one, box), (other, its_box) in combinations(words, 2):
        assert not box.overlaps(its_box), (one, other)


def test_the_response_is_that_of_mass_spring_and_friction_with_its_resonance_at_90_hz(drawn):
    response = table(drawn, "figure6")
    assert response.dtype.names[:2] == ("frequency_hz", "magnitude")
    hz, magnitude = response["frequency_hz"], response["magnitude"]
    assert hz[np.argmax(magnitude)] == pytest.approx(90.0, abs=1.0)
    assert hz[0] <= 6.0 < 299.0 <= hz[-1]
    assert (np.diff(hz) > 0.0).all()
    assert response["coherence"].min() >= 0.95
    s, p = 2j * np.pi * response["frequency_hz"], PAPER.actuator
    impedance = p.moving_mass_kg * s**2 + p.damping_n_s_per_m * s + p.stiffness_n_per_m
    exact = np.abs(p.force_factor_n_per_a * s**2 / impedance)
    clear = response["frequency_hz"] >= 20.0
    # at 7 % of Xmax the spring is 0.2 % stiffer: 0.1 % of f0, which is 1 % on the flanks
    assert response["magnitude"][clear] == pytest.approx(exact[clear], rel=0.015)
    # the conditioning amplifier, from 1 Hz on, leads by 1 degree; 0.1 % of f0 is another one
    at_90_deg = np.interp(90.0, response["frequency_hz"], response["phase_deg"])
    assert at_90_deg == pytest.approx(90.0, abs=3.0)


@pytest.mark.exhaustive
def test_specimens_a_tenth_off_enclose_the_published_resonance_and_the_curve(drawn, monkeypatch):
    # The paper gives one number of its Figure 6, about 90 Hz. Level and slopes are compared with
    # the drawn curve and with the equations.
    monkeypatch.setattr("tools.paper.response.TAKES", 1)
    hz = np.arange(15.0, 299.0, 0.5)
    curves, resonances_hz = {}, []
    for f0, mass, force_factor in product((0.9, 1.0, 1.1), (0.9, 1.1), (0.9, 1.1)):
        specimen = vary(PAPER.actuator, mass, mass * f0**2, force_factor)
        response = measure_response(replace(PAPER, actuator=specimen))
        curve = np.interp(hz, response.frequency_hz, 20.0 * np.log10(np.abs(response.per_ampere)))
        curves[f0, mass, force_factor] = curve
        resonances_hz.append(response.resonance_hz)
        # The spring gives 40 dB a decade from 15 Hz on, and the mass a flat end; the resonance adds
        # some to both.
        low_db, high_db = (
            np.interp(b, hz, curve) - np.interp(a, hz, curve) for a, b in ((15.0, 25.0), (250, 298))
        )
        assert 40.0 * np.log10(25.0 / 15.0) < low_db < 44.0 * np.log10(25.0 / 15.0)
        assert -8.0 * np.log10(298.0 / 250.0) < high_db < 0.0
    assert min(resonances_hz) == pytest.approx(81.0, abs=0.5)
    assert max(resonances_hz) == pytest.approx(99.0, abs=0.5)
    figure = table(drawn, "figure6")
    shown_db = np.interp(hz, figure["frequency_hz"], 20.0 * np.log10(figure["magnitude"]))
    family_db = np.array(list(curves.values()))
    assert (family_db.min(axis=0) <= shown_db).all()
    assert (shown_db <= family_db.max(axis=0)).all()
    # A Bl 10 % off moves the level by as much, everywhere.
    ratio_db = curves[1.0, 0.9, 1.1] - curves[1.0, 0.9, 0.9]
    assert ratio_db == pytest.approx(20.0 * np.log10(1.1 / 0.9), abs=0.15)


def test_a_rig_without_instruments_cannot_be_measured():
    with pytest.raises(UsageError, match="accelerometer"):
        measure_response(replace(PAPER, accelerometer=None, conditioning=None, daq=None))


def test_the_units_principal_frequencies_are_the_papers_five_and_labelled(drawn):
    spectrum = table(drawn, "figure7")
    principal = spectrum[spectrum["principal"] == 1]
    # a bin is 10.7 Hz; decay and the room move a peak by less than a hertz
    assert principal["frequency_hz"] == pytest.approx(FIVE_TONES_HZ, abs=1.0)
    assert principal["vibration_hz"] == pytest.approx([46.6, 92.0, 128.2, 140.9, 182.0], abs=0.3)
    r_hz = principal["magnitude"] * principal["bandwidth_hz"]
    assert principal["r_hz"] == pytest.approx(r_hz, rel=1e-5)
    assert (principal["r_hz"] > 0.3).all()
    assert set(spectrum["unit_start_s"].round(3)) == {1.811}
    assert spectrum["unit_end_s"][0] == pytest.approx(1.857, abs=1e-3)
    said = [text.get_text() for text in drawn[1]["figure7"].axes[3].texts]
    for hz in FIVE_TONES_HZ:
        assert any(words.startswith(f"{hz:.0f} Hz\nfelt as ") for words in said)


def test_the_recording_is_no_chord_of_five_tones():
    mono = recording().mean(axis=1, dtype=np.float64)
    found = [unit_sequence(mono, SAMPLERATE, unit).principals.audio_hz for unit in range(55)]
    assert sum(hz.size == 0 for hz in found) > 20
    assert len({tuple(hz.round(-1)) for hz in found if hz.size}) > 8
    assert np.array_equal(recording(), recording())


@pytest.mark.parametrize("name", ["figure8", "figure8_damped"])
def test_the_vibration_lies_within_20_to_220_hz(drawn, name):
    felt = table(drawn, name)
    assert felt["time_s"][[0, -1]] == pytest.approx([1.45, 2.05], abs=1e-3)
    power = np.abs(np.fft.rfft(felt["vibration"])) ** 2
    hz = np.fft.rfftfreq(felt.size, 1.0 / SAMPLERATE)
    inside = (hz >= 20.0) & (hz <= 220.0)
    # the reference form's units begin and end with a step, which holds what is left
    assert power[inside].sum() / power.sum() > 0.95
    assert inside[np.argmax(power)]


def test_the_residual_is_visible(drawn):
    felt = table(drawn, "figure8")
    noise_m_s2 = felt["acceleration_m_s2"][felt["time_s"] < 1.48].std()
    assert len(ends(felt)) == 2
    assert min(residuals_db(felt)) > -9.0
    for row in ends(felt):
        # a period after the vibration's end
        later = felt["acceleration_m_s2"][row + SAMPLERATE // 90 :][: SAMPLERATE // 90]
        assert np.abs(later).max() > 10.0 * noise_m_s2


def test_damping_leaves_less_of_the_same_vibration(drawn):
    plain, damped = table(drawn, "figure8"), table(drawn, "figure8_damped")
    assert np.array_equal(plain["vibration"], damped["vibration"])
    for before_db, after_db in zip(residuals_db(plain), residuals_db(damped), strict=True):
        assert after_db < before_db - 3.0
    wanted = plain["over"] == 0
    plain_rms, damped_rms = (
        np.sqrt(np.mean(felt["acceleration_m_s2"][wanted] ** 2)) for felt in (plain, damped)
    )
    assert damped_rms == pytest.approx(plain_rms, rel=0.1)
    assert np.abs(damped["drive"]).max() < 1.0


@pytest.mark.parametrize(
    ("prepare", "out", "says"),
    [
        (lambda path: (path / "file").write_text(""), "file", "is not a folder"),
        (lambda path: None, "missing/new", "cannot be made"),
        (lambda path: (path / "out/figure6.csv").mkdir(parents=True), "out", "it is a folder"),
    ],
)
def test_what_cannot_be_written_is_one_line(tmp_path, capsys, monkeypatch, prepare, out, says):
    monkeypatch.setattr("tools.paper.response.TAKES", 1)
    prepare(tmp_path)
    assert figures.main(["--out", str(tmp_path / out)]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert said.err.startswith("figures: error: ")
    assert says in said.err
    assert str(tmp_path / out) in said.err


def test_without_matplotlib_it_says_how_to_get_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert figures.main(["--out", str(tmp_path / "new")]) == 2
    said = capsys.readouterr()
    assert said.err.startswith("figures: error: matplotlib is not installed")
    assert "pip install matplotlib" in said.err
    assert not (tmp_path / "new").exists()


def test_columns_of_different_length_are_no_table(tmp_path):
    with pytest.raises(InternalError, match="differ in length"):
        write_table(tmp_path / "a.csv", {"one": [1.0], "two": [1.0, 2.0]})
    write_table(tmp_path / "a.csv", {"one": [0.1, float("nan")], "two": [3, 4]})
    assert (tmp_path / "a.csv").read_text() == "one,two\n0.1,3\n,4\n"
