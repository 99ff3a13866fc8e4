"""Identification of real devices, on simulated ones: what is found, and what ends it in silence."""

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from device.errors import BrokenStreamError, LostError, UsageError
from device.identification import IdentificationError, acceleration, calibration
from device.identification.calibration import STEPS, calibrate
from device.identification.live.exchange import Exchange
from device.identification.live.laboratory import MOST_TRIES, Inputs, LiveLaboratory
from device.identification.live.two_clocks import find_delay, find_drift, resample_to_played
from device.identification.mechanics import format_rig
from device.identification.output_error import Estimate
from device.identification.recording import Excitation, Sweep
from device.identification.transfer import assess_quality
from device.rig import CONSUMER, PAPER, read_rig
from device.rig.actuator import LinearActuator
from device.rig.electronics import Amplifier, Dac
from tests.support.eddy_coils import EddyActuator
from tests.support.random_rigs import truth
from tests.support.simulated_devices import BLOCK, RATE, SimulatedDevices
from tools.rig_driver import RigDriver

EXHAUSTIVE = pytest.mark.exhaustive
MODES: dict[Any, Any] = {}  # the modes by what they were identified from
SCALES = {"full_scale_v": 1.0, "acceleration_v_per_m_s2": 0.005}
SCALES |= {"shunt_ohm": 0.1, "voltage_ratio": 20.0}
ALL = Inputs.parse("acceleration,current,voltage", **SCALES)
ELECTRICAL = Inputs.parse("voltage,-,current", **SCALES)
ALONE = Inputs.parse("acceleration,-", full_scale_v=1.0, acceleration_v_per_m_s2=0.005)
LOOP = Inputs.parse("loopback,acceleration")
SWEEP = Sweep(low_hz=15.0, high_hz=400.0, duration_s=1.0, level=0.04)
SHORT = replace(SWEEP, duration_s=0.5)
WEAK = {"acceleration": 0.002}  # m/s^2, of an input whose full scale is 1
OTHER_SOURCES = (one for one in PAPER.sources if not one.parameter.startswith("actuator."))
KNOWN = replace(PAPER, sources=tuple(OTHER_SOURCES))
OWN = Inputs.parse("-,acceleration")  # an acceleration without a sensitivity
STRONG: dict[str, Any] = {"gain": 20.0, "low_cut_hz": 3.0, "output_limit_v": 40.0}
LOUD = replace(CONSUMER, amplifier=replace(CONSUMER.amplifier, **STRONG))
COIL = {"inductance_h": 5e-4, "inductance_eddy_h": 1.5e-3, "resistance_eddy_ohm": 1.5}
EDDY = replace(PAPER, actuator=replace(PAPER.actuator, **COIL))
NOTHING = {"gains": {"acceleration": 0.0}, "noise": 0.0}
LOOPBACK: dict[int, Any] = {}  # blocks of the loopback, which come before those of the acceleration


def calibrated(devices, rig=PAPER, sweep=SWEEP, inputs=None, **options):
    inputs = inputs or devices.inputs
    laboratory = LiveLaboratory(devices, inputs, 0, rig.amplifier)
    options |= {"pairs": inputs.pairs, "scaled": inputs.acceleration_scaled}
    return calibrate(laboratory, rig, sweep, **options)


@pytest.fixture
def fitted_once(monkeypatch):
    """Recordings of the same bytes are fitted once in all tests: their files' coils differ."""

    def identify_mode(recording, x_max_m, **options):
        known = recording.reference.tobytes(), recording.response.tobytes(), x_max_m, str(options)
        if known not in MODES:
            MODES[known] = acceleration.identify_mode(recording, x_max_m, **options)
        return MODES[known]

    monkeypatch.setattr(calibration, "identify_mode", identify_mode)


def check_refused(devices, words, rig=PAPER, error=IdentificationError, **options):
    with pytest.raises(error, match=words):
        calibrated(devices, rig, **options)


