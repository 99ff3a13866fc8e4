from dataclasses import replace
from itertools import product
from operator import attrgetter

import pytest

from device.drive.exposure import ACTION_A8_M_S2, ACTION_VDV, DAY_S, DoseSums
from device.drive.protection.limits import Limits
from device.drive.safety import SafetyState
from device.rig.parameters import vary
from tests.support.random_drives import OFF, RIGS, Case, driven, reached
from tools.bench.sections.protection import drives
from tools.bench.sounds.signals import SAMPLERATE

MOST = {"excursion": 1.0, "current": 1.0, "coil_c": Limits.coil_temperature_c, "infeasible": 0}
CAPS = pytest.mark.parametrize("cap", ["off", "action"])


def check_limits(found, cap):
    """No case is beyond a limit, whichever it is, and with a cap no day's dose is."""
    for name, most in MOST.items():
        worst = max(found, key=attrgetter(name))
        print(f"{len(found)} drives, {name}: {getattr(worst, name):.4f}")
        assert getattr(worst, name) <= most, worst
    assert sum(one.limited > 0 for one in found) > 0.5 * len(found)
    if cap != "off":
        assert all(one.gain < 1.0 for one in found)
        assert max(one.dose.vdv for one in found) < ACTION_VDV
        assert max(one.dose.a8_m_s2 for one in found) < ACTION_A8_M_S2


@pytest.mark.parametrize(
    ("count", "samplerate"),
    [
        (40, 6_000),
        (12, 44_100),
        (12, 48_000),
        (12, 176_400),
        # 36 pairs of a rig and a kind of drive: each 41 times or more, and at 48 kHz once or twice.
        pytest.param(1_500, 6_000, marks=pytest.mark.exhaustive),
        pytest.param(60, 48_000, marks=pytest.mark.exhaustive),
        pytest.param(6_000, 6_000, marks=pytest.mark.soak),
        pytest.param(240, 48_000, marks=pytest.mark.soak),
    ],
)
@CAPS
def test_no_drive_of_a_generator_takes_a_rig_that_is_a_tenth_off_beyond_a_limit(
    count, samplerate, cap
):
    found = reached(range(count), cap, samplerate)
    check_limits(found, cap)
    if cap == "off":  # they do come near: 9.1 % of Xmax and of the current are held back
        assert min(max(one.excursion for one in found), max(one.current for one in found)) > 0.7


@CAPS
def test_no_drive_of_the_bench_takes_a_rig_that_is_a_tenth_off_beyond_a_limit(cap):
    share, rig, found = 0.0 if cap == "off" else 0.9, RIGS[0], []
    dose = DoseSums(0.0, share * ACTION_A8_M_S2**2 * DAY_S, share * ACTION_VDV**4)
    for mass, f0, force_factor in product((1.0 - OFF, 1.0 + OFF), repeat=3):
        true = replace(rig, actuator=vary(rig.actuator, mass, f0**2, force_factor))
        begins = SafetyState(119.0, 60.0, dose)
        cases = [Case(name, drive, rig, true, begins) for name, drive in drives().items()]
        found += driven(cases, SAMPLERATE, cap)
    check_limits(found, cap)
