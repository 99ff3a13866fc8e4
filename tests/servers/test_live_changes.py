"""Settings that change while sound plays: one process, no gap and no click."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from device.units import Float32Array
from tests.servers.daemons import configured
from tests.servers.listening import RATE_HZ, more
from tests.servers.test_native import witnessed
from tests.servers.witness import Heard, Verdict, tears
from tests.support.data import table

pytestmark = [pytest.mark.servers, pytest.mark.calm]

CHANGES = table("live-changes.toml")["changes"]
EVERY_S = 1.5  # 40 changes in a minute
GAP = RATE_HZ // 200  # frames of 5 ms
STEADY_HZ = 500.0  # a steady run has nothing above this


def loudest_above(frames: Float32Array) -> float:
    """The largest sample above STEADY_HZ, in dB of full scale, without the filter's start."""
    high_pass = butter(8, STEADY_HZ, "highpass", fs=RATE_HZ, output="sos")
    rest = sosfilt(high_pass, frames[:, 0].astype(np.float64))[RATE_HZ // 10 :]
    return float(20.0 * np.log10(np.abs(rest).max() + 1e-9))


def least_of(frames: Float32Array) -> float:
    """The softest 5 ms and a bit, a period of the vibration, against the median, in dB."""
    period = 4 * GAP
    blocks = np.abs(frames[: len(frames) // GAP * GAP, 0]).reshape(-1, GAP).max(axis=1)
    peaks = np.lib.stride_tricks.sliding_window_view(blocks, period // GAP).max(axis=1)
    return float(20.0 * np.log10(peaks.min() / np.median(peaks) + 1e-9))


def is_steady(part: Float32Array, steady_db: float) -> bool:
    """Whether vibration has no gap and no click. steady_db: `loudest_above` without changes."""
    found = least_of(part), loudest_above(part)
    print(f"softest 5 ms {found[0]:.1f} dB; above 500 Hz {found[1]:.1f}, {steady_db:.1f}")
    return found[0] > -20.0 and found[1] <= max(steady_db + 3.0, -80.0)


def check_steady(what: str, heard: Sequence[Heard], act: Callable[[], None]) -> None:
    """What is felt, `heard` with the played sound and a witness, is as steady while `act` runs."""
    more(heard[0], 3.0)
    steady_db = loudest_above(heard[0]()[-2 * RATE_HZ :])
    verdict, shown = Verdict(what, needed=1), False
    while not shown:
        begins = [len(one()) for one in heard]
        act()
        parts = [one()[begin:] for one, begin in zip(heard, begins, strict=True)]
        found = is_steady(parts[0], steady_db), tears(parts[1]) == 0
        shown = verdict.add(found, good=all(found), witness_torn=tears(parts[2]) > 0)


@pytest.mark.parametrize("count", [10, pytest.param(40, marks=pytest.mark.soak)])
def test_changes_of_settings_keep_the_process_and_neither_gap_nor_click(pipewire, count, tmp_path):
    config, named = configured(tmp_path, "")
    with witnessed(pipewire, tmp_path, named, engine="native") as (daemon, heard):
        process = daemon.engine_process()

        def change() -> None:
            for lines in itertools.islice(itertools.cycle(CHANGES), count):
                daemon.reload(config, lines)
                more(heard[0], EVERY_S)
                assert daemon.status().engine_pid == process, lines

        check_steady("changes of settings", heard, change)