def hum_of(hz, level, harmonics=(1, 3), channel="acceleration"):
    """What changes a channel's blocks by mains hum of that peak, with weaker harmonics."""

    def hum(name, samples, first):
        turns = 2.0 * np.pi * hz * (first + np.arange(len(samples))) / RATE
        lines = sum(np.sin(order * turns + 0.7) / order for order in harmonics)
        return samples + (level * lines if name == channel else 0.0)

    return hum


@pytest.mark.parametrize("rig", [PAPER, pytest.param(CONSUMER, marks=EXHAUSTIVE)])
def test_acceleration_current_and_voltage_give_the_whole_actuator_in_its_file(rig, tmp_path):
    found = calibrated(SimulatedDevices(rig, ALL, drift_ppm=60.0), rig)
    assert len(found.values) == (7 if rig is PAPER else 8)  # one has no source impedance
    (tmp_path / "mine.toml").write_text(format_rig(found.rig))
    again = read_rig(tmp_path / "mine.toml")
    assert again == found.rig
    for parameter, estimate in found.values.items():
        stage, name = parameter.split(".")
        true = getattr(getattr(rig, stage), name)
        assert estimate.value == pytest.approx(true, rel=0.005 if name == "resonance_hz" else 0.02)
        assert estimate.low <= true <= estimate.high
        assert getattr(getattr(again, stage), name) == estimate.value
    (source,) = (one for one in again.sources if one.parameter == "actuator.resonance_hz")
    assert source.kind == "identified"


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("inputs", "how"),
    [
        (ALONE, {"drift_ppm": -120.0, "noise": 1e-4, "gains": {"acceleration": -1.0}}),
        (LOOP, {"gains": WEAK, "noise": 1e-6}),
        (OWN, {"gains": WEAK}),
    ],
)
def test_f0_and_q_need_neither_one_clock_nor_a_polarity_nor_a_sensitivity(inputs, how):
    devices = SimulatedDevices(PAPER, inputs, **how)
    found, true = calibrated(devices, sweep=SHORT), truth(PAPER, False)
    assert found.driven.f0_hz.value == pytest.approx(true.f0_hz, rel=0.005)
    assert found.driven.q.value == pytest.approx(true.q, rel=0.05)
    assert found.driven.inverted == (how["gains"]["acceleration"] < 0.0)
    if inputs is ALONE:
        assert found.level_of_x_max < 0.15
    elif inputs is OWN:
        assert found.level_of_x_max is None
    is_delayed = LiveLaboratory(devices, inputs).measure(SHORT, inputs.pairs)[0].delayed
    assert is_delayed == ("loopback" not in inputs.names)


@pytest.mark.exhaustive
def test_what_follows_from_an_assumed_coil_is_assumed_and_gives_the_measured_mode(fitted_once):
    # the file's coil is wrong, and whoever reads it learns that it was assumed
    wrong = replace(PAPER, actuator=replace(PAPER.actuator, force_factor_n_per_a=8.5))
    found = calibrated(SimulatedDevices(PAPER, ALONE), wrong)
    assert found.matched
    assert found.values == {}
    kinds = {source.parameter: source.kind for source in found.rig.sources}
    assert kinds["actuator.resonance_hz"] == kinds["actuator.q_mechanical"] == "assumed"
    mode = truth(found.rig, False)
    assert mode.f0_hz == pytest.approx(found.driven.f0_hz.value, rel=1e-3)
    assert mode.q == pytest.approx(found.driven.q.value, rel=1e-2)


@pytest.mark.exhaustive
def test_a_known_coil_makes_the_mechanics_identified_if_the_acceleration_shows_them(fitted_once):
    devices = SimulatedDevices(PAPER, ALONE)
    found = calibrated(devices, KNOWN)
    assert devices.levels == pytest.approx([0.01, 0.02, 0.04], rel=0.01)  # they rise to the wanted
    assert not found.matched
    assert found.values["actuator.resonance_hz"].value == pytest.approx(90.0, rel=0.005)
    assert found.values["actuator.q_mechanical"].value == pytest.approx(8.0, rel=0.05)
    strong = replace(KNOWN, actuator=replace(KNOWN.actuator, force_factor_n_per_a=20.0))
    found = calibrated(SimulatedDevices(PAPER, ALONE), strong)
    assert found.rig is None
    assert "damps it electrically" in found.why_not
    assert found.driven.q.value == pytest.approx(truth(PAPER, False).q, rel=0.05)


