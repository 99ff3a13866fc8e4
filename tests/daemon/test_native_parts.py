"""Parts of the native engine that need no server: plans, designs, ports, the shared page."""

import ctypes
import shutil
import subprocess
import time
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.core.structures import PARTIALS
from audioflinger_hook.daemon.engine import FADE_S, SoftFade
from audioflinger_hook.daemon.native import abilities
from audioflinger_hook.daemon.native import layout as layout_module
from audioflinger_hook.daemon.native import plan as module
from audioflinger_hook.daemon.native.chains import Chains
from audioflinger_hook.daemon.native.page import Page
from audioflinger_hook.daemon.native.plan import LONGEST_WAIT_S, ChainPlan, DriveDesigns
from audioflinger_hook.daemon.native.run import NativeRun
from audioflinger_hook.daemon.native.taps import Tap, in_mixing_order, port_names, tap_of
from audioflinger_hook.daemon.outputs.base import DeviceVolume
from audioflinger_hook.service.state import StateKeeper
from device.drive import ActuatorSettings
from device.drive.channel_positions import actuators_of_channels
from device.drive.design import DriveDesign, DrivePlan, design_of
from device.errors import LostError, NotFoundError, UsageError
from device.layouts import layout
from device.server import PulseConnection
from device.server.snapshot import ServerSnapshot, Sink, Source
from device.units import db_to_amplitude
from tests.support.alsa_files import until
from tests.support.programs import printed
from tests.support.run_configs import config

STEREO = "front-left,front-right"
SURROUND = "front-left,front-right,front-center,lfe,rear-left,rear-right"


def sink(channel_map: str = STEREO) -> Sink:
    count = channel_map.count(",") + 1
    return Sink(1, "dac", "DAC", "dac.monitor", 48_000, count, None, {}, channel_map)


def monitor(channel_map: str = STEREO) -> Source:
    count = channel_map.count(",") + 1
    return Source(2, "desk.monitor", "Desk", "desk", 48_000, count, {}, channel_map)


TWO = (ActuatorSettings((0,), protection="on"), ActuatorSettings((1,), "left"))
NO_SERVER = "there is no sound server"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, NO_SERVER),
        ({"protection": "on", "exposure_cap": "action", "damping": "auto"}, NO_SERVER),
        ({"actuators": TWO}, NO_SERVER),
        ({"form": "reference"}, "transform = 'reference'"),
    ],
)
def test_the_first_thing_that_the_native_engine_cannot_do_is_named(changes, reason):
    assert abilities.why_python(config(settings=Settings(**changes)), None) == reason
    assert abilities.why_python(config(drop_in=True), None) == "drop_in is on"
    assert abilities.why_python(config(engine="python"), None) == "engine = 'python'"


@pytest.mark.parametrize(
    ("kind", "version", "reason"),
    [
        *(("PipeWire", "0.3.65", ""), ("PipeWire", "1.2.0", "")),
        ("PipeWire", "0.3.48", "PipeWire 0.3.48 is too old; 0.3.50 or newer is needed"),
        *(("PipeWire", "?", ""), ("PulseAudio", "16.1", "the sound server is PulseAudio")),
    ],
)
def test_an_old_or_another_server_is_named_and_a_tap_of_over_eight_channels(kind, version, reason):
    server = ServerSnapshot(kind, version, "", "", (), (), (), (), 0)
    assert (abilities.why_not_server(server), abilities.why_not_tap(8)) == (reason, "")
    assert abilities.why_not_tap(9) == "the tap has 9 channels, more than 8"


def test_missing_parts_are_named_with_what_to_install(monkeypatch, tmp_path):
    plugin, folder = tmp_path / "plugin.so", tmp_path / "modules"
    monkeypatch.setattr(abilities, "plugin_path", lambda: plugin)
    monkeypatch.setattr(shutil, "which", lambda program: program)
    monkeypatch.setattr(abilities, "MODULE_FOLDERS", (str(folder),))
    folder.mkdir()
    assert "libpipewire-module-filter-chain.so is missing" in abilities.missing_parts()
    (folder / abilities.FILTER_CHAIN).touch()
    assert abilities.missing_parts() == ""
    monkeypatch.setattr(shutil, "which", lambda program: None)
    assert "the program pipewire is missing; install" in abilities.missing_parts()
    monkeypatch.setattr(abilities, "plugin_path", lambda: None)
    assert "the plugin is not built; run `make run`" in abilities.missing_parts()


