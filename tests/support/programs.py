import os
import subprocess
import sys
from collections.abc import Mapping

from tests.support.recordings import ROOT


def printed(
    program: str, *within: str, environment: Mapping[str, str] | None = None
) -> tuple[str, list[str]]:
    """What a program that `within` runs prints, stripped, and the lines of its errors."""
    done = subprocess.run(
        [*within, sys.executable, "-c", program],
        env={**(environment or os.environ), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr.splitlines()
