import ctypes
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import LIVE_DEFAULT, parameters_of
from audioflinger_hook.core.compiled_core import Core
from audioflinger_hook.core.design import core_design
from audioflinger_hook.core.structures import Controls
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.drive.drive import driven_rigs
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.transform import HapticTransform
from device.drive.exposure import DoseSums
from device.drive.safety import SafetyState
from tests.plugin import hosting
from tests.plugin.hosting import PROFILES, any_design, any_lengths, any_sound, several_drives, split
from tests.support.programs import printed

RATE_HZ = 48_000
GAIN, DELAY, BYPASS = 0, 1, 2
CLICK = 0.02
"""Largest difference of two samples of vibration up to 220 Hz at full scale is 0.03."""


@pytest.fixture(scope="module", autouse=True)
def designs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("data")
    for profile in PROFILES:
        hosting.write_design(folder, profile, RATE_HZ)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_DATA_HOME", str(folder))
        yield folder


SOUND = any_sound(np.random.default_rng(1), RATE_HZ, 2 * RATE_HZ, 2, odd=())
Plug = Callable[[str], hosting.Instance]


@pytest.fixture
def plug() -> Iterator[Plug]:
    with ExitStack() as opened:
        yield lambda variant: opened.enter_context(
            closing(hosting.Instance(f"haptic_cushion_{variant}", RATE_HZ))
        )


seeds = st.integers(0, 2**32 - 1)
rates_hz = st.sampled_from(hosting.RATES_HZ) | st.integers(8_000, 192_000)
FRAMES = 100_000


@given(seed=seeds, rate_hz=rates_hz, profile=st.sampled_from(PROFILES))
def test_a_variant_gives_the_bytes_of_ctypes_at_any_rate_with_any_blocks_sound_and_controls(
    seed: int, rate_hz: int, profile: str, designs: Path
) -> None:
    rng = np.random.default_rng(seed)
    sound = any_sound(rng, rate_hz, FRAMES, 2)
    wanted = Core(hosting.write_design(designs, profile, rate_hz).read_bytes()).process(sound)[:, 0]
    instance = hosting.Instance(f"haptic_cushion_{profile}", rate_hz)
    # decibels, milliseconds: what is beyond the range counts as its end, what is no number as 0
    gain_db, gain = [(0.0, 1.0), (np.nan, 1.0), (1e30, 10.0), (-np.inf, 1e-3)][rng.integers(4)]
    delays = [(0.0, 0), (np.nan, 0), (np.inf, 1), (-1e30, 0), (1_000.0, 1)]
    delay_ms, delay_s = delays[rng.integers(5)]
    bypass = rng.choice([0.0, 0.0, np.nan, -np.inf, 1e30])
    instance.controls[GAIN], instance.controls[DELAY] = gain_db, delay_ms
    instance.controls[BYPASS] = bypass
    got = np.concatenate([instance.run(part) for part in split(sound, any_lengths(rng, FRAMES))])
    instance.close()
    wanted = (gain * wanted.astype(np.float64)).astype(np.float32) * np.float32(not bypass > 0.0)
    wanted = np.pad(wanted, (delay_s * rate_hz, 0))[:FRAMES]
    assert got[:, 0].tobytes() == got[:, 1].tobytes()
    # a factor other than 1 is rounded once more
    np.testing.assert_array_max_ulp(got[:, 0], wanted, maxulp=int(gain != 1.0))


