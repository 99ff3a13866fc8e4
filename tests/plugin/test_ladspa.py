"""The plugin as a LADSPA host sees it: the bytes of the transform, and no way to stop a host."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.config.profiles import LIVE_DEFAULT, parameters_of
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.transform import HapticTransform
from device.drive.damping import Damper
from device.drive.rig_processor import damping_for
from device.rig import rig_by_name
from tests.plugin.hosting import (
    LATENCY,
    PROFILES,
    SOUND_PEAK,
    VIBRATION_PEAK,
    Floats,
    Instance,
    descriptors,
    split,
    vibration,
    write_design,
)

RATE_HZ = 48_000
GAIN, DELAY, BYPASS = 0, 1, 2
CLICK = 0.02
"""Largest difference of two samples of vibration up to 220 Hz at full scale is 0.03."""


@pytest.fixture(scope="module", autouse=True)
def designs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("data")
    before = os.environ.get("XDG_DATA_HOME")
    os.environ["XDG_DATA_HOME"] = str(folder)
    for profile in PROFILES:
        write_design(folder, profile, RATE_HZ)
    yield folder
    if before is None:
        del os.environ["XDG_DATA_HOME"]
    else:
        os.environ["XDG_DATA_HOME"] = before


def bursts(seconds: float, seed: int = 1) -> Floats:
    """Bursts of two tones and noise, with silence between them, in two channels."""
    rng = np.random.default_rng(seed)
    at_s = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    tones = np.sin(2 * np.pi * 440.0 * at_s) + 0.4 * np.sin(2 * np.pi * 1_130.0 * at_s)
    on = (at_s % 0.5) < 0.3
    sound = np.stack([0.3 * tones, 0.2 * tones + 0.05 * rng.standard_normal(at_s.size)], 1)
    return (sound * on[:, None]).astype(np.float32)


SOUND = bursts(2.0)


# ------------------------------------------------------------------------------------ the vibration


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("lengths", [(1024,), (0, 1, 8_191, 3), (96_000,)])
def test_it_gives_the_bytes_of_the_transform_whatever_the_blocks(
    profile: str, lengths: tuple[int, ...]
) -> None:
    instance = Instance(f"haptic_cushion_{profile}", RATE_HZ)
    got = np.concatenate([instance.run(part) for part in split(SOUND, lengths)])
    instance.close()
    wanted = vibration(SOUND, profile, RATE_HZ)
    assert np.abs(wanted).max() > 0.01
    assert np.array_equal(got[:, 0], wanted)
    assert np.array_equal(got[:, 1], wanted)


@pytest.mark.parametrize("rate_hz", [44_100, 88_200, 96_000, 176_400, 192_000])
def test_it_works_at_every_samplerate_that_hosts_use(rate_hz: int, designs: Path) -> None:
    write_design(designs, "music", rate_hz)
    instance = Instance("haptic_cushion_music", rate_hz)
    got = np.concatenate([instance.run(part) for part in split(SOUND, (4_096,))])
    instance.close()
    assert np.array_equal(got[:, 0], vibration(SOUND, "music", rate_hz))


def test_inputs_may_be_the_outputs() -> None:
    instance = Instance("haptic_cushion_paper", RATE_HZ)
    parts = [instance.run(part, in_place=True) for part in split(SOUND, (480, 5_000))]
    instance.close()
    assert np.array_equal(np.concatenate(parts)[:, 1], vibration(SOUND, "paper", RATE_HZ))


def test_mono_takes_one_channel_and_two_instances_do_not_disturb_each_other() -> None:
    one, other = (Instance("haptic_cushion_mono", RATE_HZ) for _ in range(2))
    assert one.channels == 1
    quiet = np.zeros((1024, 1), np.float32)
    got = []
    for part in split(SOUND[:, :1], (1024,)):
        got.append(one.run(part))
        assert not other.run(quiet[: len(part)]).any()
    one.close()
    other.close()
    assert np.array_equal(np.concatenate(got)[:, 0], vibration(SOUND[:, :1], LIVE_DEFAULT, RATE_HZ))


def test_activate_begins_a_new_stream() -> None:
    instance = Instance("haptic_cushion_cinema", RATE_HZ)
    instance.run(SOUND[: RATE_HZ // 3])
    instance.activate()
    got = instance.run(SOUND)
    instance.close()
    assert np.array_equal(got[:, 0], vibration(SOUND, "cinema", RATE_HZ))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_unusable_samples_give_the_vibration_of_silence(bad: float) -> None:
    sound = SOUND.copy()
    sound[20_000:20_400] = bad
    usable = sound.copy()
    usable[20_000:20_400] = 0.0
    instance = Instance("haptic_cushion_paper", RATE_HZ)
    got = instance.run(sound)
    instance.close()
    assert np.isfinite(got).all()
    assert np.array_equal(got[:, 0], vibration(usable, "paper", RATE_HZ))


def test_it_reports_latency_and_peaks() -> None:
    instance = Instance("haptic_cushion_paper", RATE_HZ)
    got = instance.run(SOUND)
    controls = list(instance.controls)
    instance.controls[DELAY] = 10.0
    for _ in range(20):
        instance.run(SOUND[:1024])
    delayed_frames = instance.controls[LATENCY]
    instance.close()
    assert 0.005 * RATE_HZ < controls[LATENCY] < 0.012 * RATE_HZ
    assert delayed_frames == controls[LATENCY] + 480.0
    loudest_db = 20.0 * np.log10(np.abs(SOUND).max())
    assert (
        loudest_db - 12.0 < controls[SOUND_PEAK] <= loudest_db + 0.01
    )  # it falls by 20 dB a second
    assert controls[VIBRATION_PEAK] <= 20.0 * np.log10(np.abs(got).max()) + 0.01


# ------------------------------------------------------------------------------------- the controls


def steady(instance: Instance, blocks: int, frames: int = 1024) -> Floats:
    """The vibration of a tone that goes on, block by block."""
    at_s = np.arange(blocks * frames) / RATE_HZ
    tone = (0.5 * np.sin(2 * np.pi * 200.0 * at_s)).astype(np.float32)
    parts = split(np.stack([tone, tone], 1), (frames,))
    return np.concatenate([instance.run(part) for part in parts])[:, 0]


def test_a_gain_is_reached_within_one_buffer_and_without_a_click() -> None:
    instance = Instance("haptic_cushion_paper", RATE_HZ)
    instance.controls[GAIN] = -6.0
    before = steady(instance, 40)
    plain = Instance("haptic_cushion_paper", RATE_HZ)
    reference = steady(plain, 40)
    assert np.allclose(before, 10 ** (-6 / 20) * reference, atol=1e-7)
    instance.controls[GAIN] = 0.0
    after = steady(instance, 10)
    assert np.array_equal(after[1024:], steady(plain, 10)[1024:])
    assert np.abs(np.diff(after)).max() < CLICK
    instance.close()
    plain.close()


@pytest.mark.parametrize(("control", "value"), [(DELAY, 300.0), (BYPASS, 1.0)])
def test_delay_and_bypass_change_without_a_click(control: int, value: float) -> None:
    instance = Instance("haptic_cushion_paper", RATE_HZ)
    steady(instance, 40)
    instance.controls[control] = value
    there = steady(instance, 40)
    instance.controls[control] = 0.0
    back = steady(instance, 40)
    instance.close()
    for part in (there, back):
        assert np.abs(np.diff(part)).max() < CLICK
    if control == BYPASS:
        assert not there[-1024:].any()
    assert np.abs(back[-4_096:]).max() > 0.1


@given(gain=st.floats(width=32), delay=st.floats(width=32), bypass=st.floats(width=32))
@settings(max_examples=30, deadline=None)
def test_any_control_gives_finite_vibration(gain: float, delay: float, bypass: float) -> None:
    instance = Instance("haptic_cushion_paper", RATE_HZ)
    instance.controls[GAIN], instance.controls[DELAY], instance.controls[BYPASS] = (
        gain,
        delay,
        bypass,
    )
    got = instance.run(SOUND[:4_096])
    instance.close()
    assert np.isfinite(got).all()


# ---------------------------------------------------------------------------- the daemon's actuator


def test_an_actuator_damps_as_the_python_engine_does_and_follows_the_daemons_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_by_name("paper")
    damping = damping_for(rig.actuator, rig.amplifier.source_impedance_ohm)
    page = Page(tmp_path / "page", 2, 1, 1)
    page.set_damping(3, damping, RATE_HZ)
    page.set_audible(True)
    monkeypatch.setenv("HAPTIC_CUSHION_PAGE", str(page.path))
    actuator = Instance("haptic_cushion_actuator", RATE_HZ)
    actuator.controls[0] = 3.0
    drive = 0.2 * np.sin(2 * np.pi * 55.0 * np.arange(RATE_HZ) / RATE_HZ)[:, None]
    sound = drive.astype(np.float32)
    got = np.concatenate([actuator.run(part) for part in split(sound, (1_000, 37))])
    wanted = Damper(damping, RATE_HZ, 1).process(sound.astype(np.float64)).astype(np.float32)
    faded = RATE_HZ // 20  # it begins silent
    assert np.array_equal(got[faded:], wanted[faded:])
    assert got[0, 0] == 0.0
    page.set_actuator(3, -0.5, 0.0)
    actuator.run(sound)
    half = RATE_HZ // 2
    halved = actuator.run(sound)[half:]
    assert halved.min() == pytest.approx(-0.5 * wanted[half:].max(), rel=0.05)
    page.set_audible(False)
    actuator.run(sound)
    assert not actuator.run(sound).any()
    actuator.close()
    page.close()


def test_damping_that_asks_for_more_than_full_scale_lowers_the_level_and_does_not_clip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_by_name("paper")
    page = Page(tmp_path / "page", 2, 1, 1)
    page.set_damping(0, damping_for(rig.actuator, rig.amplifier.source_impedance_ohm), RATE_HZ)
    page.set_audible(True)
    monkeypatch.setenv("HAPTIC_CUSHION_PAGE", str(page.path))
    actuator = Instance("haptic_cushion_actuator", RATE_HZ)
    sine = np.sin(2 * np.pi * 40.0 * np.arange(4 * RATE_HZ) / RATE_HZ)[:, None]
    quiet = 0.02 * sine
    before = actuator.run(quiet.astype(np.float32))[2 * RATE_HZ :]
    loud = actuator.run(sine.astype(np.float32))[:, 0]
    assert 0.99 < np.abs(loud).max() <= 1.0
    # The first quarter of a period is flattened; after it the tone has no harmonics.
    steady = np.abs(np.fft.rfft(loud[-RATE_HZ:] * np.hanning(RATE_HZ)))
    assert steady[80:].max() < 1e-3 * steady[40]
    after = actuator.run(quiet.astype(np.float32))
    soon = after[RATE_HZ // 10 : RATE_HZ // 4]  # after what the filter itself held
    assert np.abs(soon).max() < 0.9 * np.abs(before).max()
    np.testing.assert_allclose(after[-RATE_HZ:], before[-RATE_HZ:], atol=1e-3)
    actuator.close()
    page.close()


# --------------------------------------------------------------------------- the daemon's transform


@pytest.mark.parametrize("sources", [(), ("mix", "left", "front")])
@pytest.mark.parametrize("channels", [2, 6])
def test_the_daemons_transform_mixes_as_the_python_engine_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sources: tuple[str, ...], channels: int
) -> None:
    weights = source_weights(channels, sources) if sources else None
    page = Page(tmp_path / "page", channels, max(1, len(sources)), 1, weights)
    monkeypatch.setenv("HAPTIC_CUSHION_PAGE", str(page.path))
    instance = Instance("haptic_cushion_daemon", RATE_HZ)
    sound = np.zeros((len(SOUND), 8), np.float32)
    sound[:, :2] = SOUND
    sound[len(SOUND) // 2 :, 1] = -sound[len(SOUND) // 2 :, 0]  # opposite channels
    sound[:, 2:channels] = 0.3 * np.roll(SOUND[:, :1], 999, axis=0)
    sound[100, 0] = np.nan
    got = np.concatenate([instance.run(part) for part in split(sound, (777, 1, 1_500, 64))])
    transform = HapticTransform(RATE_HZ, channels, parameters_of("paper"), weights=weights)
    wanted = transform.process(sound[:, :channels])
    outputs = wanted.shape[1]
    np.testing.assert_allclose(got[:, :outputs], wanted, rtol=0, atol=1e-6)
    assert not got[:, outputs:].any()
    assert np.abs(wanted[-RATE_HZ // 4 :, 0]).max() > 0.01
    assert page.readings().replaced_samples == 1
    instance.close()
    page.close()


# ---------------------------------------------------------------------------------------- real time


def test_denormals_do_not_slow_it() -> None:
    def seconds(sound: Floats) -> float:
        times = []
        for _ in range(5):
            instance = Instance("haptic_cushion_cinema", RATE_HZ)
            began_s = time.perf_counter()
            for part in split(sound, (1024,)):
                instance.run(part)
            times.append(time.perf_counter() - began_s)
            instance.close()
        return min(times)

    tiny = (1e-40 * np.random.default_rng(2).standard_normal(SOUND.shape)).astype(np.float32)
    assert (tiny != 0.0).any()
    noise = (0.1 * np.random.default_rng(2).standard_normal(SOUND.shape)).astype(np.float32)
    # denormal arithmetic would take ten times as long and more
    assert seconds(tiny) < 2.0 * seconds(noise)


# -------------------------------------------------------------------------- designs that do not fit


def refused(folder: Path, rate_hz: int = RATE_HZ) -> str:
    """What instantiation in another process says on stderr; it must neither succeed nor crash."""
    code = (
        "from tests.plugin.hosting import Instance; import sys; "
        f"sys.exit(3 if Instance('haptic_cushion_paper', {rate_hz}).made else 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"XDG_DATA_HOME": str(folder)},
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done
    return done.stderr


def test_a_host_may_end_what_was_not_instantiated_as_ffmpeg_does() -> None:
    code = (
        "from tests.plugin.hosting import descriptors; "
        "[face.cleanup(None) for face in descriptors().values()]"
    )
    folder = Path(__file__).parents[2]
    assert subprocess.run([sys.executable, "-c", code], cwd=folder).returncode == 0


def test_a_missing_or_unusable_design_is_refused_with_one_line(tmp_path: Path) -> None:
    said = refused(tmp_path)
    assert "no design of profile paper for 48000 Hz" in said
    path = write_design(tmp_path, "paper", RATE_HZ)
    whole = path.read_bytes()
    for content, reason in (
        (whole[:-8], "cut or too long"),
        (b"", "cannot be read"),
        (b"RIFF" + whole[4:], "not a design"),
        (whole[:8] + b"\x63" + whole[9:], "another version"),
        (whole[:400] + b"\xff" + whole[401:], "damaged"),
    ):
        path.write_bytes(content)
        said = refused(tmp_path)
        assert reason in said
        assert said.count("\n") == 1
    other = write_design(tmp_path, "paper", 44_100)
    other.rename(path)
    assert "another samplerate" in refused(tmp_path)


@given(data=st.data())
@settings(max_examples=40, deadline=None)
def test_no_mutated_design_crashes_the_host(data: st.DataObject, designs: Path) -> None:
    path = designs / "haptic-cushion/designs/mono-test.design"
    whole = bytearray((designs / "haptic-cushion/designs/paper-48000.design").read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    # a checksum that fits lets the damage through to the settings
    body = bytes(whole[:-8])
    path.write_bytes(body + struct.pack("<II", zlib.crc32(body), 0))
    os.environ["HAPTIC_CUSHION_DESIGN"] = str(path)
    try:
        instance = Instance("haptic_cushion_paper", RATE_HZ)
        if instance.made:
            instance.run(SOUND[:9_600])
        instance.close()
    finally:
        del os.environ["HAPTIC_CUSHION_DESIGN"]


def test_the_faces_are_those_that_hosts_and_the_daemon_ask_for() -> None:
    labels = [f"haptic_cushion_{name}" for name in (*PROFILES, "mono", "daemon", "actuator")]
    assert list(descriptors()) == labels
