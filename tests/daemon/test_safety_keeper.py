import json
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from audioflinger_hook.daemon.safety_keeper import FILE, MARK, SAVE_S, Moment, SafetyKeeper
from audioflinger_hook.drive.drive import UNPLAYED_S, Drive, DrivenRig
from device.drive.exposure import DoseSums, worst_second
from device.drive.protection.design import limits_of
from device.drive.safety import SafetyBounds, SafetyState, power_to_limit_w
from device.rig import CONSUMER, PAPER
from device.rig.parameters import ThermalParameters
from device.rig.thermal import Temperatures
from tools.rig_driver import RigDriver

RATE = 8_000
NOON = datetime(2026, 5, 1, 12, tzinfo=timezone(timedelta(hours=2)))
LIMIT_C = 120.0


def text(local: datetime) -> str:
    return local.isoformat(timespec="minutes")


class Time:
    def __init__(self) -> None:
        self.moment = Moment("a boot", 1_000.0, NOON.timestamp(), text(NOON))

    def __call__(self) -> Moment:
        return self.moment

    def go(self, seconds: float, boot: str = "a boot") -> None:
        now = self.moment
        boot_s = now.boot_s + seconds if boot == now.boot else 20.0
        local = datetime.fromisoformat(now.local) + timedelta(seconds=seconds)
        self.moment = Moment(boot, boot_s, now.wall_s + seconds, text(local))


def driven(exposure_cap: str = "off") -> Drive:
    return Drive((), RATE, 1, rig="paper", protection="on", exposure_cap=exposure_cap)


def state_of(drive: Any) -> Any:
    return drive.processors[0].safety_states()[0]


def set_state(drive: Any, coil_c: float, magnet_c: float) -> None:
    readings = drive.processors[0]._readings[0]  # as the core would have written them
    readings.coil_c, readings.magnet_c = coil_c, magnet_c


def played(drive: Drive, seconds: float) -> None:
    times_s = np.arange(round(seconds * RATE)) / RATE
    drive.process(0.5 * np.sin(2.0 * np.pi * 40.0 * times_s)[:, None])


def begun(folder: Path, time: Time, device: str = "dac") -> tuple[SafetyKeeper, Drive]:
    """A keeper, and a drive that goes on from what it knows of the device."""
    keeper, drive = SafetyKeeper(folder, time), driven()
    keeper.note_device(device)
    keeper.restore(drive.processors)
    return keeper, drive


def killed(folder: Path, time: Time, coil_c: float = 119.0, magnet_c: float = 60.0) -> Drive:
    keeper, drive = begun(folder, time)
    played(drive, 1.0)
    set_state(drive, coil_c, magnet_c)
    keeper.update(drive.processors, 0.0)
    time.go(SAVE_S)
    return drive


def restored(folder, time, device="dac"):
    """The state that the next process begins with, and its keeper."""
    keeper, drive = begun(folder, time, device)
    return state_of(drive), keeper


AMBIENT_C, HOUR_S, YEARS_S = 20.0, 3_600.0, 20.0 * 365.0 * 86_400.0
THERMAL: Any = PAPER.thermal
QUICK = ThermalParameters(4.0, 0.5, 3.0, 400.0)  # of a coil that warms up sooner


def rested(coil_c: float, magnet_c: float, seconds: float) -> Any:
    true = Temperatures(THERMAL)
    true.coil_k, true.magnet_k = coil_c - AMBIENT_C, magnet_c - AMBIENT_C
    true.heat(0.0, seconds)
    return SafetyState(AMBIENT_C + true.coil_k, AMBIENT_C + true.magnet_k)


@pytest.mark.parametrize("passed_s", [0.0, 0.3, 5.0, 40.0, 600.0])
@pytest.mark.parametrize("boot", ["a boot", "another boot"])
def test_after_a_kill_it_is_as_warm_as_it_is_or_at_most_ten_kelvin_more(tmp_path, passed_s, boot):
    time = Time()
    before = state_of(killed(tmp_path, time))
    time.go(passed_s, boot)
    state, keeper = restored(tmp_path, time)
    true = rested(119.0, 60.0, SAVE_S + passed_s)
    assert true.coil_c - 1e-9 <= state.coil_c <= true.coil_c + 10.0
    assert true.magnet_c <= state.magnet_c + 1e-9
    assert state.dose.squares >= before.dose.squares
    assert state.dose.fourths >= before.dose.fourths
    assert keeper.warning == ""


