"""core.wasm, for the page "Try it", gives the bytes of the compiled core."""

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
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")


def in_node(design: bytes, sound: np.ndarray, block: int, folder: Path) -> tuple[bytes, Any]:
    """Return the vibration of a sound (frames, channels), and the times and readings."""
    (folder / "design").write_bytes(design)
    host = [ROOT / "tests/support/wasm_host.mjs", WASM, folder / "design", sound.shape[1], block]
    command = ["node", *map(str, host)]
    done = subprocess.run(command, input=sound.tobytes(), capture_output=True, check=True)
    return done.stdout, json.loads(done.stderr)


@needs_node
@pytest.mark.sweep
@pytest.mark.parametrize("rate", [44_100, 48_000])
@pytest.mark.parametrize("profile", PROFILES)
def test_each_profile_gives_the_bytes_of_the_compiled_core(profile, rate, tmp_path):
    records = LiveDesign.of(parameters_of(profile), rate).records()
    design = core_design(rate, 1, transform=records)  # core.js changes the number of channels
    for channels, block in ((1, 4_096), (2, 128), (8, 1_000)):
        sound = np.ascontiguousarray(np.tile(sounds(), 4)[:, :channels])
        core = Core(core_design(rate, channels, transform=records))
        expected = core.process(sound)
        vibration, told = in_node(design, sound, block, tmp_path)
        assert vibration == expected.tobytes(), (channels, block)
        assert [tuple(row) for row in told["partials"]] == list(core.partials)
        assert np.abs(expected).max() > 0.1
    with pytest.raises(subprocess.CalledProcessError) as refused:
        in_node(design[:40] + b"?" + design[41:], sounds()[:100], 128, tmp_path)
    assert b"the design is damaged" in refused.value.stderr


@needs_node
@pytest.mark.exhaustive
@pytest.mark.parametrize("profile", ["cinema", "game", "music", "speech"])
def test_a_quantum_of_the_browser_takes_a_small_share_of_its_time(profile, tmp_path):
    design = core_design(
        48_000, 1, transform=LiveDesign.of(parameters_of(profile), 48_000).records()
    )
    minute = np.ascontiguousarray(np.tile(sounds(), (30, 1))[: 60 * 48_000])
    runs = [in_node(design, minute, 128, tmp_path)[1] for _ in range(3)]
    p99_ms = min(told["p99_ms"] for told in runs)  # others may use the processor, too
    print(f"{profile}: median {runs[0]['median_ms']:.3f} ms, p99 {p99_ms:.3f} ms of 2.667 ms")
    assert p99_ms < 1.0


@pytest.mark.exhaustive
def test_the_committed_core_is_small_and_is_what_its_sources_give(tmp_path):
    assert WASM.stat().st_size <= 200_000
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the package ziglang is not installed")
    paths = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "PYTHONPATH": ":".join(sys.path)}
    build = [ROOT / "tools/wasm/build.sh", tmp_path / "core.wasm"]
    subprocess.run(build, env={**paths, "PYTHON": sys.executable}, check=True)
    assert (tmp_path / "core.wasm").read_bytes() == WASM.read_bytes(), "run tools/wasm/build.sh"
