"""`cushion fit` at a terminal, on a real server: whoever answers feels what the device plays."""

import json
import signal

import numpy as np
import pytest

from audioflinger_hook.fit import PROTOCOL
from tests.servers.daemons import environment
from tests.servers.listening import recording, wait_for
from tests.support.terminal import Terminal

pytestmark = pytest.mark.servers

RATE_HZ, TONE_S = PROTOCOL.rate_hz, PROTOCOL.tone_s
CURVE = {25.0: -9.0, 50.0: -3.0, 70.0: 0.0, 110.0: 6.0, 200.0: -4.0}


def tones_of(felt):
    """Hz and dBFS of the last two tones of a recording, in their order."""
    frames = felt()[-3 * RATE_HZ :, 0]
    loud = np.flatnonzero(np.abs(frames) > 1e-4)
    begins = loud[np.diff(loud, prepend=-RATE_HZ) > RATE_HZ / 5]
    found = []
    for begin in begins[-2:]:
        tone = frames[begin : begin + round(TONE_S * RATE_HZ)]
        spectrum = np.abs(np.fft.rfft(tone * np.hanning(tone.size), 1 << 19))
        found.append((np.argmax(spectrum) * RATE_HZ / (1 << 19), 10.0 * np.log10(np.mean(tone**2))))
    return found


def key_for(felt) -> bytes:
    """The key of whoever has the sensitivity CURVE."""
    (hz, level_db), (later_hz, later_db) = tones_of(felt)
    octaves = np.log2([*CURVE])
    first, second = np.interp(np.log2([hz, later_hz]), octaves, [*CURVE.values()])
    return b"1" if first + level_db > second + later_db else b"2"


def error_db(done) -> float:
    """The r.m.s. error of a fit of CURVE, without the mean error."""
    octaves = np.log2([*map(float, done["curve_db"])])
    true_db = np.interp(octaves, np.log2([*CURVE]), [*CURVE.values()])
    errors_db = np.array([*done["curve_db"].values()]) - true_db
    return float(np.std(errors_db))


def answered(terminal, felt, count):
    for _ in range(count):
        terminal.expect("d don't know)")
        terminal.press(key_for(felt))


def choose_level(terminal, *keys):
    for key in keys:
        terminal.expect("a again)")
        terminal.press(key)


def test_a_person_at_the_terminal_is_fitted_and_kill_9_loses_no_answer(pipewire, tmp_path):
    env = {**environment(pipewire), "XDG_STATE_HOME": str(tmp_path)}
    record = tmp_path / "cushion/fit/sink-haptic.jsonl"
    asked = ("fit", "--device", "sink:haptic", "--minutes", "1", "--seed", "1", "--json")
    with recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt:
        with Terminal(*asked, env=env) as terminal:
            choose_level(terminal, *(b"+",) * 6, b"a", b"c")
            terminal.expect("d don't know)")
            terminal.press(b"a")
            answered(terminal, felt, 7)
            wait_for(lambda: record.read_bytes().count(b"\n") == 8, "7 answers")
            terminal.process.send_signal(signal.SIGKILL)
            terminal.wait()
        kept = record.read_bytes()
        with Terminal(*asked, env=env) as terminal:
            choose_level(terminal, *(b"+",) * 6, b"c")  # it starts low again
            answered(terminal, felt, 13)
            assert terminal.wait() == 0
    done = json.loads(terminal.shown[terminal.shown.index("{\n") :].rpartition("}")[0] + "}")
    assert (done["accepted"], done["trials"], done["resumed_trials"]) == (True, 20, 7)
    last = record.with_suffix(".last.jsonl").read_bytes()
    assert last.startswith(kept)
    assert error_db(done) < 2.5


def test_ctrl_c_stops_a_trial_with_a_fade_and_keeps_the_record(pipewire, tmp_path):
    env = {**environment(pipewire), "XDG_STATE_HOME": str(tmp_path)}
    with (
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        Terminal("fit", "--device", "sink:haptic", env=env) as terminal,
    ):
        terminal.expect("a again)")
        for _ in range(5):
            terminal.press(b"+")
            terminal.expect("a again)")
        before = len(felt())
        terminal.press(b"a")
        wait_for(
            lambda: np.abs(felt()[before:][-RATE_HZ // 20 :]).max(initial=0.0) > 0.01, "vibration"
        )
        terminal.press(b"\x03")
        assert terminal.wait() == 130
        faded = felt()[before:, 0]
    last = np.flatnonzero(np.abs(faded) > 1e-4)[-1]
    assert last < 0.6 * RATE_HZ + np.flatnonzero(np.abs(faded) > 1e-4)[0]
    assert np.abs(np.diff(faded)).max() < 1.3 * np.abs(faded).max() * 2.0 * np.pi * 70.0 / RATE_HZ
    assert (tmp_path / "cushion/fit/sink-haptic.jsonl").read_bytes().count(b"\n") == 1
