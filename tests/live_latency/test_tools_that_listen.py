from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from device.errors import LostError
from tools import beginnings, churn
from tools.bench.sections.rig import compensate_interpolation
from tools.live_latency.usage import ProcessUse

TONE_FRAMES = round(beginnings.TONE_S * beginnings.RATE_HZ)


def test_a_stream_of_which_one_tone_was_heard_is_an_error():
    heard = np.zeros(6 * TONE_FRAMES)
    heard[TONE_FRAMES : 2 * TONE_FRAMES] = heard[3 * TONE_FRAMES : 4 * TONE_FRAMES] = 0.4
    assert list(beginnings._lost(heard, heard)) == [0]
    heard[5 * TONE_FRAMES :] = 0.4
    with pytest.raises(LostError, match="3 tones were heard, but each stream has 2"):
        list(beginnings._lost(heard, heard))


@pytest.mark.parametrize("samples", [0, 1, 2])
def test_the_cpu_time_of_a_daemon_that_ended_is_an_error(monkeypatch, tmp_path, samples):
    used = ProcessUse()
    used._samples = [(float(count), 5.0, 100.0) for count in range(samples)]
    server: Any = type("Server", (), {"environment": {}, "folder": tmp_path})
    for name in ("_many_nodes", "running_daemon", "recorded_together"):
        monkeypatch.setattr(churn, name, lambda *_, **__: nullcontext(tmp_path / "steady.wav"))
    for name in ("spawn", "end", "status_of_daemon"):
        monkeypatch.setattr(churn, name, lambda *_: None)
    monkeypatch.setattr(churn, "_link_count", lambda _: 3)
    monkeypatch.setattr(churn, "_come_and_go", lambda *_: used)
    monkeypatch.setattr("time.sleep", lambda _: None)
    if samples < 2:
        with pytest.raises(LostError, match="its CPU time is unknown"):
            churn.churned(server, 0.0)
    else:
        assert str(churn.churned(server, 0.0)).startswith("daemon 0.0 % of a core")


def test_compensated_samples_have_the_error_that_the_bench_states():
    hz, samplerate, between = 220.0, 48_000, 512
    times = np.arange(892)  # whole periods between the ends
    omega = 2.0 * np.pi * hz / samplerate
    fine = np.arange((len(times) - 1) * between + 1) / between
    met = np.interp(fine, times, compensate_interpolation(np.sin(omega * times)))
    inner = slice(between * 10, -between * 10)
    basis = np.column_stack([turn(omega * fine[inner]) for turn in (np.sin, np.cos)])
    amplitude = float(np.linalg.lstsq(basis, met[inner], rcond=None)[0][0])
    assert abs(1.0 - amplitude) == pytest.approx(omega**4 / 90.0, rel=0.2)
    assert f"{omega**4 / 90.0:.0e}".replace("e-0", "e-") in (compensate_interpolation.__doc__ or "")