@pytest.mark.exhaustive
def test_voltage_and_current_alone_give_the_impedance_and_with_a_weighed_mass_bl():
    # the shunt is connected the other way round: a coil takes power, so that is seen
    devices = SimulatedDevices(PAPER, ELECTRICAL, gains={"current": -1.0})
    names = ("inductance_h", "q_mechanical", "resistance_ohm", "resonance_hz")
    found = sorted(calibrated(devices).values)
    assert found == [*(f"actuator.{name}" for name in names), "amplifier.gain"]
    values = calibrated(devices, weighed=Estimate(0.25, 0.245, 0.255)).values
    assert values["actuator.force_factor_n_per_a"].value == pytest.approx(10.0, rel=0.02)


@pytest.mark.exhaustive
def test_distortion_and_coherence_are_said_of_every_recording():
    bent: dict[str, Any] = {"change": lambda name, samples, first: samples + 0.01 * samples**2}
    longer = replace(SWEEP, duration_s=1.5)  # harmonics of a shorter one run into one another
    laboratory = LiveLaboratory(SimulatedDevices(PAPER, ALONE), ALONE)
    clean = [assess_quality(recording) for recording in laboratory.measure(longer, ALONE.pairs)]
    dirty = calibrated(SimulatedDevices(PAPER, ALONE, **bent), sweep=longer).qualities
    assert len(clean) == len(dirty) == 1
    seconds = [qualities[0].harmonics[0] for qualities in (clean, dirty)]
    assert [second.order for second in seconds] == [2, 2]
    assert seconds[1].largest_share > max(0.01, 10.0 * seconds[0].largest_share)
    assert clean[0].coherence > 0.99


@pytest.mark.parametrize("rig", [LOUD, pytest.param(EDDY, marks=EXHAUSTIVE)])
def test_protection_with_a_calibrated_file_keeps_the_real_rig_within_its_excursion(rig):
    # the file that it begins with says 8 V of full scale and a coil without eddy currents
    before = CONSUMER if rig is LOUD else PAPER
    found = calibrated(SimulatedDevices(rig, ALL), before, replace(SHORT, level=0.02))
    volts = rig.dac.full_scale_v * rig.amplifier.gain
    assert found.rig.dac.full_scale_v * found.rig.amplifier.gain == pytest.approx(volts, rel=0.01)
    assert found.rig.amplifier.output_limit_v >= 0.99 * min(volts, rig.amplifier.output_limit_v)
    assert not {"amplifier.gain", "dac.full_scale_v"} & set(found.rig.assumed())
    excursions = []
    for file in (before, found.rig):
        processor = RigDriver(file, RATE)
        turns = np.outer((30.0, 42.0, 50.0, 90.0), 2.0 * np.pi * np.arange(RATE) / RATE)
        tones = processor.process(np.sin(turns).reshape(-1, 1)).astype(float)[:, 0]
        drive = Amplifier(rig.amplifier, RATE).drive(Dac(rig.dac).volts(tones))
        kind = EddyActuator if rig is EDDY else LinearActuator
        actuator = kind(rig.actuator, RATE, rig.amplifier.source_impedance_ohm)
        moved = actuator.move(drive, ("displacement_m",)).displacement_m
        excursions.append(float(np.abs(moved).max()) / rig.actuator.x_max_m)
    assert excursions[1] <= 1.0
    if rig is LOUD:
        assert excursions[0] > 1.2  # the file before it promised what it could not keep


