"""A core's state goes on in another core of the same design, at every frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.transform.design import LiveDesign
from device.drive.design import DriveDesign, damping_for
from device.errors import InternalError
from device.rig import CONSUMER, PAPER

RATE = 8_000
DAMPING = damping_for(CONSUMER.actuator, CONSUMER.amplifier.source_impedance_ohm)
STRONG = replace(PAPER, amplifier=replace(PAPER.amplifier, gain=400.0))
SOUND = np.random.default_rng(3).uniform(-1.0, 1.0, (2_500, 2)).astype(np.float32)


def made(**changes: object) -> Core:
    """A transform for each channel, a damped and capped rig, a protected one, and none."""
    parts = {
        "transform": LiveDesign.of(parameters_of("cinema"), RATE).records(),
        "each": True,
        "drives": [DriveDesign(CONSUMER, RATE, DAMPING, "action"), DriveDesign(STRONG, RATE), None],
        "delay_frames_max": RATE,
    }
    core = Core(core_design(RATE, 2, **(parts | changes)))  # type: ignore[arg-type]
    for number, controls in enumerate(core.controls.actuators[:3]):
        controls.gain, controls.source = (1.0, -0.5)[number % 2], number % 2
        controls.delay_frames = 100.0 * number
    return core


def test_it_goes_on_in_another_core_after_every_frame() -> None:
    expected = made().process(SOUND)
    assert (np.abs(expected).max(axis=0) > 0.05).all()
    cores, out = (made(), made()), []
    for frame in range(len(SOUND)):
        plays, waits = cores[frame % 2], cores[1 - frame % 2]
        out.append(plays.process(SOUND[frame : frame + 1]))
        waits.state = plays.state
    assert np.concatenate(out).tobytes() == expected.tobytes()


def test_it_brings_counts_temperatures_and_dose_along() -> None:
    first, other = made(), made()
    first.process(SOUND)
    other.state = first.state
    for core in (first, other):
        core.process(SOUND)
    for one, two in zip(first.readings.actuators[:2], other.readings.actuators[:2], strict=True):
        one.level = two.level  # those of a meter begin anew
        assert one.limited_blocks > 10
        assert bytes(one) == bytes(two)


@pytest.mark.parametrize("place", [-1, -1_000, -20_000])
def test_one_changed_bit_of_a_drive_is_refused_and_the_core_is_at_rest(place: int) -> None:
    core = made()
    core.process(SOUND)
    state = bytearray(core.state)
    state[place] ^= 1
    with pytest.raises(InternalError, match="no core with this design"):
        core.state = bytes(state)
    assert not core.process(np.zeros((1_000, 2), np.float32)).any()


def test_the_state_of_another_design_of_the_same_size_is_refused() -> None:
    uncapped = [DriveDesign(CONSUMER, RATE, DAMPING), DriveDesign(STRONG, RATE), None]
    other = made(drives=uncapped)
    core = made()
    assert len(other.state) == len(core.state)
    with pytest.raises(InternalError, match="no core with this design"):
        core.state = other.state


def test_a_state_of_another_length_is_refused_and_the_core_is_at_rest() -> None:
    core = made()
    core.process(SOUND)
    with pytest.raises(InternalError, match="no core with this design"):
        core.state = core.state[:-8]
    assert not core.process(np.zeros((1_000, 2), np.float32)).any()


def test_a_transform_alone_goes_on_with_its_gain() -> None:
    cores = [made(drives=[], delay_frames_max=0) for _ in range(2)]
    for core, gain in zip(cores, (0.5, 1.0), strict=True):
        core.controls.sound_gain = gain
    cores[0].process(SOUND)
    cores[1].state = cores[0].state
    cores[0].controls.sound_gain = 1.0
    first, other = (core.process(SOUND).tobytes() for core in cores)
    assert first == other
