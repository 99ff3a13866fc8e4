import struct
import zlib
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core import blob
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.transform.design import LiveDesign
from device.errors import InternalError
from device.units import Records
from tests.plugin.hosting import damaged, several_drives

RATE = 8_000
# With everything that can be switched on, so that all of it meets what does not fit.
TRANSFORM = LiveDesign.of(replace(parameters_of("cinema"), speech_suppression_db=12.0), RATE)
SETTINGS: dict[str, Any] = TRANSFORM.settings()
WHOLE = core_design(
    RATE, 2, transform=TRANSFORM.records(), drives=several_drives(RATE), delay_frames_max=RATE
)
RECORDS = blob.unpack(WHOLE)
OF_DRIVES = sorted(
    name for name in RECORDS if "/" in name or name in ("drives", "actuators", "drive_of_actuator")
)
SOUND = np.random.default_rng(1).uniform(-1.0, 1.0, (3_000, 2)).astype(np.float32)


def runs_or_is_refused(design: bytes) -> bool:
    try:
        core = Core(design)
    except InternalError:
        return False
    sound = SOUND[:, : core.info.inputs]
    for part in (*np.split(sound, [1, 500, 501]), 1_000.0 * sound, 0.0 * sound):
        assert core.process(part).shape == (len(part), core.outputs)
    with suppress(InternalError):  # of odd settings its state may be refused
        core.state = core.state
    core.process(sound)
    return True


def made(**changes: object) -> Core:
    return Core(blob.pack({**RECORDS, **changes}))  # type: ignore[dict-item]


@given(
    at=st.integers(0, len(WHOLE) - 1), flips=st.integers(1, 255), cut=st.integers(0, len(WHOLE) - 1)
)
@settings(max_examples=100, deadline=None)
def test_bytes_that_were_changed_or_cut_are_refused(at: int, flips: int, cut: int) -> None:
    changed = bytearray(WHOLE)
    changed[at] ^= flips
    for design in (bytes(changed), WHOLE[:cut]):
        with pytest.raises(InternalError, match="design"):
            Core(design)


@pytest.mark.parametrize(
    ("reason", "design"),
    [
        *(*damaged(WHOLE).items(), ("not a design", b""), ("cut or too long", WHOLE + bytes(8))),
        ("checksum", WHOLE[:-8] + bytes(8)),
        ("lacks samplerate or inputs", blob.pack(TRANSFORM.records())),
    ],
)
def test_a_damaged_design_is_refused_with_what_is_wrong(reason: str, design: bytes) -> None:
    with pytest.raises(InternalError, match=reason):
        Core(design)


