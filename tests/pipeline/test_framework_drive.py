"""The drive path as settings ask for it: channels, rigs and processing."""

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.pipeline.framework import channel_map_of, drive_of, simulated_rig_of
from device.drive import ActuatorSettings, ChannelMap
from device.rig import CONSUMER, PAPER
from device.rig.simulated_rig import SimulatedRig

RATE = 8_000


def test_simulated_rigs_stand_where_the_actuators_are_wired():
    left = ActuatorSettings((2,), "left", rig="consumer")
    settings = Settings(actuators=(left, ActuatorSettings((0,), "right")))
    channel_map = channel_map_of(settings, 2)
    assert channel_map == ChannelMap(2, (1, None, 0))
    vibration = np.random.default_rng(1).uniform(-0.5, 0.5, (500, 3))
    wired = simulated_rig_of(settings, RATE, channel_map)
    alone = SimulatedRig([PAPER, None, CONSUMER], RATE, tolerance=settings.tolerance)
    wired.write(vibration)
    alone.write(vibration)
    wired.close()
    alone.close()
    assert len(wired.acceleration_m_s2) == 500
    assert np.array_equal(wired.acceleration_m_s2, alone.acceleration_m_s2)


def test_without_actuators_each_channel_of_the_vibration_has_the_settings_rig():
    settings = Settings(rig="consumer", protection="on")
    channel_map = channel_map_of(settings, 2)
    assert channel_map == ChannelMap(2, (0, 1))
    rig = simulated_rig_of(settings, RATE, channel_map)
    assert rig.channels == 2
    drive = drive_of(settings, RATE, 2)
    assert drive.outputs == 2
    assert drive.processors[0] is not None
    assert drive.processors[0].rig == CONSUMER