@pytest.mark.exhaustive
@pytest.mark.parametrize("corner_hz", [3.0, 0.0])
def test_another_corner_of_the_amplifier_is_fitted_from_the_acceleration_alone(corner_hz):
    true = replace(CONSUMER, amplifier=replace(CONSUMER.amplifier, low_cut_hz=corner_hz))
    found = calibrated(SimulatedDevices(true, ALONE, drift_ppm=60.0), CONSUMER, SHORT)
    mode = truth(replace(true, seat=PAPER.seat), False)
    assert found.driven.f0_hz.value == pytest.approx(mode.f0_hz, rel=0.001)
    assert found.driven.q.value == pytest.approx(mode.q, rel=0.005)
    assert found.rig.amplifier.low_cut_hz == pytest.approx(corner_hz, abs=0.1)
    assert not found.on_seat


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("channel", "level", "hz"),
    [("acceleration", 0.0109, 60.2), ("current", 0.000186, 50.0), ("voltage", 0.00068, 60.2)],
)
def test_weak_hum_changes_nothing(hz, channel, level):
    hum = hum_of(hz, level, (1, 3, 5), channel)
    found = calibrated(SimulatedDevices(PAPER, ALL, change=hum), sweep=replace(SWEEP, duration_s=2))
    assert not found.on_seat
    for parameter, estimate in found.values.items():
        if parameter.startswith("actuator."):
            true = getattr(PAPER.actuator, parameter.removeprefix("actuator."))
            assert estimate.value == pytest.approx(true, rel=1e-3)


@pytest.mark.parametrize(("level", "played"), [(0.06, True), (0.3, True), (8.0, False)])
def test_loud_hum_is_named_with_its_frequency(level, played):
    devices = SimulatedDevices(PAPER, ALONE, change=hum_of(60.0, level))
    words = "^acceleration: mains hum of 60 Hz, .*at most 5 % is allowed; break the ground loop"
    check_refused(devices, words)
    assert bool(np.any(devices.played)) == played


def begins_later(name, samples, first):
    time_s = (first + np.arange(len(samples))) / RATE
    return samples + (time_s > 2.0) * np.sin(2.0 * np.pi * 55.0 * time_s)


def other_sound(name, samples, first):
    loud = 0.5 if 0.7 * RATE < first < 3.5 * RATE else 0.0
    return loud * np.random.default_rng(first).standard_normal(len(samples))


@pytest.mark.parametrize(
    ("inputs", "how", "words"),
    [
        (ALL, {"delay_s": 0.9}, r"the sweep arrives 0\.9.*at most 0.8 s is allowed; use a wired"),
        (ALONE, {"noise": 0.05}, "something else"),
        (ALONE, {"change": begins_later}, "something else began"),
        (ALL, {"gains": {"current": 0.0}, "noise": 1e-6}, "^current: no signal"),
        (ALONE, NOTHING, "^acceleration: no signal"),
        (ALONE, {"change": other_sound}, "^acceleration does not follow the sweep"),
        (LOOP, {"change": lambda _, new, at: LOOPBACK.setdefault(at, new)}, "is the drive itself"),
    ],
)
def test_what_cannot_be_measured_ends_it_before_anything_louder_is_played(inputs, how, words):
    devices = SimulatedDevices(PAPER, inputs, **how)
    check_refused(devices, words)
    assert devices.runs <= 1
    if how == {"noise": 0.05}:
        assert not np.any(devices.played)
    if how is NOTHING:
        assert devices.ended_at < 2 * RATE  # nobody waits for the end of the sweep


def test_a_resistance_that_no_coil_has_is_laid_to_the_shunt():
    # the real one is 0.01 ohm, a digit was lost
    devices = SimulatedDevices(PAPER, ELECTRICAL, gains={"current": 0.01}, noise=1e-7)
    check_refused(devices, r"^resistance_ohm=3.*correct --shunt-ohm")


def test_a_rig_that_would_move_too_far_or_does_not_follow_the_level_is_driven_no_louder():
    devices = SimulatedDevices(PAPER, ALONE)
    small = replace(PAPER, actuator=replace(PAPER.actuator, x_max_m=1e-5))
    check_refused(devices, "lower the level", small)
    assert devices.runs == 1
    devices = SimulatedDevices(PAPER, ALONE)
    devices.change = lambda name, samples, first: samples / devices.runs
    check_refused(devices, "acceleration grew by 1, but the level by 2")
    assert devices.runs == 2