def test_activate_begins_a_new_stream_whose_inputs_may_be_the_outputs(plug: Plug) -> None:
    instance = plug("paper")
    instance.run(SOUND[: RATE_HZ // 3])
    instance.activate()
    parts = [instance.run(part, in_place=True) for part in split(SOUND, (480, 5_000))]
    assert np.array_equal(np.concatenate(parts)[:, 1], hosting.vibration(SOUND, "paper", RATE_HZ))


def test_mono_takes_one_channel(plug: Plug) -> None:
    one = plug("mono")
    assert one.channels == 1
    got = np.concatenate([one.run(part) for part in split(SOUND[:, :1], (1024,))])
    assert np.array_equal(got[:, 0], hosting.vibration(SOUND[:, :1], LIVE_DEFAULT, RATE_HZ))


def test_it_reports_latency_and_peaks(plug: Plug) -> None:
    instance = plug("paper")
    got, controls = instance.run(SOUND), list(instance.controls)
    instance.controls[DELAY] = 10.0
    for _ in range(20):
        instance.run(SOUND[:1024])
    delayed_frames = instance.controls[hosting.LATENCY]
    assert 0.005 * RATE_HZ < controls[hosting.LATENCY] < 0.012 * RATE_HZ
    assert delayed_frames == controls[hosting.LATENCY] + 480.0
    loudest_db = 20.0 * np.log10(np.abs(SOUND).max())
    # it falls by 20 dB a second
    assert loudest_db - 12.0 < controls[hosting.SOUND_PEAK] <= loudest_db + 0.01
    assert controls[hosting.VIBRATION_PEAK] <= 20.0 * np.log10(np.abs(got).max()) + 0.01


def steady(instance: hosting.Instance, blocks: int, frames: int = 1024) -> hosting.Floats:
    """The vibration of a tone that goes on, block by block."""
    at_s = np.arange(blocks * frames) / RATE_HZ
    tone = (0.5 * np.sin(2 * np.pi * 200.0 * at_s)).astype(np.float32)
    parts = split(np.stack([tone, tone], 1), (frames,))
    return np.concatenate([instance.run(part) for part in parts])[:, 0]


def test_a_gain_is_reached_within_one_buffer_and_without_a_click(plug: Plug) -> None:
    instance = plug("paper")
    instance.controls[GAIN] = -6.0
    before, plain = steady(instance, 40), plug("paper")
    assert np.allclose(before, 10 ** (-6 / 20) * steady(plain, 40), atol=1e-7)
    instance.controls[GAIN] = 0.0
    after = steady(instance, 10)
    assert np.array_equal(after[1024:], steady(plain, 10)[1024:])
    assert np.abs(np.diff(after)).max() < CLICK


@pytest.mark.parametrize(("control", "value"), [(DELAY, 300.0), (BYPASS, 1.0)])
def test_delay_and_bypass_change_without_a_click(plug: Plug, control: int, value: float) -> None:
    instance = plug("paper")
    steady(instance, 40)
    instance.controls[control] = value
    there = steady(instance, 40)
    instance.controls[control] = 0.0
    back = steady(instance, 40)
    for part in (there, back):
        assert np.abs(np.diff(part)).max() < CLICK
    if control == BYPASS:
        assert not there[-1024:].any()
    assert np.abs(back[-4_096:]).max() > 0.1


def daemon_instance(
    folder: Path, monkeypatch: pytest.MonkeyPatch, design: bytes, page: Page, rate_hz: int
) -> hosting.Instance:
    path = folder / "design"
    path.write_bytes(design)
    monkeypatch.setenv("HAPTIC_CUSHION_DESIGN", str(path))
    monkeypatch.setenv("HAPTIC_CUSHION_PAGE", str(page.path))
    return hosting.Instance("haptic_cushion_daemon", rate_hz)


Daemon = Callable[..., tuple[Page, hosting.Instance]]


@pytest.fixture
def daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Daemon]:
    os.mkfifo(tmp_path / "changes")
    monkeypatch.setenv("HAPTIC_CUSHION_CHANGES", str(tmp_path / "changes"))
    with ExitStack() as opened:

        def make(design: bytes, channels: int, voices: int, sources: list[int]) -> Any:
            page = Page(tmp_path / "page", channels, voices, sources)
            opened.callback(page.close)
            instance = daemon_instance(tmp_path, monkeypatch, design, page, RATE_HZ)
            return page, opened.enter_context(closing(instance))

        yield make


def padded(sound: hosting.Floats) -> hosting.Floats:
    return np.pad(sound, ((0, 0), (0, 8 - sound.shape[1])))


UNDRIVEN = hosting.driven_design(RATE_HZ, 2, (), [None])
HEARS, FADES = round(0.2 * RATE_HZ), round(0.04 * RATE_HZ)  # see daemon_core.c


def change(page: Page, number: int, design: bytes, delay_frames: float = 0.0) -> None:
    folder = page.path.parent
    (folder / f"design.{number}").write_bytes(design)
    page.prepare(number, 1, [0])
    page.set_actuator(0, 1.0, delay_frames)
    page.layout.wanted = number
    file = os.open(folder / "changes", os.O_WRONLY | os.O_NONBLOCK)
    os.write(file, b"\0")
    os.close(file)


@pytest.mark.parametrize("delay", [0, RATE_HZ // 3])
def test_another_design_takes_over_by_a_cross_fade_once_it_heard_the_sound(
    daemon: Daemon, delay: int
) -> None:
    first, second = UNDRIVEN, any_design("protected", RATE_HZ, 2)
    page, instance = daemon(first, 2, 1, [0])
    page.set_audible(True)
    page.set_actuator(0, 1.0, delay)
    rng, sound, played = np.random.default_rng(5), [], []

    def play() -> None:
        sound.append(any_sound(rng, RATE_HZ, 1_024, 2))
        played.append(instance.run(padded(sound[-1])))

    while len(sound) < 20:
        play()
    change(page, 1, second, delay)
    while page.layout.playing != 1:
        play()
        assert len(sound) < 100_000, "the design was never loaded"
    begin = 1_024 * len(sound) - page.readings.frames
    play()
    old, new = Core(first), Core(second)
    for core in (old, new):
        ctypes.memmove(core._controls, ctypes.addressof(page.controls), ctypes.sizeof(Controls))
    whole = np.concatenate(sound)
    before, after = old.process(whole), new.process(whole[begin:])
    frames = np.arange(1, len(after) + 1) - delay
    x = np.clip((frames / RATE_HZ - 0.2) / 0.04, 0.0, 1.0)
    share = (x**3 * (10.0 + x * (6.0 * x - 15.0))).astype(np.float32)[:, None]
    wanted = before.copy()
    wanted[begin:] += share * (after - before[begin:])
    wanted[begin + delay + HEARS + FADES :] = after[delay + HEARS + FADES :]
    got = np.concatenate(played)[:, : old.outputs]
    assert np.abs(got - wanted).max() <= 1e-7  # one step of float32 near 1 in the cross-fade
    assert got[:begin].tobytes() == wanted[:begin].tobytes()
    assert got[-1_024:].tobytes() == wanted[-1_024:].tobytes()


def test_a_design_that_cannot_be_used_is_refused_and_the_old_one_plays_on(daemon: Daemon) -> None:
    page, instance = daemon(UNDRIVEN, 2, 1, [0])
    page.set_audible(True)
    sound = padded(any_sound(np.random.default_rng(6), RATE_HZ, 1_024, 2))

    def play_until(condition: Callable[[], int]) -> None:
        for _ in range(100_000):
            instance.run(sound)
            if condition():
                return

    change(page, 1, any_design("protected", 44_100, 2))
    play_until(lambda: page.layout.refused)
    assert (page.layout.refused, page.layout.playing) == (1, 0)
    change(page, 3, any_design("protected", RATE_HZ, 2))
    play_until(lambda: page.layout.playing)
    assert page.layout.playing == 3
    assert instance.run(sound).any()


def test_a_host_that_opens_the_plugin_again_gets_the_latest_design(daemon: Daemon) -> None:
    page, instance = daemon(UNDRIVEN, 2, 1, [0])
    change(page, 1, any_design("protected", RATE_HZ, 2))
    instance.close()
    again = hosting.Instance("haptic_cushion_daemon", RATE_HZ)
    assert page.layout.playing == 1
    again.close()


@pytest.mark.sweep
@pytest.mark.parametrize("channels", [6, 2])
@settings(max_examples=5)
@given(seed=seeds, rate_hz=rates_hz, kind=st.sampled_from(hosting.DESIGNS))
@example(seed=0, rate_hz=176_400, kind="several")  # its blocks have few divisors
def test_the_daemons_variant_gives_the_bytes_of_ctypes_whatever_it_plays(
    tmp_path_factory: pytest.TempPathFactory, seed: int, rate_hz: int, kind: str, channels: int
) -> None:
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("daemon")
    sound, design = any_sound(rng, rate_hz, FRAMES, channels), any_design(kind, rate_hz, channels)
    core, page = Core(design), Page(folder / "page", channels, 3, [0, 0, 0])
    with pytest.MonkeyPatch.context() as patch:
        instance = daemon_instance(folder, patch, design, page, rate_hz)
    controls = page.controls
    controls.sound_gain = rng.choice([1.0, 0.7, *hosting.ODD])
    for part in np.split(sound, [rng.integers(1, FRAMES)]):
        for one in controls.actuators[:3]:  # one value in three is unusable
            one.gain = rng.choice([*rng.uniform(-1.0, 1.0, 10), *hosting.ODD])
            one.delay_frames = rng.choice([*rng.uniform(0.0, 2_000.0, 10), *hosting.ODD])
            one.source = (0, 1, 2, 2**63)[rng.integers(4)]
            one.audible, one.restores = (1, 0, 2**63)[rng.integers(3)], rng.integers(2)
            for name, _ in one.safety._fields_:
                setattr(one.safety, name, rng.choice([*rng.uniform(0.0, 60.0, 10), *hosting.ODD]))
        ctypes.memmove(core._controls, ctypes.addressof(controls), ctypes.sizeof(Controls))
        wanted, lengths = core.process(part), any_lengths(rng, len(part))
        got = np.concatenate([instance.run(padded(some)) for some in split(part, lengths)])
        assert got[:, : core.outputs].tobytes() == wanted.tobytes()
        assert not got[:, core.outputs :].any()
    assert page.readings.replaced == core.readings.replaced > 0
    for one, other in zip(page.readings.actuators, core.readings.actuators, strict=True):
        one.level = other.level  # it decays by the call
        assert bytes(one) == bytes(other)
    instance.close()
    page.close()


@pytest.mark.parametrize("sample", [*hosting.ODD, 3e38])
@pytest.mark.parametrize("kind", [*hosting.DESIGNS, "without transform"])
def test_what_is_no_usable_sample_reaches_no_actuator(
    daemon: Daemon, kind: str, sample: float
) -> None:
    only = core_design(RATE_HZ, 2, drives=several_drives(RATE_HZ)[:2])
    design = only if kind == "without transform" else any_design(kind, RATE_HZ, 2)
    page, instance = daemon(design, 2, 3, [0, 0, 0])
    page.set_audible(True)
    for sound in (
        np.full((4_800, 2), sample),
        any_sound(np.random.default_rng(1), 4_800, 4_800, 2),
    ):
        got = instance.run(padded(sound))
        assert np.isfinite(got).all()
        assert np.abs(got).max() <= 1.0


def test_an_actuator_follows_the_daemons_page_and_begins_silent(daemon: Daemon) -> None:
    page, instance = daemon(hosting.driven_design(RATE_HZ, 2, (), [None, None]), 2, 1, [0, 0])
    sound = padded(SOUND[:48_000])
    assert not instance.run(sound).any()
    page.set_audible(True)
    page.set_actuator(1, -0.5, 480.0)
    instance.run(sound)
    got = instance.run(sound)[:, :2]
    assert np.abs(got[:, 0]).max() > 0.05
    assert np.array_equal(got[480:, 1], np.float32(-0.5) * got[:-480, 0])
    assert np.abs(np.diff(got, axis=0)).max() < CLICK
    page.set_audible(False)
    instance.run(sound)
    assert page.faded_out(2)
    assert not instance.run(sound).any()


def test_a_coil_stays_hot_in_another_process_and_a_new_day_begins_meanwhile(daemon: Daemon) -> None:
    drives = several_drives(RATE_HZ)
    page, instance = daemon(hosting.driven_design(RATE_HZ, 2, (), drives), 2, 1, [0, 0, 0])
    rig = driven_rigs(drives, page.controls, page.readings, 1)[1]
    assert rig
    rig.restore([SafetyState(90.0, 50.0, DoseSums(60.0, 5.0, 25.0))])
    instance.run(padded(SOUND[:480]))
    (state,) = rig.safety_states()
    assert state.coil_c == pytest.approx(90.0, abs=0.1)
    assert state.magnet_c == pytest.approx(50.0, abs=0.1)
    assert state.dose.squares >= 5.0
    assert state.dose.time_s == pytest.approx(60.01, abs=1e-3)
    rig.begin_day()
    instance.run(padded(SOUND[:480]))
    (state,) = rig.safety_states()
    assert state.coil_c == pytest.approx(90.0, abs=0.1)
    assert state.dose.time_s == pytest.approx(0.01, abs=1e-3)
    instance.close()
    rig.keep(0.0)  # a host may open the plugin again on the same page
    again = hosting.Instance("haptic_cushion_daemon", RATE_HZ)
    again.run(padded(SOUND[:480]))
    (state,) = rig.safety_states()
    assert state.coil_c == pytest.approx(90.0, abs=0.2)
    assert state.dose.time_s == pytest.approx(0.02, abs=1e-3)
    again.close()


def test_the_daemons_transform_mixes_as_the_python_engine_does(daemon: Daemon) -> None:
    sources, channels = ("mix", "left", "front"), 6
    weights = source_weights(channels, sources)
    design = hosting.driven_design(RATE_HZ, channels, sources, [None] * 3)
    page, instance = daemon(design, channels, 3, [0, 1, 2])
    page.set_audible(True)
    sound = np.repeat(SOUND[:, :1], channels, axis=1)
    sound[:, 3] = 0.5 * np.roll(SOUND[:, 1], 999)
    got = instance.run(padded(sound))[:, :3]
    transform = HapticTransform(RATE_HZ, channels, parameters_of("cinema"), weights=weights)
    np.testing.assert_allclose(got, transform.process(sound), rtol=0, atol=1e-6)


def tried(*cases: dict[str, str], label: str = "haptic_cushion_paper") -> list[tuple[str, str]]:
    """What a plugin does, in another process, with these variables, and says on stderr."""
    inputs = 8 if label == "haptic_cushion_daemon" else 2
    did, said = printed(
        "from tests.plugin.hosting import Instance; import numpy, os\n"
        f"for variables in {list(cases)}:\n"
        "    os.environ.update(variables)\n"
        f"    one = Instance('{label}', {RATE_HZ})\n"
        f"    sound = numpy.ones((9_999, {inputs}), numpy.float32)\n"
        "    print('refused' if not one.made else 'played' if one.run(sound).any() else 'silent')\n"
        "    os.write(2, b'--\\n')\n"
    )
    return list(zip(did.split(), "".join(f"{one}\n" for one in said).split("--\n"), strict=False))


def test_a_host_may_end_what_was_not_instantiated_as_ffmpeg_does() -> None:
    ends = "[one.cleanup(None) for one in descriptors().values()]"
    printed(f"from tests.plugin.hosting import descriptors; {ends}")


def test_without_a_design_there_is_no_plugin_with_a_bad_one_silence_and_why(tmp_path: Path) -> None:
    good = hosting.write_design(tmp_path / "good", "paper", RATE_HZ).read_bytes()
    other = hosting.write_design(tmp_path, "paper", 44_100).read_bytes()
    unusable = hosting.damaged(good) | {"cannot be read": b"", "another samplerate": other}
    for reason, content in unusable.items():
        hosting.write_design(tmp_path / reason, "paper", RATE_HZ).write_bytes(content)
    folders = [tmp_path / "none", tmp_path / "good", *(tmp_path / reason for reason in unusable)]
    refused, played, *silent = tried(*({"XDG_DATA_HOME": str(folder)} for folder in folders))
    assert refused[0] == "refused"
    assert "no design of profile paper for 48000 Hz" in refused[1]
    assert played == ("played", "")
    for reason, (did, said) in zip(unusable, silent, strict=True):
        assert did == "silent"
        assert reason in said
    assert all(said.count("\n") == 1 for _, said in (refused, *silent))


def test_other_channels_give_silence_another_page_nothing_and_an_empty_name_is_no_page(
    tmp_path: Path,
) -> None:
    design, page = tmp_path / "design", tmp_path / "page"
    design.write_bytes(hosting.driven_design(RATE_HZ, 8, (), [None]))
    variables = {"HAPTIC_CUSHION_DESIGN": str(design)}
    ((did, said),) = tried(variables)
    assert did == "silent"
    assert "the design is for other channels; allowed: two, and no actuator" in said
    page.write_bytes(b"CUHPAGE1" + bytes(4_096))
    paths = {**variables, "HAPTIC_CUSHION_PAGE": str(page)}
    ((did, said),) = tried(paths, label="haptic_cushion_daemon")
    assert did == "refused"
    assert "the daemon's page cannot be used: it is of another version" in said
    hosting.write_design(tmp_path / "cushion", "paper", RATE_HZ)
    unnamed = {"XDG_DATA_HOME": str(tmp_path / "cushion"), "HAPTIC_CUSHION_PAGE": ""}
    assert tried(unnamed, label="haptic_cushion_daemon") == [("played", "")]


def test_the_variants_are_those_that_hosts_and_the_daemon_ask_for() -> None:
    labels = [f"haptic_cushion_{name}" for name in (*PROFILES, "mono", "daemon")]
    assert list(hosting.descriptors()) == labels
