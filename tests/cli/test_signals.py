"""Signals of a running daemon: a hang-up reads the config again, unless the terminal is gone."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook.cli.process import Signals
from audioflinger_hook.daemon.wake import Wake
from tests.support.commands import DEADLINE_S
from tests.support.recordings import ROOT
from tests.support.terminal import Terminal

WAITER = """
import sys
from audioflinger_hook.cli.process import Signals
from audioflinger_hook.daemon.wake import Wake

with Wake() as wake, Signals(wake) as signals:
    print("ready", file=sys.stderr, flush=True)
    while not signals.end:
        wake.wait(10.0)
        if signals.reload:
            signals.reload = False
            print("reload", file=sys.stderr, flush=True)
sys.exit(3)
"""


def test_signals_are_noted_and_wake_who_waits() -> None:
    before = signal.getsignal(signal.SIGHUP)
    with Wake() as wake, Signals(wake) as signals:
        os.kill(os.getpid(), signal.SIGHUP)
        assert wake.wait(5.0)
        assert (signals.reload, signals.end) == (True, False)
        os.kill(os.getpid(), signal.SIGTERM)
        assert wake.wait(5.0)
        assert signals.end
        called: list[int] = []
        signals.on_spinning = lambda: called.append(1)
        os.kill(os.getpid(), signal.SIGXCPU)
        assert wake.wait(5.0)
        assert called == [1]
    assert signal.getsignal(signal.SIGHUP) is before


@pytest.mark.sweep
@pytest.mark.parametrize("ignored", [False, True])
def test_a_terminal_that_is_closed_ends_it_unless_it_was_started_to_go_on(ignored: bool) -> None:
    master, slave = pty.openpty()
    process = subprocess.Popen(
        [*(("nohup",) if ignored else ()), sys.executable, "-c", WAITER],
        stdin=slave,
        stdout=slave,
        stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        text=True,
        start_new_session=True,
        cwd="/tmp",
    )
    os.close(slave)
    try:
        assert process.stderr is not None
        lines = iter(process.stderr.readline, "")
        assert "ready\n" in lines
        process.send_signal(signal.SIGHUP)
        assert next(lines) == "reload\n"
        os.close(master)
        process.send_signal(signal.SIGHUP)  # as the terminal does to those that it controls
        if ignored:
            assert next(lines) == "reload\n"
        else:
            assert process.wait(10.0) == 3
    finally:
        process.kill()
        process.wait()
        assert process.stderr is not None
        process.stderr.close()


def test_a_terminal_that_is_closed_ends_a_run_whose_meter_it_shows_like_ctrl_c(
    tmp_path: Path,
) -> None:
    sound, felt = tmp_path / "sound.wav", tmp_path / "felt.wav"
    soundfile.write(sound, np.full(48_000 * 60, 0.1), 48_000)
    run = ("run", "--tap", f"file:{sound}", "--device", f"wav:{felt}")
    with Terminal(*run, env={"TERM": "xterm", "XDG_RUNTIME_DIR": str(tmp_path)}) as terminal:
        terminal.expect("█")
        terminal.close()
        assert terminal.process.wait(DEADLINE_S) == 130
    assert soundfile.info(felt).frames > 0