def test_clipping_is_silence_in_the_very_next_block_and_the_last_that_is_played():
    devices = SimulatedDevices(PAPER, ALONE, gains={"acceleration": 2000.0})
    check_refused(devices, "clips at")
    assert devices.runs == 1
    assert np.any(devices.played[: devices.ended_at])
    assert not np.any(devices.played[devices.ended_at :])


def test_whoever_interrupts_it_makes_the_very_next_block_silent():
    def interrupt(exchange, number):
        if number == 300:  # in the sweep
            exchange.abort(LostError("interrupted"))

    devices = SimulatedDevices(PAPER, ALONE, on_block=interrupt)
    check_refused(devices, "^interrupted$", error=LostError)
    assert np.any(devices.played[290 * BLOCK : 300 * BLOCK])
    assert not np.any(devices.played[300 * BLOCK :])


def test_an_input_that_stands_still_ends_the_sweep_within_half_a_second():
    devices = SimulatedDevices(PAPER, ALONE, stands_still=300)
    check_refused(devices, "the input stopped", error=LostError)
    assert np.flatnonzero(devices.played.any(axis=1))[-1] / RATE < 300 * BLOCK / RATE + 0.6


def test_an_output_that_stands_still_ends_it_and_the_first_error_is_kept():
    exchange = Exchange(np.ones(RATE), RATE, ["acceleration"])
    exchange.begin()
    exchange.fill(np.zeros((BLOCK, 2), np.float32), 0.0)
    for number in range(RATE // BLOCK):
        exchange.on_frames(np.zeros((BLOCK, 1), np.float32), number * BLOCK / RATE)
    thread = threading.Thread(target=exchange.abort, args=(LostError("second"),))
    thread.start()
    thread.join()
    assert isinstance(exchange.error, LostError)
    assert "the output stopped" in str(exchange.error)


@pytest.mark.sweep
@pytest.mark.parametrize("frames", [256, 64, 4800])
def test_a_dropout_is_refused_and_nothing_louder_is_played(frames):
    devices = SimulatedDevices(PAPER, ALONE, lost={int(2.0 * RATE): frames}, loses_always=True)
    check_refused(devices, "lost|cannot be compared")
    assert devices.levels == pytest.approx([STEPS[0] * SWEEP.level] * MOST_TRIES, rel=0.01)


@pytest.mark.exhaustive
def test_a_sweep_that_lost_frames_once_is_repeated_at_the_same_level():
    devices = SimulatedDevices(PAPER, ALONE, lost={int(2.0 * RATE): 256})
    found = calibrated(devices)
    assert devices.levels == pytest.approx([0.01, 0.01, 0.02, 0.04], rel=0.01)
    assert found.driven.f0_hz.value == pytest.approx(truth(PAPER, False).f0_hz, rel=0.005)


@pytest.mark.parametrize("breaks", [1, MOST_TRIES])
def test_a_stream_that_breaks_off_once_is_started_again_at_the_same_level(breaks):
    devices = SimulatedDevices(PAPER, ALONE)

    def break_off(exchange, number):
        if devices.runs <= breaks and number == 200:
            exchange.abort(BrokenStreamError("a block came too late"))

    devices.on_block = break_off
    laboratory = LiveLaboratory(devices, ALONE, 0, PAPER.amplifier)
    if breaks == MOST_TRIES:
        with pytest.raises(BrokenStreamError, match="too late"):
            laboratory.measure(SHORT, ALONE.pairs)
    else:
        assert laboratory.measure(SHORT, ALONE.pairs)
    assert (devices.runs, laboratory.repeated) == (min(breaks + 1, MOST_TRIES), min(breaks, 2))


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("wired", "named"),
    [
        ("acceleration,current,voltage", "current,acceleration,voltage"),
        ("current,voltage", "voltage,current"),
        ("voltage,current,-", "acceleration,-,-"),
    ],
)
def test_channels_that_are_swapped_give_no_number_and_are_a_thing_to_check(wired, named):
    devices = SimulatedDevices(PAPER, Inputs.parse(wired, **SCALES))
    check_refused(devices, "swapped|check the inputs", inputs=Inputs.parse(named, **SCALES))