@given(st.integers(1, 8))
def test_ports_come_in_the_order_in_which_the_mixer_counts_channels(channels):
    names = tuple({"BL": "RL", "BR": "RR", "BC": "RC"}.get(name, name) for name in layout(channels))
    assert in_mixing_order(tuple(reversed(names))) == names
    unknown = tuple(f"AUX{n}" for n in range(channels))
    assert in_mixing_order(unknown) == unknown
    at_the_sides = ("FL", "FR", "SL", "SR", "FC", "LFE")
    assert in_mixing_order(at_the_sides) == ("FL", "FR", "FC", "LFE", "SL", "SR")
    assert port_names("", channels) == unknown


def test_a_plan_routes_each_actuator_to_its_source_and_without_them_every_channel_plays():
    sides = ("right", "left", "right")
    actuators = tuple(ActuatorSettings((n,), side) for n, side in enumerate(sides))
    settings = Settings(actuators=actuators)
    plan = ChainPlan.of(settings, tap_of(monitor(SURROUND), None), 48_000)
    assert (plan.sources, plan.actuators) == (("left", "right"), (1, 0, 1))
    weights: Any = plan.weights
    assert weights.shape == (6, 2, 2)
    assert np.allclose(weights.sum(axis=0), 1.0)
    played = actuators_of_channels(sink(SURROUND), settings.actuators, plan.outputs)
    assert played.sources[:3] == (0, 1, 2)
    with pytest.raises(UsageError, match="no such channel"):
        actuators_of_channels(sink(), settings.actuators, plan.outputs)
    plan = ChainPlan.of(Settings(), tap_of(monitor(), None), 48_000)
    assert (plan.outputs, plan.actuators, plan.weights) == (1, (0,), None)
    assert actuators_of_channels(sink(SURROUND), (), plan.outputs).sources == (0,) * 6
    each = ChainPlan.of(Settings(channels="each"), tap_of(monitor(), None), 48_000)
    assert (each.outputs, each.actuators) == (2, (0, 1))


def test_the_page_has_the_layout_that_the_plugin_reads(tmp_path):
    layout_class: Any = layout_module.Layout
    fields = [name for name, _ in layout_class._fields_]
    lines = [f'printf("%zu\\n", offsetof(Page, {name}));' for name in fields]
    program = tmp_path / "layout.c"
    header = Path(layout_module.__file__).parents[2] / "plugin/native/parts.h"
    program.write_text(
        f'#include <stddef.h>\n#include <stdio.h>\n#include "{header}"\n'
        f'int main(void) {{ printf("%zu\\n", sizeof(Page)); {" ".join(lines)} return 0; }}\n'
    )
    subprocess.run(["gcc", str(program), "-o", str(tmp_path / "layout")], check=True)
    found = subprocess.run([tmp_path / "layout"], capture_output=True, text=True, check=True)
    offsets = [getattr(layout_class, name).offset for name in fields]
    assert list(map(int, found.stdout.split())) == [ctypes.sizeof(layout_class), *offsets]


def test_a_gain_rises_in_a_design_with_another_protection_only_once_that_one_plays(tmp_path):
    page = Page(tmp_path / "page", 2, 1, [0])
    quiet = config(settings=Settings(gain_db=-20.0))
    chains = Chains(quiet, tmp_path, lambda *_: None, DriveDesigns())
    plan = ChainPlan.of(Settings(), Tap("desk", ("FL", "FR"), "desk"), 48_000)
    chain = cast(Any, SimpleNamespace(page=page, design=SimpleNamespace(plan=plan)))
    chains.current = cast(Any, SimpleNamespace(chain=chain))
    steps = [("off", -20.0, -20.0, -20.0), ("on", -6.0, -20.0, -6.0), ("on", -40.0, -40.0, -40.0)]
    for protection, gain_db, playing_db, next_db in (*steps, ("off", -6.0, -6.0, -6.0)):
        rig: Any = {"rig": "consumer", "protection": protection} if protection == "on" else {}
        chains.follow(config(settings=Settings(gain_db=gain_db, **rig)))
        gains = [bank.controls.actuators[0].gain for bank in page.layout.banks]
        assert gains == pytest.approx([db_to_amplitude(playing_db), db_to_amplitude(next_db)])
    page.close()


