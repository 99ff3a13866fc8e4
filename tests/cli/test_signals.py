import os
import pty
import resource
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from audioflinger_hook.cli.process import NEEDED, Signals
from audioflinger_hook.daemon.timing import Wake
from tests.support.commands import DEADLINE_S, RATE, Done, cushion, environment, refused, sound
from tests.support.terminal import Terminal

WAITER = """
import sys
from audioflinger_hook.cli.process import Signals
from audioflinger_hook.daemon.timing import Wake

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
    command = [*(("nohup",) if ignored else ()), sys.executable, "-c", WAITER]
    streams: dict[str, Any] = {"stdin": slave, "stdout": slave, "stderr": subprocess.PIPE}
    with subprocess.Popen(
        command, env=environment(), text=True, start_new_session=True, cwd="/tmp", **streams
    ) as process:
        os.close(slave)
        try:
            lines = iter(process.stderr.readline, "")  # type: ignore[union-attr]
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


def test_a_closed_terminal_ends_a_run_whose_level_it_shows_like_ctrl_c(tmp_path: Path) -> None:
    minute = 0.3 * np.sin(0.06 * np.arange(60 * RATE))
    source, felt = sound(tmp_path / "in.wav", minute), tmp_path / "felt.wav"
    run = ("run", "--tap", f"file:{source}", "--device", f"wav:{felt}")
    env = {"TERM": "xterm", "COLUMNS": "100", "XDG_RUNTIME_DIR": str(tmp_path)}
    with Terminal(*run, env=env) as terminal:
        terminal.expect("█")
        terminal.expect(" → ")
        terminal.close()
        assert terminal.process.wait(DEADLINE_S) == 130
    assert soundfile.info(felt).frames > 0


def limited_to(soft: int, hard: int, folder: Path) -> Done:
    options = ("--tap", "scene:demo", "--device", "twin", "--seconds", "1")
    limits = (resource.RLIMIT_NOFILE, (soft, hard))
    own = {"XDG_RUNTIME_DIR": str(folder)}  # another daemon may run on this machine
    return cushion("run", *options, env=own, preexec_fn=lambda: resource.setrlimit(*limits))


def test_a_low_limit_that_may_be_raised_is_raised(tmp_path: Path) -> None:
    assert limited_to(12, 4_096, tmp_path).code == 0


@pytest.mark.parametrize("hard", [20, NEEDED - 1])
def test_too_few_files_are_refused_with_the_limit_and_what_is_needed(
    hard: int, tmp_path: Path
) -> None:
    line = refused(limited_to(12, hard, tmp_path))
    assert line.startswith(f"cushion: error: only {hard} files may be open at once (ulimit -n)")
    assert str(NEEDED) in line
