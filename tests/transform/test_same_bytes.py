"""The live form gives the same bytes from every compiler, and without Python."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import mixdown
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.haptic import KernelStream
from tests.support.native_builds import BUILDS, NATIVE, built, transform_sources

HOST = Path(__file__).resolve().parents[1] / "support/transform_host.c"
RATE = 48_000


def sounds() -> np.ndarray:
    """Return two channels of the demo, noise, silence, a sweep and unusable samples."""
    rng = np.random.default_rng(4)
    time = np.arange(RATE) / RATE
    sweep = np.sin(2 * np.pi * 40 * 200**time / np.log(200))
    noise = rng.normal(0.0, 0.3, (RATE // 2, 2)) * [[1.0, 0.01]]
    odd = rng.normal(0.0, 0.3, (RATE // 10, 2))
    odd[::97] = np.nan
    odd[1::89] = 1e30
    parts = [mixdown(demo_scene())[: 2 * RATE], noise, np.zeros((RATE, 2)), odd]
    return np.concatenate([*parts, np.stack([sweep, -0.5 * sweep], 1)]).astype(np.float32)


@pytest.mark.parametrize("build", BUILDS)
def test_every_compiler_gives_the_bytes_of_the_kernel(build, tmp_path):
    host = built(build, HOST, transform_sources(), [NATIVE])
    sound = sounds()
    for profile, each, block in zip(PROFILES, (0, 1, 0, 1), (1_000, 64, 1, 48_000), strict=False):
        design = LiveDesign.of(parameters_of(profile), RATE)
        path = tmp_path / f"{profile}.design"
        path.write_bytes(design.to_bytes())
        command = [*host, path, "2", str(each), str(block)]
        found = subprocess.run(command, input=sound.tobytes(), capture_output=True, check=True)
        stream = KernelStream(design, 2, bool(each))
        expected = stream.process(sound)
        assert found.stdout == expected.tobytes(), profile
        assert np.abs(expected).max() > 0.1
