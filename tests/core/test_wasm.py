"""core.wasm, for the page "Try it", gives the bytes of the compiled core."""

import gzip
import importlib.util
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.transform.design import LiveDesign
from tests.core.test_same_bytes import sounds
from tests.support.recordings import ROOT

WASM = ROOT / "audioflinger_hook/monitor/static/try/core.wasm"
NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="node is not installed")
QUANTUM_S = 128 / 48_000


def in_node(
    design: bytes, sound: np.ndarray, block: int, folder: Path
) -> tuple[bytes, dict[str, Any]]:
    """Return the vibration of a sound (frames, channels), and the times and readings."""
    path = folder / "design"
    path.write_bytes(design)
    host = [NODE, ROOT / "tests/support/wasm_host.mjs", WASM, path, sound.shape[1], block]
    done = subprocess.run(
        list(map(str, host)), input=sound.tobytes(), capture_output=True, check=True
    )
    return done.stdout, json.loads(done.stderr)


@needs_node
@pytest.mark.parametrize("rate", [44_100, 48_000])
@pytest.mark.parametrize("profile", PROFILES)
def test_each_profile_gives_the_bytes_of_the_compiled_core(profile, rate, tmp_path):
    records = LiveDesign.of(parameters_of(profile), rate).records()
    for channels, block in ((1, 4_096), (2, 128), (8, 1_000)):
        sound = np.tile(sounds(), 4)[:, :channels]
        core = Core(core_design(rate, channels, transform=records))
        expected = core.process(sound)
        # the page's designs are for one channel, and core.js changes the number
        design = core_design(rate, 1, transform=records)
        vibration, told = in_node(design, np.ascontiguousarray(sound), block, tmp_path)
        assert vibration == expected.tobytes(), (channels, block)
        assert [tuple(row) for row in told["partials"]] == list(core.partials)
        assert np.abs(expected).max() > 0.1


@needs_node
def test_a_quantum_takes_little_of_its_time_and_a_damaged_design_is_refused(tmp_path):
    records = LiveDesign.of(parameters_of("cinema"), 48_000).records()
    design = core_design(48_000, 2, transform=records)
    _, took = in_node(design, np.tile(sounds(), (10, 1)), 128, tmp_path)
    print(f"a quantum: median {took['median_ms']:.3f} ms, p99 {took['p99_ms']:.3f} ms")
    assert took["median_ms"] < 0.2e3 * QUANTUM_S
    with pytest.raises(subprocess.CalledProcessError) as refused:
        in_node(design[:40] + b"?" + design[41:], sounds()[:100], 128, tmp_path)
    assert b"the design is damaged" in refused.value.stderr


def test_the_committed_core_is_small_and_is_what_its_sources_give(tmp_path):
    assert WASM.stat().st_size <= 200_000
    assert len(gzip.compress(WASM.read_bytes())) < 60_000
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the package ziglang is not installed")
    built = tmp_path / "core.wasm"
    environment = {"PATH": "/usr/bin:/bin", "PYTHON": sys.executable, "HOME": str(tmp_path)}
    environment["PYTHONPATH"] = ":".join(filter(None, sys.path))
    subprocess.run([ROOT / "tools/wasm/build.sh", built], env=environment, check=True)
    assert built.read_bytes() == WASM.read_bytes(), "run tools/wasm/build.sh"
