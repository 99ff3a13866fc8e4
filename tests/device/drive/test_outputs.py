"""Outputs behind a drive: every frame comes, as much later as the drive declares."""

import numpy as np
import pytest

from device.drive.channel_map import ChannelMap
from device.drive.damping import Damping, inverse_damping
from device.drive.outputs import DrivenOutput
from device.errors import InternalError
from device.rig import PAPER
from device.rig.simulated_rig import SimulatedRig
from tests.support.outputs import KeptOutput
from tools.rig_driver import RigDriver

RATE = 8_000


class InSeries(RigDriver):
    """A rig on two channels, as a driver."""

    inputs = 2

    def __init__(self, damping):
        super().__init__(PAPER, RATE, 2, damping=damping)


def driven(output, damping):
    return DrivenOutput(output, InSeries(damping), ChannelMap.repeated(2, 2))


vibration = np.random.default_rng(4).uniform(-0.5, 0.5, (2_000, 2)).astype(np.float32)


def test_what_is_written_is_not_changed_and_a_simulated_rig_may_lie_behind():
    rig = SimulatedRig(PAPER, RATE, 2)
    output = driven(rig, inverse_damping(PAPER.actuator, 0.5))
    before = vibration.copy()
    output.write(vibration)
    output.close()
    assert np.array_equal(vibration, before)
    assert rig.peak_acceleration_m_s2 > 0.0
    assert (output.samplerate, output.channels) == (RATE, 2)


def test_after_its_end_nothing_can_be_written_and_ending_again_does_no_harm():
    kept = KeptOutput(RATE, 2)
    output = driven(kept, Damping())
    output.abort()
    assert kept.ended == ["aborted"]
    with pytest.raises(InternalError, match="closed"):
        output.write(vibration)
    output.close()
    assert not kept.blocks


def test_a_channel_map_for_other_channels_is_refused():
    with pytest.raises(InternalError, match="2 channels, the channel map 3"):
        DrivenOutput(KeptOutput(RATE, 2), InSeries(Damping()), ChannelMap.repeated(2, 3))
