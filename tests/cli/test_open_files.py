"""How many files `cushion run` may have open at once, and what it says of too few."""

import resource
import subprocess
import sys

import pytest

from audioflinger_hook.cli.process import NEEDED
from tests.support.commands import environment

RUN = (
    "-m",
    "audioflinger_hook",
    "run",
    "--tap",
    "scene:demo",
    "--device",
    "twin",
    "--seconds",
    "1",
)


def run(soft: int, hard: int) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *RUN],
        env=environment(),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard)),
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )


def test_a_low_limit_that_may_be_raised_is_raised() -> None:
    done = run(12, 4_096)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("hard", [20, NEEDED - 1])
def test_too_few_files_are_refused_with_the_limit_and_what_is_needed(hard: int) -> None:
    done = run(12, hard)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"cushion: error: only {hard} files may be open at once (ulimit -n)")
    assert str(NEEDED) in line
