"""Processors before an output: everything comes, later by what was declared, and lies still."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.drive.alignment import Aligned
from device.drive.damping import Damper, inverse_damping, no_damping, shaper_damping
from device.drive.exposure import ExposureMeter
from device.drive.processing import Processed
from device.drive.protection import Protector
from device.errors import InternalError
from device.rig import PAPER
from device.rig.twin import Twin

RATE = 8_000


class Kept:
    """An output that keeps what it is given."""

    samplerate, channels = RATE, 2

    def __init__(self):
        self.blocks = []
        self.ended = ""

    def write(self, vibration):
        self.blocks.append(vibration.copy())

    def close(self):
        self.ended = "closed"

    def abort(self):
        self.ended = "aborted"


def chain(damping):
    return [
        Damper(damping, RATE, 2),
        Protector(PAPER, RATE, 2),
        ExposureMeter(PAPER, RATE, 2),
    ]


vibration = np.random.default_rng(4).uniform(-0.5, 0.5, (2_000, 2))


@given(st.lists(st.integers(0, 2_000), max_size=8))
def test_without_damping_the_same_comes_out_whole_whatever_the_blocks(cuts):
    kept = Kept()
    processed = Processed(kept, chain(no_damping()))
    output = Aligned(processed, 0)
    for block in np.split(vibration, sorted(cuts)):
        output.write(block)
    output.close()
    received = np.concatenate(kept.blocks)
    late = processed.latency_frames
    assert late == 2 * 16  # two blocks of 2 ms
    assert not received[:late].any()
    assert np.array_equal(received[late:], vibration)
    assert kept.ended == "closed"


def test_aligned_behind_it_takes_the_delay_out():
    kept = Kept()
    processors = chain(no_damping())
    late = sum(processor.latency_frames for processor in processors)
    output = Processed(Aligned(kept, late), processors)
    output.write(vibration)
    output.close()
    assert np.array_equal(np.concatenate(kept.blocks), vibration)


def test_the_delays_of_all_add_up():
    damping = shaper_damping(PAPER.actuator, "zv")
    processed = Processed(Kept(), chain(damping))
    assert processed.latency_frames == 32 + round(damping.latency_s * RATE)


def test_what_is_written_is_not_changed_and_the_twin_may_lie_behind():
    twin = Twin(PAPER, RATE, 2)
    output = Processed(twin, chain(inverse_damping(PAPER.actuator, 0.5)))
    before = vibration.copy()
    output.write(vibration)
    output.close()
    assert np.array_equal(vibration, before)
    assert twin.peak_acceleration_m_s2 > 0.0
    assert (output.samplerate, output.channels) == (RATE, 2)


def test_after_its_end_nothing_can_be_written_and_ending_again_does_no_harm():
    kept = Kept()
    output = Processed(kept, chain(no_damping()))
    output.abort()
    assert kept.ended == "aborted"
    with pytest.raises(InternalError, match="closed"):
        output.write(vibration)
    output.close()
    assert not kept.blocks