@example(LIMIT_C, 1.0, QUICK)
@settings(max_examples=30, deadline=None)
@given(st.floats(20.0, LIMIT_C), st.floats(0.0, 1.5), st.sampled_from([THERMAL, QUICK]))
def test_nothing_that_protection_allows_is_warmer_than_the_bound(coil_c, seconds, thermal):
    strong = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=20.0), thermal=thermal)
    bounds = SafetyBounds(strong, worst_second(strong, RATE))
    state: Any = bounds.after_unrecorded(SafetyState(coil_c, 20.0), seconds)
    ambient_c, warm = thermal.ambient_c, Temperatures(thermal)
    warm.coil_k, warm.magnet_k = coil_c - ambient_c, 20.0 - ambient_c
    for _ in range(int(seconds / 0.002)):
        allowed_w = power_to_limit_w(warm, LIMIT_C - ambient_c)
        warm.heat(0.999 * min(allowed_w, 20.0**2 / 3.3), 0.002)  # 20 V, 3.3 ohm
    assert ambient_c + warm.coil_k - 0.02 <= state.coil_c <= LIMIT_C


@pytest.mark.parametrize("rig", [PAPER, CONSUMER], ids=["paper", "consumer"])
def test_no_drive_adds_more_to_the_dose_than_the_bound(rig):
    rng, times_s = np.random.default_rng(1), np.arange(4 * RATE) / RATE
    worst = worst_second(rig, RATE)
    drives = [np.sign(np.sin(2.0 * np.pi * hz * times_s)) for hz in (8.0, 30.0, 45.0, 60.0, 150.0)]
    drives += [rng.uniform(-1.0, 1.0, len(times_s)), np.sign(rng.normal(size=len(times_s)))]
    for drive in drives:
        driven = RigDriver(rig, RATE, limits=replace(limits_of(rig), excursion_m=1.0))
        driven.process(drive[:, None])
        dose = driven.safety_states()[0].dose
        assert dose.squares <= worst.squares * dose.time_s
        assert dose.fourths <= worst.fourths * dose.time_s


def test_a_clean_end_is_continued_exactly(tmp_path):
    time = Time()
    keeper, drive = begun(tmp_path, time)
    state = state_of(drive)  # a first run starts cold
    assert (state.coil_c, state.dose.squares, keeper.warning) == (20.0, 0.0, "")
    played(drive, 2.0)
    set_state(drive, 80.0, 40.0)
    keeper.close(drive.processors)
    state, keeper = restored(tmp_path, time)
    assert (state.coil_c, state.magnet_c) == (pytest.approx(80.0), pytest.approx(40.0))
    assert state.dose.squares == pytest.approx(state_of(drive).dose.squares)
    assert keeper.since == "2026-05-01T12:00+02:00"


def test_the_rig_of_a_new_chain_has_cooled_by_the_hour_of_a_suspend(tmp_path):
    time = Time()
    keeper, drive = begun(tmp_path, time)
    played(drive, 1.0)
    set_state(drive, 119.0, 60.0)
    keeper.update(drive.processors, 0.0)
    dose = state_of(drive).dose
    time.go(HOUR_S)  # the daemon ends the chain after the suspend, so its last state is not saved
    after = driven()
    keeper.restore(after.processors)
    keeper.carry_over((), after.processors)
    state, true = state_of(after), rested(119.0, 60.0, HOUR_S)
    assert true.coil_c - 1e-9 <= state.coil_c < true.coil_c + 1.0
    assert state.dose.squares >= dose.squares
    assert keeper.warning == ""


def hot() -> tuple[Drive, DrivenRig]:
    """A drive that has just played, with its coil at 119 °C and its magnet at 60 °C."""
    drive = driven()
    rig: Any = drive.processors[0]
    rig.restore([SafetyState(119.0, 60.0)])
    drive.process(np.zeros((1, 1)))
    rig.keep(100.0, 7.0)
    assert state_of(drive).coil_c == pytest.approx(119.0)
    return drive, rig


@pytest.mark.parametrize("passed_s", [5.0, 40.0, HOUR_S])
@pytest.mark.parametrize("asleep", [0.0, 0.5, 1.0], ids=["away", "both", "suspended"])
@pytest.mark.parametrize("ticks", [1, 7])
def test_coils_that_are_not_driven_cool_by_the_time_that_passes(passed_s, asleep, ticks):
    drive, rig = hot()
    dose = state_of(drive).dose
    for tick in range(1, ticks + 1):
        share = passed_s * tick / ticks
        rig.keep(100.0 + (1.0 - asleep) * share, 7.0 + asleep * share)
    for _ in range(2):  # before and after the next block
        true, late = rested(119.0, 60.0, passed_s), rested(119.0, 60.0, passed_s - UNPLAYED_S - 1.1)
        state = state_of(drive)
        assert true.coil_c <= state.coil_c + 1e-9
        assert true.magnet_c <= state.magnet_c + 0.05  # for some seconds, a hot coil warms it
        assert state.coil_c <= late.coil_c
        assert state.dose.time_s == pytest.approx(dose.time_s, abs=0.11)
        drive.process(np.zeros((1, 1)))
    rig.keep(100.1 + (1.0 - asleep) * passed_s, 7.0 + asleep * passed_s)
    assert state_of(drive).coil_c == pytest.approx(state.coil_c, abs=1e-6)