@pytest.mark.sweep
@pytest.mark.parametrize("first", [24, 25, 26])
@given(third=st.integers(0, (len(WHOLE) - 35) // 3), flips=st.integers(1, 255))
@settings(max_examples=130, deadline=None)
def test_changed_bytes_with_a_right_checksum_are_refused_or_harmless(
    first: int, third: int, flips: int
) -> None:
    changed = bytearray(WHOLE)
    changed[first + 3 * third] ^= flips
    changed[-8:-4] = zlib.crc32(bytes(changed[:-8])).to_bytes(4, "little")
    runs_or_is_refused(bytes(changed))


@pytest.mark.parametrize("name", sorted(set(RECORDS) - {"delay_frames_max", "per_channel"}))
def test_a_design_that_lacks_a_value_is_refused_by_its_name(name: str) -> None:
    design = blob.pack({other: value for other, value in RECORDS.items() if other != name})
    if name in ("actuators", "window_frames"):  # the vibration leaves as it is, or there is none
        info = Core(design).info
        assert 0 in (info.actuators, info.latency_frames)
        return
    with pytest.raises(
        InternalError, match=name.partition("/")[2] or f"{name}|no such drive|does not fit"
    ):
        Core(design)


EITHER_WAY = {
    *("first_bin", "partials_max", "newest_frames", "rest_ticks", "rearmed_ticks"),
    *("groups_max", "onset_partials_max", "hops_in_window", "hold_hops", "ring_hops"),
    *("begin_frames", "average_ticks"),
}
ONE_MORE, ONE_LESS = {"back_ticks"}, {"last_bin", "energy_mapping", "find_onsets"}
"""Whole numbers that may be one more or less while all others stay as they are."""

MAY_BE_0 = {
    *("window_frames", "last_bin", "energy_mapping", "find_onsets", "hold_hops", "ring_hops"),
    "begin_frames",
}
MAY_BE_SHORTER = {
    *("image_table", "image_turn", "band_edges", "rise_shares", "low_sections", "begin_fade"),
    *("phases", "gain_table", "felt_weights", "speech_teeth"),
}
FILTERS = {"low_a", "low_b"}
"""Tables that take the place of sections where those lack."""


@pytest.mark.parametrize("name", sorted(set(SETTINGS) - {"window_frames"}))
def test_a_transform_is_not_made_of_a_setting_out_of_its_range(name: str) -> None:
    value = SETTINGS[name]
    wrong: list[object] = []
    if isinstance(value, int):
        wrong = [2**40, 2**62, -1, *[0] * (name not in MAY_BE_0)]
        wrong += [value + 1] * (name not in EITHER_WAY | ONE_MORE)
        wrong += [value - 1] * (name not in EITHER_WAY | ONE_LESS)
    elif isinstance(value, float):
        wrong = [np.nan]
    elif name not in FILTERS:
        wrong = [np.full_like(value, np.nan), np.full_like(value, np.inf)]
        wrong += [value[1:]] * (name not in MAY_BE_SHORTER)
    for one in wrong:
        with pytest.raises((InternalError, struct.error)):
            made(**{name: one})


S = SETTINGS
MISFITS: dict[str, list[object]] = {
    "window_frames": [S["window_frames"] + 1],
    "steps": [4.0, np.array([54.0])],
    "hop_s": [1, np.array([0.018])],
    "fft_length": [S["window_frames"], 7 * 2**10],
    "bins": [1, S["fft_length"]],
    "samplerate": [0, 2**40],
    "gain_step_hz": [0.0],
    "window": [1, 1.0],
    "band_b": [np.ones(1), np.ones(30)],
    "band_a": [np.ones(2), 2.0 * S["band_a"]],
    "low_sections": [S["low_sections"].ravel()[1:], np.zeros(0)],
    "image_table": [np.zeros(0)],
    "image_turn": [np.zeros((2, S["bins"] + 1)), np.zeros(3)],
    "seconds": [np.zeros(1)],
    "phases": [np.ones(1), np.zeros((0, S["decimation"]))],
    "gain_table": [np.ones(1)],
    "tick_frames": [S["short_frames"] + 1],
    "find_onsets": [2],
    "energy_mapping": [2],
    "short_frames": [S["tick_frames"] - 1],
    "short_length": [2 * (S["short_frames"] // 2) - 2, 7 * 2**10],
    "newest_frames": [S["tick_frames"] + 1, S["short_frames"] + 1],
    "band_edges": [
        *(S["band_edges"][:1], S["band_edges"][::-1].copy(), S["band_edges"] + S["short_bins"]),
        *(S["band_edges"] - S["band_edges"][0], S["band_edges"] + 0.5),
    ],
    "back_ticks": [2, 65],
    "rest_ticks": [S["rearmed_ticks"] - 1],
    "rearmed_ticks": [S["rest_ticks"] + 1],
    "groups_max": [S["onset_partials_max"] + 1],
    "onset_partials_max": [S["groups_max"] - 1, 17],
    "rise_shares": [np.zeros(0)],
    "speech_edges": [
        *(S["speech_edges"][::-1].copy(), S["speech_edges"] + S["bins"], S["speech_edges"] - 1e3),
    ],
    "speech_centres_hz": [np.ones(6)],
    "speech_log_pitches": [np.ones(1)],
    "speech_teeth": [S["speech_teeth"] - 1.0, S["speech_teeth"] + S["bins"], np.zeros(0)],
    "inputs": [0, -1, 65, 2**70],
}


@pytest.mark.parametrize("name", MISFITS)
def test_a_core_is_not_made_of_values_of_another_kind_or_that_do_not_fit(name: str) -> None:
    for value in MISFITS[name]:
        with pytest.raises((InternalError, struct.error)):
            made(**{name: value})


DRIVE, SETTING = st.sampled_from(OF_DRIVES), st.sampled_from(sorted(SETTINGS))


@pytest.mark.sweep
@pytest.mark.parametrize("names", [DRIVE | SETTING, DRIVE, SETTING], ids=range(3))
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=100, deadline=None)
def test_any_numbers_make_a_core_that_runs_or_none(
    names: st.SearchStrategy[str], data: st.DataObject, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    odd_numbers = st.sampled_from([0.0, -1.0, 1e-300, 1e300, np.inf, -np.inf, 0.5, np.nan, 3.0])
    odd_counts = st.sampled_from([0, 1, 2, 3, 5, 7, 60, 100, 1_000, 70_000])
    changes: Records = {}
    for name in data.draw(st.lists(names, min_size=1, max_size=4)):
        value = RECORDS[name]
        if isinstance(value, np.ndarray):
            changes[name] = value * rng.uniform(-2.0, 2.0, value.shape)
        elif isinstance(value, int):
            changes[name] = data.draw(odd_counts)
        else:
            changes[name] = data.draw(odd_numbers)
    runs_or_is_refused(blob.pack({**RECORDS, **changes}))


@given(
    samples=st.lists(st.floats(width=32), min_size=1, max_size=200),
    gains=st.lists(st.floats(), min_size=3, max_size=3),
    delays=st.lists(st.floats(), min_size=3, max_size=3),
    sources=st.lists(st.integers(0, 2**64 - 1), min_size=3, max_size=3),
    sound_gain=st.floats(),
)
@settings(max_examples=100, deadline=None)
def test_any_sound_and_controls_give_finite_signals_within_full_scale(
    samples: list[float],
    gains: list[float],
    delays: list[float],
    sources: list[int],
    sound_gain: float,
) -> None:
    core = Core(WHOLE)
    for part in (*np.split(SOUND, 3), np.resize(np.array(samples, np.float32), (2_000, 2))):
        core.process(part)
        core.controls.sound_gain = sound_gain
        for controls, gain, delay, source in zip(
            core.controls.actuators, gains, delays, sources, strict=False
        ):
            controls.gain, controls.delay_frames, controls.source = gain, delay, source
        out = core.process(part)
        assert np.isfinite(out).all()
        assert np.abs(out).max() <= 1.0 + 1e-6


@pytest.mark.parametrize("name", [n for n in OF_DRIVES if np.ndim(RECORDS[n]) and "/" in n])
@pytest.mark.parametrize("odd", [np.nan, np.inf])
def test_a_table_with_what_is_no_number_is_refused(name: str, odd: float) -> None:
    table = np.array(RECORDS[name], float)
    if table.size:
        table.flat[-1] = odd
        with pytest.raises(InternalError, match="a drive lacks the table"):
            made(**{name: table})


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_restored_state_that_is_no_number_is_the_hottest_and_the_whole_dose(bad: float) -> None:
    core = Core(WHOLE)
    for controls in core.controls.actuators[:3]:
        controls.restores = 1
        controls.safety.coil_c = controls.safety.magnet_c = bad
        controls.safety.squares = controls.safety.fourths = bad
    core.process(SOUND)
    assert core.readings.actuators[1].coil_c > 100.0
    assert core.readings.actuators[0].exposure_gain == 0.0  # the one with a cap
    assert np.isfinite(core.process(SOUND)).all()
