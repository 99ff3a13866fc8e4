"""Collections of garbage are short while the daemon plays."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import environment

AT_THE_END = """
import gc, sys
from audioflinger_hook.cli import main
code = main()
print(gc.get_freeze_count(), len(gc.get_objects()), file=sys.stderr)
sys.exit(code)
"""
FEW = 0.1
"""Of all objects, those that a collection may still look at: then it takes some ms at most."""


@pytest.mark.exhaustive
def test_a_collection_while_the_daemon_plays_looks_at_few_objects(tmp_path: Path) -> None:
    arguments = (
        "run",
        "--tap",
        "scene:demo",
        "--seconds",
        "1",
        "--device",
        f"wav:{tmp_path}/a.wav",
    )
    done = subprocess.run(
        [sys.executable, "-c", AT_THE_END, *arguments],
        env=environment(XDG_RUNTIME_DIR=str(tmp_path)),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    spared, looked_at = map(int, done.stderr.splitlines()[-1].split())
    assert spared > 20_000
    assert looked_at < FEW * spared
