"""Designs of the core that are damaged or nonsense: refused with what is wrong, or harmless."""

from __future__ import annotations

import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core import blob
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.transform.design import LiveDesign
from device.drive.design import DriveDesign, damping_for
from device.errors import InternalError
from device.rig import CONSUMER, PAPER
from device.units import Records
from tests.plugin.hosting import damaged

RATE = 8_000
DAMPING = damping_for(CONSUMER.actuator, CONSUMER.amplifier.source_impedance_ohm)
DRIVES = [DriveDesign(PAPER, RATE), None, DriveDesign(CONSUMER, RATE, DAMPING, "action")]
WHOLE = core_design(
    RATE,
    2,
    transform=LiveDesign.of(parameters_of("cinema"), RATE).records(),
    drives=DRIVES,
    delay_frames_max=RATE,
)
RECORDS = blob.unpack(WHOLE)
OF_DRIVES = sorted(
    name for name in RECORDS if "/" in name or name in ("drives", "actuators", "drive_of_actuator")
)
SOUND = np.random.default_rng(1).uniform(-1.0, 1.0, (3_000, 2)).astype(np.float32)


def runs_or_is_refused(design: bytes) -> bool:
    """Whether a core of these bytes runs; one that runs gives as much as it takes."""
    try:
        core = Core(design)
    except InternalError:
        return False
    for part in np.split(SOUND[:, : core.info.inputs], [1, 500, 501]):
        assert core.process(part).shape == (len(part), core.outputs)
    return True


def test_the_whole_design_runs() -> None:
    assert runs_or_is_refused(WHOLE)


@given(
    at=st.integers(24, len(WHOLE) - 9),
    flips=st.integers(1, 255),
    cut=st.integers(0, len(WHOLE)),
)
@settings(max_examples=100, deadline=None)
def test_bytes_that_were_changed_or_cut_are_refused(at: int, flips: int, cut: int) -> None:
    changed = bytearray(WHOLE)
    changed[at] ^= flips
    assert not runs_or_is_refused(bytes(changed))
    assert cut == len(WHOLE) or not runs_or_is_refused(WHOLE[:cut])


@pytest.mark.parametrize(("reason", "design"), damaged(WHOLE).items())
def test_a_damaged_design_is_refused_with_what_is_wrong(reason: str, design: bytes) -> None:
    with pytest.raises(InternalError, match=reason):
        Core(design)


@given(at=st.integers(24, len(WHOLE) - 9), flips=st.integers(1, 255))
@settings(max_examples=400, deadline=None)
def test_changed_bytes_with_a_checksum_that_fits_are_refused_or_harmless(
    at: int, flips: int
) -> None:
    changed = bytearray(WHOLE)
    changed[at] ^= flips
    changed[-8:-4] = zlib.crc32(bytes(changed[:-8])).to_bytes(4, "little")
    runs_or_is_refused(bytes(changed))


@pytest.mark.parametrize("name", OF_DRIVES)
def test_a_design_that_lacks_a_value_of_a_drive_is_refused_by_its_name(name: str) -> None:
    design = blob.pack({other: value for other, value in RECORDS.items() if other != name})
    if name == "actuators":
        assert Core(design).info.actuators == 0  # the vibration leaves as it is
        return
    with pytest.raises(InternalError, match=name.partition("/")[2] or "no such drive|does not fit"):
        Core(design)


@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_any_numbers_in_a_drive_make_a_core_that_runs_or_none(
    data: st.DataObject, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    odd_numbers = st.sampled_from([0.0, -1.0, 1e-300, 1e300, np.inf, -np.inf, 0.5, np.nan])
    odd_counts = st.sampled_from([0, 1, 2, 3, 5, 7, 60, 100, 1_000, 70_000])
    changes: Records = {}
    for name in data.draw(st.lists(st.sampled_from(OF_DRIVES), min_size=1, max_size=4)):
        value = RECORDS[name]
        if isinstance(value, np.ndarray):
            changes[name] = value * rng.uniform(-2.0, 2.0, value.shape)
        elif isinstance(value, int):
            changes[name] = data.draw(odd_counts)
        else:
            changes[name] = data.draw(odd_numbers)
    runs_or_is_refused(blob.pack({**RECORDS, **changes}))


@given(
    gains=st.lists(st.floats(), min_size=3, max_size=3),
    delays=st.lists(st.floats(), min_size=3, max_size=3),
    sources=st.lists(st.integers(0, 2**64 - 1), min_size=3, max_size=3),
    sound_gain=st.floats(),
)
@settings(max_examples=100, deadline=None)
def test_any_controls_give_finite_signals_within_full_scale(
    gains: list[float], delays: list[float], sources: list[int], sound_gain: float
) -> None:
    core = Core(WHOLE)
    for part in np.split(SOUND, 3):
        core.process(part)
        core.controls.sound_gain = sound_gain
        for controls, gain, delay, source in zip(
            core.controls.actuators, gains, delays, sources, strict=False
        ):
            controls.gain, controls.delay_frames, controls.source = gain, delay, source
        out = core.process(part)
        assert np.isfinite(out).all()
        assert np.abs(out).max() <= 1.0 + 1e-6


@given(samples=st.lists(st.floats(width=32), min_size=1, max_size=200))
@settings(max_examples=100, deadline=None)
def test_any_sound_gives_finite_signals(samples: list[float]) -> None:
    core = Core(WHOLE)
    out = core.process(np.resize(np.array(samples, np.float32), (2_000, 2)))
    assert np.isfinite(out).all()


TABLES = [name for name in OF_DRIVES if isinstance(RECORDS[name], np.ndarray)]


@pytest.mark.parametrize("name", [name for name in TABLES if np.size(RECORDS[name])])
@pytest.mark.parametrize("odd", [np.nan, np.inf])
def test_a_table_with_what_is_no_number_is_refused(name: str, odd: float) -> None:
    table = np.array(RECORDS[name], float)
    table.flat[-1] = odd
    if name in ("drive_of_actuator",):
        return
    with pytest.raises(InternalError, match="a drive lacks the table"):
        Core(blob.pack({**RECORDS, name: table}))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_restored_state_that_is_no_number_counts_as_the_hottest_and_as_the_whole_dose(
    bad: float,
) -> None:
    core = Core(WHOLE)
    for controls in core.controls.actuators[:3]:
        controls.restores = 1
        controls.safety.coil_c = controls.safety.magnet_c = bad
        controls.safety.squares = controls.safety.fourths = bad
    core.process(SOUND)
    assert core.readings.actuators[0].coil_c > 100.0
    assert core.readings.actuators[2].exposure_gain == 0.0  # the one with a cap
    assert np.isfinite(core.process(SOUND)).all()
