import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.core import compiled_core
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.sources import mixdown
from audioflinger_hook.transform.design import LiveDesign
from device.drive.design import DriveDesign
from device.errors import InternalError
from tests.plugin.hosting import STRONG, driven_design, several_drives
from tests.support.costs import resident_bytes
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


LOW_RATE = 8_000
TRANSFORM = LiveDesign.of(parameters_of("cinema"), LOW_RATE).records()
DRIVES = several_drives(LOW_RATE)
SOUND = np.random.default_rng(3).uniform(-1.0, 1.0, (2_500, 2)).astype(np.float32)


def made(**changes: Any) -> Core:
    parts: dict[str, Any] = {"transform": TRANSFORM, "drives": DRIVES, "delay_frames_max": LOW_RATE}
    core = Core(core_design(LOW_RATE, 2, each=True, **(parts | changes)))
    for number, controls in enumerate(core.controls.actuators[:3]):
        controls.gain, controls.source = (1.0, -0.5)[number % 2], number % 2
        controls.delay_frames = 100.0 * number
    return core


def test_it_goes_on_in_another_core_after_every_frame() -> None:
    expected = made().process(SOUND)
    assert (np.abs(expected).max(axis=0) > 0.05).all()
    cores, out = (made(), made()), []
    for frame in range(len(SOUND)):
        plays, waits = cores[frame % 2], cores[1 - frame % 2]
        out.append(plays.process(SOUND[frame : frame + 1]))
        waits.state = plays.state
    assert np.concatenate(out).tobytes() == expected.tobytes()


def test_it_brings_counts_temperatures_and_dose_along() -> None:
    first, other = made(), made()
    first.process(SOUND)
    other.state = first.state
    for core in (first, other):
        core.process(SOUND)
    for one, two in zip(first.readings.actuators[:2], other.readings.actuators[:2], strict=True):
        one.level = two.level  # those of a meter begin anew
        assert one.limited_blocks > 10
        assert bytes(one) == bytes(two)


def damaged_states() -> dict[str, bytes]:
    state = made().state
    numbers = {str(number): np.full(len(state) // 8, number) for number in (1.0, np.nan)}
    return {
        **{name: whole.tobytes() for name, whole in numbers.items()},
        "empty": b"",
        "short": state[:-8],
        "cut": state[:-1],
        "long": state + b"0",
        "ones": b"\xff" * len(state),
    }


@pytest.mark.parametrize("state", damaged_states().values(), ids=damaged_states())
def test_a_damaged_state_is_refused_and_the_core_is_at_rest(state: bytes) -> None:
    core = made()
    core.process(SOUND)
    with pytest.raises(InternalError, match="no core with this design"):
        core.state = state
    assert not core.process(np.zeros((1_000, 2), np.float32)).any()
    assert np.isfinite(core.process(SOUND)).all()


@given(place=st.floats(0.0, 1.0, exclude_max=True), flips=st.integers(1, 255))
@settings(max_examples=100)
def test_a_state_with_another_byte_is_refused(place: float, flips: int) -> None:
    core = made()
    core.process(SOUND)
    state = bytearray(core.state)
    state[int(place * len(state))] ^= flips
    with pytest.raises(InternalError, match="no core with this design"):
        core.state = bytes(state)


def test_the_state_of_another_design_of_the_same_size_is_refused() -> None:
    other = made(drives=[DRIVES[0], DriveDesign(STRONG, LOW_RATE, exposure_cap="action"), None])
    core = made()
    assert len(other.state) == len(core.state)
    with pytest.raises(InternalError, match="no core with this design"):
        core.state = other.state


def test_a_transform_alone_goes_on_with_its_gain() -> None:
    cores = [made(drives=[], delay_frames_max=0) for _ in range(2)]
    for core, gain in zip(cores, (0.5, 1.0), strict=True):
        core.controls.sound_gain = gain
    cores[0].process(SOUND)
    cores[1].state = cores[0].state
    cores[0].controls.sound_gain = 1.0
    first, other = (core.process(SOUND).tobytes() for core in cores)
    assert first == other


def test_a_host_sees_no_function_of_the_library_but_its_interface() -> None:
    # A hidden function whose name a host has, too, must not be taken from the host.
    library = Path(compiled_core.__file__).parent / "haptic_cushion.so"
    listed = subprocess.run(
        ["nm", "-D", "--defined-only", library], capture_output=True, text=True, check=True
    )
    names = {line.split()[-1] for line in listed.stdout.splitlines()}
    others = {name for name in names if not name.startswith("core_")}
    assert others == {"ladspa_descriptor", "lv2_descriptor"}


@pytest.mark.parametrize(
    "frames",
    [
        *(np.zeros((5, 1)), np.zeros(5), np.zeros((1, 5, 2)), np.zeros((5, 2), np.int32)),
        *(np.zeros((5, 2), ">f4"), np.frombuffer(bytes(81), np.float64, 10, 1).reshape(5, 2)),
    ],
    ids=["channels", "one dimension", "three", "integers", "byte order", "unaligned"],
)
def test_a_block_that_does_not_fit_is_refused(frames: np.ndarray) -> None:
    core = made()
    before = core.state
    for process in (core.vibrate, core.process):
        with pytest.raises(InternalError, match="a block has"):
            process(frames)
    assert (core.state, core.vibrate(np.zeros((0, 2))).shape) == (before, (0, 2))


@pytest.mark.parametrize("name", ["fft_length", "short_length"])
def test_a_length_that_no_fft_has_is_named(name: str) -> None:
    with pytest.raises(InternalError, match=f": {name}: has other factors than 2, 3 and 5"):
        made(transform={**TRANSFORM, name: 7 * 2**10})


def test_a_core_that_is_let_go_of_gives_its_memory_back() -> None:
    def cores(count: int) -> int:
        for _ in range(count):
            made().process(SOUND[:100])
            with pytest.raises(InternalError, match="fft_length"):
                made(transform={**TRANSFORM, "fft_length": 7 * 2**10})
        return resident_bytes()

    before = cores(50)
    assert cores(200) - before < 2**20
