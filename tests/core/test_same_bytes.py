import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import mixdown
from audioflinger_hook.transform.design import LiveDesign
from tests.plugin.hosting import driven_design, several_drives
from tests.support.native_builds import CORE, CORE_SOURCES, EACH_BUILD, built

HOST = Path(__file__).resolve().parents[1] / "support/core_host.c"
RATE = 48_000


@cache
def sounds() -> np.ndarray:
    rng, time = np.random.default_rng(4), np.arange(RATE // 2) / RATE
    sweep = np.sin(2 * np.pi * 40 * 40_000**time / np.log(40_000))
    noise = rng.normal(0.0, 0.3, (RATE // 4, 2)) * [[1.0, 0.01]]
    odd = rng.normal(0.0, 0.3, (RATE // 10, 2))
    odd[::97] = np.nan
    odd[1::89] = 1e30
    parts = [mixdown(demo_scene())[:RATE], noise, np.zeros((RATE // 4, 2)), odd]
    return np.concatenate([*parts, np.stack([sweep, -0.5 * sweep], 1)]).astype(np.float32)


def played_without_python(host: list[str], design: bytes, block: int, folder: Path) -> bytes:
    path = folder / "design"
    path.write_bytes(design)
    command = [*host, str(path), str(block)]
    return subprocess.run(command, input=sounds().tobytes(), capture_output=True, check=True).stdout


@pytest.mark.parametrize("build", EACH_BUILD)
def test_every_compiler_gives_the_same_vibration(build: str, tmp_path: Path) -> None:
    host = built(build, HOST, CORE_SOURCES, [CORE])
    for profile, each, block in zip(PROFILES, (0, 1, 0, 1), (1_000, 64, 1, 48_000), strict=False):
        transform = LiveDesign.of(parameters_of(profile), RATE).records()
        design = core_design(RATE, 2, transform=transform, each=bool(each))
        expected = Core(design).vibrate(sounds())
        assert played_without_python(host, design, block, tmp_path) == expected.tobytes(), profile
        assert np.abs(expected).max() > 0.1


@pytest.mark.parametrize("build", EACH_BUILD)
def test_every_compiler_drives_actuators_alike(build: str, tmp_path: Path) -> None:
    host = built(build, HOST, CORE_SOURCES, [CORE])
    design = driven_design(RATE, 2, (), several_drives(RATE), each=True)
    core = Core(design)
    for number, controls in enumerate(core.controls.actuators[:3]):
        controls.gain, controls.source = (1.0, -0.5)[number % 2], number % 2
    expected = np.concatenate([core.process(part) for part in np.array_split(sounds(), 977)])
    for block in (96, 30_000):
        assert played_without_python(host, design, block, tmp_path) == expected.tobytes()
    assert core.readings.actuators[0].limited_blocks > 100
    assert core.readings.actuators[1].limited_blocks > 100
