"""Parts of the native engine that need no server: plans, ports, the shared page, the handover."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.core.structures import PARTIALS
from audioflinger_hook.daemon.engine import FADE_S, SoftFade
from audioflinger_hook.daemon.native import abilities
from audioflinger_hook.daemon.native import layout as layout_module
from audioflinger_hook.daemon.native.abilities import (
    check_engine,
    missing_parts,
    why_not_server,
    why_not_tap,
    why_python,
)
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.daemon.native.plan import ChainPlan
from audioflinger_hook.daemon.native.run import NativeRun
from audioflinger_hook.daemon.native.taps import in_mixing_order, port_names, tap_of
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.state import StateKeeper
from audioflinger_hook.sources import parse_tap
from device.address import parse_device
from device.drive import ActuatorSettings
from device.drive.channel_positions import actuators_of_channels
from device.errors import NotFoundError, UsageError
from device.layouts import layout
from device.server import PulseConnection
from device.server.snapshot import ServerSnapshot, Sink, Source

STEREO = "front-left,front-right"
SURROUND = "front-left,front-right,front-center,lfe,rear-left,rear-right"


def sink(channel_map: str = STEREO) -> Sink:
    count = channel_map.count(",") + 1
    return Sink(1, "dac", "DAC", "dac.monitor", 48_000, count, None, {}, channel_map)


def monitor(channel_map: str = STEREO) -> Source:
    count = channel_map.count(",") + 1
    return Source(2, "desk.monitor", "Desk", "desk", 48_000, count, {}, channel_map)


def config(settings: Settings | None = None, **live: Any) -> RunConfig:
    chosen = LiveSettings(device="sink:dac", **live)
    tap, device = parse_tap(chosen.tap[0]), parse_device(str(chosen.device))
    return RunConfig(tap, device, settings or Settings(), chosen)


# ------------------------------------------------------------------------------------- abilities


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({"protection": "on", "exposure_cap": "action", "damping": "auto"}, ""),
        ({"form": "reference"}, "transform = 'reference'"),
        ({"actuators": (ActuatorSettings((0,), protection="on"),)}, ""),
        (
            {"actuators": (ActuatorSettings((0,)), ActuatorSettings((1,), "left"))},
            "there is no sound server",
        ),
    ],
)
def test_the_first_thing_that_the_native_engine_cannot_do_is_named(
    changes: dict[str, Any], reason: str
) -> None:
    expected = reason or "there is no sound server"
    assert why_python(config(Settings(**changes)), None) == expected


@pytest.mark.parametrize(
    ("kind", "version", "reason"),
    [
        ("PipeWire", "0.3.65", ""),
        ("PipeWire", "1.2.0", ""),
        ("PipeWire", "0.3.48", "PipeWire 0.3.48 is too old; 0.3.50 or newer is needed"),
        ("PipeWire", "?", ""),
        ("PulseAudio", "16.1", "the sound server is PulseAudio"),
    ],
)
def test_an_old_or_another_server_is_named(kind: str, version: str, reason: str) -> None:
    assert why_not_server(ServerSnapshot(kind, version, "", "", (), (), (), (), 0)) == reason


def test_missing_parts_are_named_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plugin, folder = tmp_path / "plugin.so", tmp_path / "modules"
    monkeypatch.setattr(abilities, "plugin_path", lambda: plugin)
    monkeypatch.setattr(shutil, "which", lambda program: program)
    monkeypatch.setattr(abilities, "MODULE_FOLDERS", (str(folder),))
    folder.mkdir()
    assert "libpipewire-module-filter-chain.so is missing" in missing_parts()
    (folder / abilities.FILTER_CHAIN).touch()
    assert missing_parts() == ""
    monkeypatch.setattr(shutil, "which", lambda program: None)
    assert "the program pipewire is missing; install" in missing_parts()
    monkeypatch.setattr(abilities, "plugin_path", lambda: None)
    assert "the plugin is not built; run `make run`" in missing_parts()


def test_a_tap_may_have_eight_channels() -> None:
    assert why_not_tap(8) == ""
    assert why_not_tap(9) == "the tap has 9 channels, more than 8"


# ------------------------------------------------------------------------------------------ plans


@given(st.integers(1, 8))
def test_ports_come_in_the_order_in_which_the_mixer_counts_channels(channels: int) -> None:
    names = tuple({"BL": "RL", "BR": "RR", "BC": "RC"}.get(name, name) for name in layout(channels))
    assert in_mixing_order(tuple(reversed(names))) == names
    unknown = tuple(f"AUX{n}" for n in range(channels))
    assert in_mixing_order(unknown) == unknown
    at_the_sides = ("FL", "FR", "SL", "SR", "FC", "LFE")
    assert in_mixing_order(at_the_sides) == ("FL", "FR", "FC", "LFE", "SL", "SR")
    assert port_names("", channels) == unknown


def test_a_plan_routes_each_actuator_to_its_source() -> None:
    settings = Settings(
        actuators=(
            ActuatorSettings((0,), "right"),
            ActuatorSettings((1,), "left"),
            ActuatorSettings((2,), "right"),
        )
    )
    plan = ChainPlan.of(settings, tap_of(monitor(SURROUND), None), 48_000)
    assert plan.sources == ("left", "right")
    assert plan.actuators == (1, 0, 1)
    weights = plan.weights
    assert weights is not None
    assert weights.shape == (6, 2, 2)
    assert np.allclose(weights.sum(axis=0), 1.0)
    played = actuators_of_channels(sink(SURROUND), settings.actuators, plan.outputs)
    assert played.sources[:3] == (0, 1, 2)
    with pytest.raises(UsageError, match="no such channel"):
        actuators_of_channels(sink(), settings.actuators, plan.outputs)


def test_without_actuators_every_channel_of_the_device_plays() -> None:
    plan = ChainPlan.of(Settings(), tap_of(monitor(), None), 48_000)
    assert (plan.outputs, plan.actuators, plan.weights) == (1, (0,), None)
    assert actuators_of_channels(sink(SURROUND), (), plan.outputs).sources == (0,) * 6
    each = ChainPlan.of(Settings(channels="each"), tap_of(monitor(), None), 48_000)
    assert (each.outputs, each.actuators) == (2, (0, 1))


# ------------------------------------------------------------------------------------ shared page


def test_the_page_has_the_layout_that_the_plugin_reads(tmp_path: Path) -> None:
    layout_class: Any = layout_module.Layout
    fields = [name for name, _ in layout_class._fields_]
    lines = [f'printf("%zu\\n", offsetof(Page, {name}));' for name in fields]
    program = tmp_path / "layout.c"
    header = Path(layout_module.__file__).parents[2] / "plugin/native/page.h"
    program.write_text(
        f'#include <stddef.h>\n#include <stdio.h>\n#include "{header}"\n'
        f'int main(void) {{ printf("%zu\\n", sizeof(Page)); {" ".join(lines)} return 0; }}\n'
    )
    subprocess.run(["gcc", str(program), "-o", str(tmp_path / "layout")], check=True)
    found = subprocess.run([tmp_path / "layout"], capture_output=True, text=True, check=True)
    offsets = [getattr(layout_class, name).offset for name in fields]
    assert list(map(int, found.stdout.split())) == [ctypes.sizeof(layout_class), *offsets]


def test_a_page_is_private_and_its_file_goes_with_it(tmp_path: Path) -> None:
    path = tmp_path / "page"
    page = Page(path, 2, 1, [0])
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(FileExistsError):
        Page(path, 2, 1, [0])
    page.set_actuator(0, -0.5, 9.0)
    page.set_audible(True)
    assert page.frames == 0
    page.close()
    page.close()
    assert not path.exists()


def test_partials_that_are_being_written_are_not_read(tmp_path: Path) -> None:
    page = Page(tmp_path / "page", 2, 1, [0])
    told = page._page.readings
    assert page.principal() == []
    told.sequence, told.partials_count = 2, 1
    told.partials[0][:] = (440.0, 100.0, 0.25)
    assert page.principal() == [(440.0, 100.0, 0.25)]
    assert page.reader.shown() == ((2, 1, 1), (*(0.0,) * 6, 440.0, 100.0, 0.25))
    told.sequence = 3  # odd: the plugin is writing
    assert page.principal() == []
    assert page.reader.shown() == ((2, 1, 0), (0.0,) * 6)
    told.sequence, told.partials_count = 4, 1 << 40  # of a plugin gone wrong
    assert len(page.principal()) == PARTIALS
    page.close()


def test_levels_are_read_for_each_channel_and_actuator(tmp_path: Path) -> None:
    page = Page(tmp_path / "page", 2, 1, [0, 0])
    readings = page._page.readings
    readings.sound[1].peak, readings.sound[1].mean_square = 0.5, 0.125
    level = readings.actuators[1].level
    level.peak, level.mean_square = 0.25, 0.03
    assert page.channel_readings() == [(0.0, 0.0), (0.5, 0.125)]
    assert page.reader.shown() == ((2, 2, 0), (0.0, 0.0, 0.5, 0.125, 0.0, 0.0, 0.25, 0.03))
    page.close()


# ------------------------------------------------------------------------------------------- fades


@pytest.mark.parametrize("frames", [1, 64, 512, 8_191])
def test_a_fade_has_no_step_however_long_the_blocks_are(frames: int) -> None:
    fade, tone = SoftFade(48_000), np.ones((24_000, 2), np.float32)
    for audible in (False, True):
        fade.audible = audible
        blocks = [tone[start : start + frames].copy() for start in range(0, len(tone), frames)]
        for block in blocks:
            fade.apply(block)
        whole = np.concatenate(blocks)
        assert np.abs(np.diff(whole[:, 0])).max() < 1.51 / (FADE_S * 48_000)
        assert (whole[2_000:] == float(audible)).all()
    block = np.full((100, 1), 0.3, np.float32)
    fade.apply(block)
    assert (block == np.float32(0.3)).all()


def test_the_volume_is_set_again_on_another_server_that_gives_the_same_index(
    tmp_path: Path,
) -> None:
    config = RunConfig(
        parse_tap("default"), parse_device("sink:dac"), Settings(), LiveSettings(device="dac")
    )
    native = NativeRun(config, tmp_path, StateKeeper(0.0), lambda: None, lambda *_: None)
    volume, levels_db = DeviceVolume(-6.0), list[tuple[str, float]]()
    for name in "ab":
        server = SimpleNamespace(
            set_sink_volume_db=lambda _sink, level_db, name=name: levels_db.append((name, level_db))
        )
        for _ in range(2):
            native._set_volume(sink(), cast(PulseConnection, server), volume)
    assert levels_db == [("a", -6.0), ("b", -6.0)]


@pytest.mark.parametrize(
    ("tap", "device", "is_refused"),
    [
        ("default", "sink:dac", True),
        ("app:mpv", "sink:dac", True),
        ("default", "hw:DAC", True),
        ("app:mpv", "hw:DAC", False),
    ],
)
def test_a_python_engine_that_lacks_alsas_plugin_is_refused_at_the_start(
    tap: str, device: str, is_refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(abilities, "missing_plugin", lambda: "the plugin is missing")
    live = LiveSettings(tap=(tap,), engine="python")
    config = RunConfig(parse_tap(tap), parse_device(device), Settings(), live)
    refused = pytest.raises(NotFoundError, match=r"engine = 'python'.*the plugin is missing")
    with refused if is_refused else nullcontext():
        check_engine(config, None)
