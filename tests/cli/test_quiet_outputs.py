"""Words for an output that is muted or turned down: who cannot hear it has nothing else."""

from dataclasses import replace

import pytest

from audioflinger_hook.cli import devices, test_tone
from audioflinger_hook.cli.outputs import list_outputs
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.outputs.sink import SinkOutput
from device.server import ServerSnapshot
from device.server.snapshot import Sink

DAC = Sink(2, "dac", "USB DAC", "dac.monitor", 48_000, 2, None, {})
DOWN = replace(DAC, volume_db=-31.4)
MUTED = replace(DAC, volume_db=-31.4, mute=True)


def snapshot(sink: Sink, default: str = "speakers") -> ServerSnapshot:
    return ServerSnapshot("PipeWire", "1.4.2", default, "", (sink,), (), (), (), 0)


@pytest.mark.parametrize(
    ("sink", "weakened"),
    [(DAC, ""), (replace(DAC, volume_db=4.0), ""), (DOWN, "volume 30 %"), (MUTED, "muted")],
)
def test_devices_lists_what_makes_an_output_weak(sink, weakened, capsys):
    assert sink.weakened == weakened
    devices._show(devices._server(snapshot(sink)) | {"usb": [], "cards": []})
    line = capsys.readouterr().out.splitlines()[2].strip()
    assert line == ", ".join(filter(None, ("USB DAC, 48000 Hz, 2 channels", weakened)))


def test_a_test_tone_says_why_it_may_not_be_felt_and_setup_lists_a_muted_output_as_muted() -> None:
    assert not list(test_tone._warnings(DAC, snapshot(DAC)))
    (down,) = test_tone._warnings(DOWN, snapshot(DOWN))
    assert "dac has volume 30 %" in down
    (silent,) = test_tone._warnings(MUTED, snapshot(MUTED))
    assert "`pactl set-sink-mute dac 0`" in silent
    (heard,) = test_tone._warnings(DAC, snapshot(DAC, default="dac"))
    assert "the default output" in heard
    (output,) = list_outputs(snapshot(MUTED), (), ())
    assert "now muted" in output.note


@pytest.mark.parametrize(("sink", "warns"), [(MUTED, True), (DOWN, False), (None, False)])
def test_a_daemon_warns_while_its_device_is_muted(sink: Sink | None, warns: bool) -> None:
    output = object.__new__(SinkOutput)
    output._found = sink
    output.volume = DeviceVolume(None)
    assert any("is muted" in warning for warning in output.warnings) == warns