def test_coils_that_play_just_after_a_suspend_have_cooled_by_it_and_warmed_since():
    drive, rig = hot()
    played(drive, 0.5)  # the sound server goes on before the daemon does
    before = state_of(drive)
    rig.keep(100.5, 7.0 + HOUR_S)
    state, true_c = state_of(drive), rested(119.0, 60.0, HOUR_S).coil_c
    assert true_c <= state.coil_c < true_c + 15.0 < before.coil_c
    assert state.dose == before.dose
    drive.process(np.zeros((1, 1)))
    assert state_of(drive).coil_c == pytest.approx(state.coil_c, abs=0.1)


@pytest.mark.parametrize(
    "times_s",
    [
        *([(40.0, 7.0)], [(100.0, -3_600.0)], [(-3_500.0, 7.0), (100.0, 7.0), (100.5, 7.0)]),
        *([(100.0 + YEARS_S, 7.0)], [(100.0, YEARS_S)], [(101.0, 8.9)]),
    ],
    ids=["back", "less sleep", "back and forth", "far", "far asleep", "still playing out"],
)
def test_a_clock_that_cannot_be_right_cools_nothing(times_s):
    drive, rig = hot()
    for now_s, slept_s in times_s:
        rig.keep(now_s, slept_s)
    drive.process(np.zeros((1, 1)))
    assert state_of(drive).coil_c == pytest.approx(119.0)


def test_a_core_that_has_run_again_keeps_its_own_temperatures():
    drive, rig = hot()
    rig.keep(100.0, 7.0 + HOUR_S)
    assert state_of(drive).coil_c < 40.0
    drive, rig = hot()
    controls = rig._controls[0]
    drive.process(np.zeros((1, 1)))
    controls.safety.coil_c, controls.restores = 20.0, 2  # what `keep` found one frame ago
    drive.process(np.zeros((1, 1)))
    assert state_of(drive).coil_c == pytest.approx(119.0)


def test_a_restored_rig_that_waits_for_sound_cools_and_does_not_warm():
    drive = driven()
    rig: Any = drive.processors[0]
    rig.restore([SafetyState(119.0, 60.0, DoseSums(5.0, 1.0, 1.0, 1.0))])
    keeper = SafetyKeeper()
    for tick in range(61):
        rig.keep(float(tick))
        keeper.carry_over((rig,), (rig,))  # as for a chain whose graph is idle
    assert state_of(drive).dose == DoseSums(5.0, 1.0, 1.0, 1.0)
    assert state_of(drive).coil_c <= 119.0
    for tick in range(61, 122):
        rig.keep(float(tick))
    assert state_of(drive).coil_c < 60.0


def test_a_coil_that_only_cools_is_not_recorded_again_and_is_restored_as_cool(tmp_path):
    time = Time()
    keeper, drive = begun(tmp_path, time)
    rig: Any = drive.processors[0]
    played(drive, 1.0)
    set_state(drive, 119.0, 60.0)
    rig.keep(0.0)
    keeper.update(drive.processors, 0.0)
    record = (tmp_path / FILE).read_bytes()
    for tick in range(1, 60):
        time.go(1.0)
        rig.keep(float(tick))
        keeper.update(drive.processors, float(tick))
    assert (tmp_path / FILE).read_bytes() == record
    assert rested(119.0, 60.0, 59.0).coil_c <= restored(tmp_path, time)[0].coil_c < 80.0


def test_one_channel_with_an_unknown_time_leaves_the_other_as_recorded(tmp_path):
    time = Time()

    def two() -> Drive:
        return Drive((), RATE, 2, rig="paper", protection="on")

    keeper, drive = SafetyKeeper(tmp_path, time), two()
    keeper.restore(drive.processors)
    drive.process(np.ones((RATE, 2)) * 0.5)
    rig: Any = drive.processors[0]
    for readings in rig._readings:
        readings.coil_c = 80.0
    keeper.close(drive.processors)
    path = tmp_path / FILE
    record = json.loads(path.read_text())
    first, second = record["actuators"].values()
    first["boot_s"] += 5.0
    path.write_text(json.dumps(record))
    rig, keeper = two().processors[0], SafetyKeeper(tmp_path, time)
    keeper.restore((rig,))
    states = rig.safety_states()
    assert [state.coil_c for state in states] == [LIMIT_C, pytest.approx(80.0)]
    assert [state.dose.squares for state in states] == [first["dose"]["squares"]] * 2
    assert states[1].dose.squares == second["dose"]["squares"] > 0.0
    assert "time that has passed" in keeper.warning