def test_a_page_is_private_and_tells_levels_and_partials_unless_they_are_being_written(tmp_path):
    path = tmp_path / "page"
    page = Page(path, 2, 1, [0])
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(FileExistsError):
        Page(path, 2, 1, [0])
    told = page.readings
    assert page.frames == 0
    assert page.principal() == []
    told.sequence, told.partials_count = 2, 1
    told.partials[0][:] = (440.0, 100.0, 0.25)
    assert page.principal() == [(440.0, 100.0, 0.25)]
    assert page.reader.shown() == ((2, 1, 1), (*(0.0,) * 6, 440.0, 100.0, 0.25))
    told.sequence = 3  # odd: the plugin is writing
    assert (page.principal(), page.reader.shown()) == ([], ((2, 1, 0), (0.0,) * 6))
    told.sequence, told.partials_count = 4, 1 << 40  # of a plugin gone wrong
    assert len(page.principal()) == PARTIALS
    for _ in range(2):
        page.close()
    assert not path.exists()
    page = Page(tmp_path / "page", 2, 1, [0, 0])  # levels of each channel and actuator
    readings = page.readings
    readings.sound[1].peak, readings.sound[1].mean_square = 0.5, 0.125
    level = readings.actuators[1].level
    level.peak, level.mean_square = 0.25, 0.03
    assert page.channel_readings() == [(0.0, 0.0), (0.5, 0.125)]
    assert page.reader.shown() == ((2, 2, 0), (0.0, 0.0, 0.5, 0.125, 0.0, 0.0, 0.25, 0.03))
    page.close()


@pytest.mark.parametrize("frames", [1, 64, 512, 8_191])
def test_a_fade_has_no_step_however_long_the_blocks_are(frames):
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
    fade.position = 0.0  # from silence it waits for the first vibration
    block = np.zeros((4_000, 1), np.float32)
    fade.apply(block)
    block[3_000:] = 0.5
    fade.apply(block)
    assert 0.0 < block[3_000] < 0.001
    assert np.abs(np.diff(block[:, 0])).max() < 0.76 / (FADE_S * 48_000)
    assert 0.1 < fade.position < 1.0


def test_the_volume_is_set_again_on_another_server_that_gives_the_same_index(tmp_path):
    native = NativeRun(config(), tmp_path, StateKeeper(0.0), lambda: None, lambda *_: None)
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
        *(("default", "sink:dac", True), ("app:mpv", "sink:dac", True)),
        *(("default", "hw:DAC", True), ("app:mpv", "hw:DAC", False)),
    ],
)
def test_a_python_engine_without_alsas_plugin_is_refused(tap, device, is_refused, monkeypatch):
    monkeypatch.setattr(abilities, "missing_plugin", lambda: "the plugin is missing")
    refused = pytest.raises(NotFoundError, match=r"engine = 'python'.*the plugin is missing")
    with refused if is_refused else nullcontext():
        abilities.check_engine(config(device=device, tap=(tap,), engine="python"), None)


CARE = {"protection": "on", "damping": "auto", "exposure_cap": "action"}
PAPER = DrivePlan.of("paper", 48_000, "auto", "on", "action")
CONSUMER = DrivePlan.of("consumer", 48_000, "off", "on", "off")


def made(designs: DriveDesigns, *plans: DrivePlan | None) -> list[DriveDesign | None]:
    deadline_s = time.monotonic() + 30.0
    while (found := designs.of(plans, time.monotonic())) is None:
        assert time.monotonic() < deadline_s
        assert designs.is_busy
        time.sleep(0.01)
    assert not designs.is_busy
    return found


