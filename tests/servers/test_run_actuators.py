"""`cushion run` with two actuators on one sink: who gets what, as heard on its monitor."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np

from device.units import Float32Array
from tests.servers.daemons import FELT, cushion, running, tone
from tests.servers.listening import RATE_HZ, playing, recording, wait_for
from tests.servers.test_run_reload import connections, reload
from tools.sound_server import SoundServer

TONE_HZ = 110.0
HALF_DB = -6.0206

TWO = """\
[[actuator]]
source = "left"
channels = [0]
[[actuator]]
source = "right"
channels = [1]
"""
QUIETER = f'polarity = "inverted"\ngain_db = {HALF_DB}\n'


def test_two_actuators_are_felt_where_they_are_wired_as_strong_and_in_phase_as_asked(
    server: SoundServer, tmp_path: Path
) -> None:
    path = tmp_path / "c.toml"
    path.write_text(TWO.replace("[1]", "[2]"))
    done = cushion(server, "run", "--device", "haptic", "--config", str(path))
    assert done.returncode == 3
    (line,) = done.stderr.splitlines()
    assert "actuator 2 wants channel 2, but the sink 'haptic' has no such channel" in line

    path.write_text(TWO + QUIETER)
    with (
        playing(server, "desktop", tone(TONE_HZ, 60.0)) as player,
        running(server, "--config", str(path)) as daemon,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):

        def now() -> Float32Array:
            return felt()[-RATE_HZ // 10 :]

        def peaks() -> list[float]:
            last = now()
            return [float(peak) for peak in np.abs(last).max(axis=0)] if len(last) else [0.0, 0.0]

        # The same sound left and right: one is half of the other, upside down, sample by sample.
        wait_for(lambda: min(peaks()) > FELT, "vibration on both", 15.0)
        last = now()
        np.testing.assert_allclose(last[:, 1], -0.5 * last[:, 0], atol=1e-6)  # float32 of below 1
        status = daemon.wait(lambda s: s.actuators[1].level.peak_dbfs > -60.0, "levels")
        assert [actuator.channels for actuator in status.actuators] == [("0",), ("1",)]

        streams = connections(server, "sink-inputs")
        path.write_text(TWO.replace("[0]", "[9]").replace("[1]", "[0]").replace("[9]", "[1]"))
        assert "changed: the actuators" in reload(daemon)
        wait_for(lambda: abs(peaks()[0] - peaks()[1]) < 0.02 * peaks()[1], "both as strong", 5.0)
        assert connections(server, "sink-inputs") == streams

        # Left alone, which is wired to the second channel by now.
        os.kill(player, signal.SIGTERM)
        left_only = tone(TONE_HZ, 60.0) * np.array([1.0, 0.0], np.float32)
        with playing(server, "desktop", left_only):
            wait_for(lambda: peaks()[1] > FELT > 1e-3 * FELT > peaks()[0], "the left one", 15.0)
