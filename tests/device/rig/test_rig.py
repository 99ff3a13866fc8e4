import math
from dataclasses import asdict, fields, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.errors import UsageError
from device.rig import CONSUMER, PAPER, read_rig, rig_by_name
from device.rig.parameters import detune
from device.rig.rig import STAGES, parse_rig
from tests.support.data import text

ACTUATOR = PAPER.actuator


@pytest.mark.parametrize(
    ("actuator", "electrical", "total"),
    [
        (PAPER.actuator, 4.67, 2.95),
        (replace(PAPER.actuator, force_factor_n_per_a=16.0), 1.82, 1.48),
        (CONSUMER.actuator, 5.91, 2.71),
    ],
)
def test_actuators_have_the_quality_factors_that_their_tables_state(actuator, electrical, total):
    assert actuator.q_electrical() == pytest.approx(electrical, abs=0.005)
    assert actuator.q_total() == pytest.approx(total, abs=0.005)


def test_stiffness_and_damping_give_back_resonance_and_quality_and_follow_a_detuned_rig():
    mass, stiffness = ACTUATOR.moving_mass_kg, ACTUATOR.stiffness_n_per_m
    assert math.sqrt(stiffness / mass) / math.tau == pytest.approx(90.0, rel=1e-14)
    quality = math.sqrt(stiffness * mass) / ACTUATOR.damping_n_s_per_m
    assert quality == pytest.approx(8.0, rel=1e-14)
    rig = detune(ACTUATOR, -0.1)
    assert rig.resonance_hz == pytest.approx(81.0)
    assert rig.moving_mass_kg == ACTUATOR.moving_mass_kg
    assert rig.damping_n_s_per_m == pytest.approx(ACTUATOR.damping_n_s_per_m, rel=1e-12)


@given(st.floats(0, 1e9))
def test_a_source_impedance_damps_less(source_impedance_ohm):
    total = ACTUATOR.q_total(source_impedance_ohm)
    assert ACTUATOR.q_total() <= total <= ACTUATOR.q_mechanical


def test_a_rig_is_found_by_its_name_only():
    assert rig_by_name("paper") is PAPER
    assert rig_by_name("consumer") is CONSUMER
    with pytest.raises(UsageError, match="no rig is named 'Paper'; choose one of: paper"):
        rig_by_name("Paper")


@pytest.mark.parametrize(
    ("stage", "name", "value"),
    [
        *(
            (PAPER.actuator, name, value)
            for name in asdict(PAPER.actuator)
            for value in (0.0, -1.0, math.nan, math.inf)
            if value != 0.0 or "eddy" not in name  # a coil may have no eddy currents
        ),
        *((PAPER.dac, "bits", value) for value in (7, 33, 16.5)),
        (PAPER.dac, "full_scale_v", 0.0),
        (PAPER.amplifier, "gain", 0.0),
        (PAPER.amplifier, "output_limit_v", math.inf),
        (PAPER.amplifier, "source_impedance_ohm", -0.1),
    ],
)
def test_no_stage_has_a_parameter_that_is_not_physical(stage, name, value):
    with pytest.raises(UsageError, match=f"{name}={value}"):
        replace(stage, **{name: value})


PLAIN = text("rig.toml")
VALUES = st.none() | st.floats() | st.integers() | st.text(max_size=3) | st.lists(st.integers())


def refused(text):
    with pytest.raises(UsageError) as caught:
        parse_rig(text, "mine", "mine.toml")
    return str(caught.value)


def changed(name, value):
    lines = [f"{name} = {value}" if line.startswith(name) else line for line in PLAIN.split("\n")]
    return "\n".join(lines)


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=lambda rig: rig.name)
def test_every_value_of_a_rig_that_ships_says_where_it_comes_from(rig):
    values = {
        f"{name}.{field.name}"
        for name, stage in rig.stages().items()
        for field in fields(stage)
        if "eddy" not in field.name  # a file without them has none
    }
    sourced = [source.parameter for source in rig.sources]
    assert len(sourced) == len(set(sourced))
    assert values <= set(sourced)
    assert all(source.words for source in rig.sources)


def test_a_file_is_found_by_its_path_and_named_after_it(tmp_path):
    path = tmp_path / "bench one.toml"
    path.write_text(PLAIN)
    rig = rig_by_name(str(path))
    assert (rig, rig.name) == (read_rig(path), "bench one")
    assert repr(rig.dac.full_scale_v) == "1.0"  # the file says 1
    assert (rig.seat, rig.sources) == (None, ())


def test_a_measured_value_keeps_its_interval_and_what_follows_may_be_stated():
    text = changed("resonance_hz", "{value = 51.0, measured = 'sweep', interval = [50.8, 51.2]}")
    source = parse_rig(text, "mine", "mine.toml").sources[0]
    assert (source.parameter, source.kind) == ("actuator.resonance_hz", "measured")
    assert source.interval == (50.8, 51.2)
    assert parse_rig(PLAIN + "q_electrical = 3.93", "mine", "").name == "mine"