@pytest.mark.parametrize(
    "harm",
    [
        lambda path: path.write_text(path.read_text()[:-40]),
        lambda path: path.write_bytes(b"\x00" * 100),
        lambda path: path.write_text("[]"),
        lambda path: path.write_text(path.read_text().replace('"version": 1', '"version": 9')),
        lambda path: path.write_text(path.read_text().replace("119.0", "NaN")),
        lambda path: path.unlink(),
    ],
    ids=["cut", "zeros", "other", "future", "nan", "missing"],
)
def test_a_damaged_or_missing_record_gives_the_warmest_state_and_one_warning(tmp_path, harm):
    time = Time()
    killed(tmp_path, time)
    harm(tmp_path / FILE)
    state, keeper = restored(tmp_path, time)
    assert state.coil_c == LIMIT_C
    assert state.magnet_c > 60.0
    assert (str(tmp_path / FILE) in keeper.warning, "\n" in keeper.warning) == (True, False)


def test_a_clock_that_was_set_back_gives_the_warmest_state_unless_within_a_boot(tmp_path):
    time = Time()
    killed(tmp_path, time)
    within = Time()
    within.moment = replace(time.moment, wall_s=0.0)
    state, keeper = restored(tmp_path, within)
    assert (keeper.warning, state.coil_c < LIMIT_C) == ("", True)
    killed(tmp_path, time)
    time.go(-3_600.0, "another boot")
    state, keeper = restored(tmp_path, time)
    assert (state.coil_c, "future" in keeper.warning) == (LIMIT_C, True)


def test_the_dose_is_of_the_day_and_ends_at_midnight_whether_it_plays_or_waits(tmp_path):
    time = Time()
    keeper, drive = begun(tmp_path, time)
    played(drive, 2.0)
    keeper.close(drive.processors)
    waiting = driven()
    keeper.note_device("dac")
    keeper.restore(waiting.processors)
    assert state_of(waiting).dose.squares > 0.0
    time.go(12.5 * HOUR_S)
    keeper.update((*drive.processors, *waiting.processors), 100.0)
    assert keeper.since == "2026-05-02T00:30+02:00"
    for one in (drive, waiting):  # one has played yesterday
        assert state_of(one).dose.squares == 0.0
        played(one, 0.3)
        assert state_of(one).dose.time_s == pytest.approx(0.3, abs=0.11)
    keeper.update(drive.processors, 101.0)
    time.go(24.0 * HOUR_S)
    assert restored(tmp_path, time)[0].dose.squares == 0.0


def test_what_is_not_recorded_is_known_to_the_next_rig_and_one_warning_tells(tmp_path):
    keeper, drive = SafetyKeeper(), driven()
    played(drive, 2.0)
    keeper.update(drive.processors, 0.0)  # then the engine ends, as after a suspend
    after = driven()
    keeper.carry_over((), after.processors)
    assert state_of(after).dose.squares >= state_of(drive).dose.squares > 0.0
    assert state_of(after).coil_c >= state_of(drive).coil_c > AMBIENT_C
    (tmp_path / "file").write_text("")
    keeper, drive = begun(tmp_path / "file" / "folder", Time())
    keeper.update(drive.processors, 0.0)
    assert "not kept" in keeper.warning


def test_another_device_is_cold_but_has_the_dose_of_who_sits_there(tmp_path):
    time = Time()
    killed(tmp_path, time)
    state, keeper = restored(tmp_path, time, "another")
    assert state.coil_c == 20.0
    assert state.dose.squares > 0.0
    assert keeper.warning == ""
    record = json.loads((tmp_path / FILE).read_text())
    assert list(record["actuators"]) == ["dac 0.0", "another 0.0"]
    assert (tmp_path / MARK).exists()


def test_what_moves_to_another_device_is_recorded_there(tmp_path):
    time = Time()
    keeper, drive = begun(tmp_path, time)
    played(drive, 1.0)
    keeper.note_device("another")
    set_state(drive, 100.0, 60.0)
    keeper.close(drive.processors)
    state, _ = restored(tmp_path, time, "another")
    assert state.coil_c == pytest.approx(100.0, abs=0.1)