@pytest.mark.exhaustive
@pytest.mark.parametrize(("low_hz", "high_hz"), [(120.0, 500.0), (10.0, 60.0)])
def test_a_resonance_outside_the_band_is_refused_without_a_number(low_hz, high_hz):
    sweep = replace(SWEEP, low_hz=low_hz, high_hz=high_hz)
    words = "outside the band|does not|unexplained"
    check_refused(SimulatedDevices(PAPER, ALL), words, sweep=sweep)


@pytest.mark.sweep
@pytest.mark.parametrize("drift_ppm", [-180.0, 0.0, -3.0, 150.0])
def test_the_drift_of_two_clocks_is_found_to_a_few_ppm(drift_ppm):
    devices = SimulatedDevices(PAPER, ALONE, drift_ppm=drift_ppm, noise=1e-4)
    laboratory = LiveLaboratory(devices, ALONE)
    laboratory.measure(replace(SWEEP, level=0.02), ALONE.pairs)
    assert laboratory.drift
    assert abs(laboratory.drift.value - drift_ppm) < max(2.0, 2.0 * laboratory.drift.reach)
    assert laboratory.delay_s == pytest.approx(0.0634, abs=0.012)  # with the block and the ring


def test_marks_around_a_sweep_are_compared_and_a_recording_is_brought_to_the_played_clock():
    excitation = Excitation(SWEEP)
    samples = excitation.samples
    assert np.abs(samples).max() <= SWEEP.level
    assert not np.any(samples[excitation.mark_frames : excitation.sweep_start])
    assert np.abs(np.diff(samples)).max() < 0.1 * SWEEP.level  # nothing clicks
    channel = np.concatenate([np.zeros(1234), samples, np.zeros(4000)])
    assert find_delay(excitation, channel, "x") == 1234
    assert abs(find_drift(excitation, channel, 1234, "x").value) < 0.01
    at = np.arange(60_000)
    smooth = np.sin(2.0 * np.pi * 300.0 * (at / (1.0 + 150e-6)) / RATE)
    shown = resample_to_played(smooth, 1000.0 * (1.0 + 150e-6), 150.0, 50_000)
    assert np.abs(shown - np.sin(2.0 * np.pi * 300.0 * (1000.0 + at[:50_000]) / RATE)).max() < 1e-6


def test_callbacks_allocate_no_recording():
    exchange = Exchange(np.zeros(RATE), RATE, ["acceleration", "-"])
    before = exchange._recorded
    exchange.begin()
    heard, out = np.full((BLOCK, 2), 1e-3, np.float32), np.zeros((BLOCK, 2), np.float32)
    for number in range(3 * RATE // BLOCK):
        exchange.fill(out, number * BLOCK / RATE)
        exchange.on_frames(heard, number * BLOCK / RATE)
    assert exchange._recorded is before
    assert (exchange.ended.is_set(), exchange.error) == (True, None)


@pytest.mark.parametrize(
    ("text", "known", "words"),
    [
        ("accelleration", {}, "'accelleration' is unknown"),
        ("acceleration,acceleration", {}, "acceleration twice"),
        ("-", {}, "nothing can be identified"),
        ("current", SCALES, "name acceleration, or voltage and current"),
        ("voltage,current", {}, "--input-full-scale-v"),
        ("voltage,current", {"full_scale_v": 1.0}, "--shunt-ohm"),
        ("acceleration", {"acceleration_v_per_m_s2": 0.01}, "--input-full-scale-v"),
        ("acceleration", {"full_scale_v": 0.0}, "must be above 0"),
        ("voltage,current", {**SCALES, "shunt_ohm": 59.0}, "shunt=59 ohm is not that of"),
        (",".join(["-"] * 40), {}, "1 to 32"),
    ],
)
def test_inputs_that_say_nothing_are_refused(text, known, words):
    with pytest.raises(UsageError, match=words):
        Inputs.parse(text, **known)