def test_all_that_is_wrong_in_a_file_is_named_at_once():
    text = changed("moving_mass_kg", "-0.2").replace("q_mechanical = 5.0", "q_mechanical = 0")
    text = text.replace("gain = 2.0", "gian = 2.0").replace("bits = 16", 'bits = "16"')
    message = refused(text + "[speaker]\n[thermal]\ncoil_k_per_w = 4.0\n")
    parts = ["mine.toml", "speaker is unknown", "dac.bits='16' must be a whole number, 8 to 32"]
    parts += ["amplifier.gian is unknown, did you mean gain?", "amplifier.gain is missing"]
    parts += [
        f"actuator.{one} must be above 0" for one in ("moving_mass_kg=-0.2", "q_mechanical=0")
    ]
    parts += ["thermal.magnet_j_per_k is missing", "correct the file"]
    assert [part for part in parts if part not in message] == []
    assert "\n" not in message


def conditioning(low_hz=1.0, high_hz=1e3, noise_pc=0.0):
    return (
        f"[conditioning]\ngain_v_per_pc = 1.0\nlow_cut_hz = {low_hz}\nhigh_cut_hz = {high_hz}\n"
        f"noise_pc = {noise_pc}\noutput_limit_v = 10.0"
    )


def with_amplifier(line):
    return PLAIN.replace("gain = 2.0", f"gain = 2.0\n{line}")


CONTRADICTIONS = {
    "stop_m=0.0009 must be above actuator.x_max_m=0.001": PLAIN + "[large_signal]\nstop_m = 0.9e-3",
    "inside the band of conditioning, 60.0 to 1000.0 Hz": PLAIN + conditioning(low_hz=60.0),
    "low_cut_hz=2000.0 must be below high_cut_hz=1000.0": PLAIN + conditioning(low_hz=2e3),
    "above the noise of the conditioning amplifier, 11 V": PLAIN + conditioning(noise_pc=11.0),
    "range_v=0.0001 must be above daq.noise_v=0.0003": PLAIN
    + "[daq]\nbits = 16\nrange_v = 1e-4\nnoise_v = 3e-4\nmax_samplerate_hz = 1e6",
    "at least five times actuator.resonance_hz=50.0": PLAIN
    + "[accelerometer]\nsensitivity_pc_per_m_s2 = 0.1\nresonance_hz = 200.0\n"
    "q_resonance = 9.0\nlimit_m_s2 = 1e4",
    "at least 10 times makes a current drive": with_amplifier("drive_mode = 'current'"),
    "makes a current drive": changed("source_impedance_ohm", "100.0"),
    "must be above one step of the DAC": changed("output_limit_v", "1e-5"),
    "inside the band of amplifier": with_amplifier("high_cut_hz = 20.0"),
    "must be 'voltage' or 'current'": with_amplifier("drive_mode = 'power'"),
    "actuator.q_electrical=4.5 contradicts the rest, from which 3.927 follows": PLAIN
    + "q_electrical = 4.5",
    "actuator.stiffness_n_per_m='stiff' contradicts": PLAIN + "stiffness_n_per_m = 'stiff'",
}


@pytest.mark.parametrize("words", CONTRADICTIONS)
def test_values_that_contradict_one_another_are_refused(words):
    assert words in refused(CONTRADICTIONS[words])


@pytest.mark.parametrize(
    "stated",
    [
        "{ value = 50.0 }",
        "{ assumed = 'why' }",
        "{ value = 50.0, guessed = 'why' }",
        "{ value = 50.0, given = 'by', assumed = 'too' }",
        "{ value = 50.0, measured = 'sweep', interval = [51.0, 52.0] }",
        "{ value = 50.0, measured = 'sweep', interval = ['a', 'b'] }",
        *("[50.0]", "'fifty'", "true", "nan", "inf", "-0.0"),
    ],
)
def test_a_value_that_is_stated_wrongly_is_refused_with_its_name(stated):
    assert "actuator.resonance_hz" in refused(changed("resonance_hz", stated))


@pytest.mark.parametrize("content", [b"[dac", b"\xff\xfe", None])
def test_a_file_that_is_none_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "rig.toml").write_bytes(content)
    with pytest.raises(UsageError, match=r"rig\.toml"):
        rig_by_name(str(tmp_path / "rig.toml"))


@given(st.data())
def test_whatever_a_value_is_a_rig_comes_out_or_a_message(data):
    stage = data.draw(st.sampled_from(sorted(STAGES)))
    name = data.draw(st.sampled_from(sorted(STAGES[stage].limits())))
    value = data.draw(VALUES)
    problems = STAGES[stage].problems({name: value})
    assert all(problem.startswith(name) and repr(value) in problem for problem in problems)
    if value is None or value != value:
        assert problems