def test_designs_of_a_process_are_those_that_would_be_made_here():
    designs = DriveDesigns()
    assert designs.of([None], 0.0) == [None]
    found: Any = made(designs, PAPER, None, CONSUMER, PAPER)
    assert found[1] is None
    assert found[0] is found[3]
    plans: Any = PAPER, CONSUMER
    for plan, design in zip(plans, found[::2], strict=False):
        here = design_of(plan)
        assert (design, design.worst_second) == (here, here.worst_second)
        assert design.bounds().warmest == here.bounds().warmest
        for name, value in here.records.items():
            np.testing.assert_array_equal(design.records[name], value)
    # nothing more is made, whatever is asked for again
    assert designs.of([CONSUMER], 0.0) == [found[2]]
    with pytest.raises(UsageError, match="samplerate=4000 Hz is too low"):
        made(designs, DrivePlan.of("paper", 4_000, "off", "on", "off"))


def test_another_wish_takes_the_place_of_one_under_way():
    designs, now_s = DriveDesigns(), time.monotonic()
    assert designs.of([PAPER], now_s) is None
    first: Any = designs._call
    assert designs.of([CONSUMER], now_s) is None
    assert first._process.returncode is not None
    assert made(designs, CONSUMER)[0]


def failing(*_: object) -> list[DriveDesign]:
    raise ZeroDivisionError("no design")


def test_a_process_that_fails_is_tried_again_later_and_later(monkeypatch):
    started = []
    ended = SimpleNamespace(is_over=lambda _now_s: True, result=Mock(side_effect=LostError("it")))

    def begun(*_: object) -> SimpleNamespace:
        started.append(now_s)
        return ended

    monkeypatch.setattr(module, "Call", begun)
    designs, now_s, failed = DriveDesigns(), 0.0, []
    while now_s < 200.0:
        try:
            assert designs.of([PAPER], now_s) is None
        except LostError:
            failed.append(now_s)
        assert designs.failure == "it"
        now_s += 0.5
    assert failed == started
    assert 8 < len(started) < 16
    assert np.diff(started)[-1] == LONGEST_WAIT_S
    with pytest.raises(LostError):
        designs.of([CONSUMER], now_s)
    assert started[-1] == now_s  # another wish is tried at once


def test_a_chain_plays_on_where_the_next_ones_design_fails(tmp_path, monkeypatch):
    tap = Tap("desk", ("FL", "FR"), "desk")
    before = ChainPlan.of(Settings(), tap, 48_000)
    wanted = ChainPlan.of(Settings(**cast(Any, CARE)), tap, 48_000)
    chains = Chains(config(), tmp_path, lambda *_: None, DriveDesigns())
    monkeypatch.setattr(module, "designs_of", failing)
    chain = Mock(plan=before, is_changing=False)
    current: Any = SimpleNamespace(chain=chain, stands_s=lambda _: 0.0)
    chains.current = current

    def problem() -> str:
        chains.make(wanted, time.monotonic())
        return chains.problem

    until(problem)
    told = "the former settings play on: damping and protection cannot be computed: "
    assert chains.problem == f"{told}ZeroDivisionError: no design"
    assert (chains.current, chains.following) == (current, None)
    chains.make(before, time.monotonic())
    assert not chains.problem
    chains.current = None  # nothing plays: the engine fails
    with pytest.raises(LostError, match="cannot be computed"):
        until(lambda: chains.make(wanted, time.monotonic()))


def test_the_daemon_does_not_import_what_takes_most_memory():
    code = (
        "import sys, audioflinger_hook.cli.run, audioflinger_hook.daemon.native.engine\n"
        "from audioflinger_hook.config.profiles import PROFILES, parameters_of\n"
        "from audioflinger_hook.transform.design import LiveDesign\n"
        "from device.rig import PAPER\n"
        "from device.rig.thermal import Temperatures\n"
        "for name in PROFILES: LiveDesign.of(parameters_of(name), 48_000).to_bytes()\n"
        "Temperatures(PAPER.thermal).step(0.3)\n"
        "print(*sys.modules)"
    )
    loaded = set(printed(code)[0].split())
    assert "audioflinger_hook.daemon.native.engine" in loaded
    parts = ("signal", "optimize", "stats", "linalg", "fft", "special", "interpolate")
    heavy = {f"scipy.{part}" for part in parts}
    heavy |= {"numpy.random", "numpy.testing", "asyncio", "ssl", "hashlib", "rich.progress"}
    assert sorted(loaded & heavy) == []
