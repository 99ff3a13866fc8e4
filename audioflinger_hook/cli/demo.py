"""`cushion demo`: computes the vibration of a built-in scene, writes files and prints a table."""

import argparse
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, Group
from rich.live import Live
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from audioflinger_hook.cli.arguments import given_values
from audioflinger_hook.cli.terminal import LineConsole, as_typed, level_text, warn
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.offline.inspection import inspect_tap
from audioflinger_hook.offline.render import ACCELERATION_COMMENT
from audioflinger_hook.pipeline.framework import Framework, channel_map_of, simulated_rig_of
from audioflinger_hook.pipeline.step import Pipeline, RealTimePace
from audioflinger_hook.scenes import Scene, demo_scene
from audioflinger_hook.sources import FramesTap, SceneClient, mixdown
from device.atomic_file import write_bytes_atomically
from device.drive.outputs import FADE_S, AlignedOutput, FadedOutput
from device.errors import UsageError
from device.rig.electronics import ACCELERATION_FULL_SCALE_M_S2
from device.rig.model_record import in_words
from device.rig.simulated_rig import SimulatedRig
from device.units import amplitude_to_db
from device.wav_output import WavOutput

BLOCKSIZE_FRAMES = 256  # frames of one buffer of the scene
FAINTEST_DB = -45.0  # dB of full scale; weaker principal frequencies get the smallest dot
REFRESH_S = 1 / 15
BAR_CELLS = 40
BAR_RANGE_DB = 60.0
SILENCE_DB = -70.0
SPECTRUM_WINDOW_S = 0.1
SPECTRUM_BANDS_HZ = np.arange(20, 221, 5)
STEPS = " ▁▂▃▄▅▆▇█"

Block = NDArray[np.floating[Any]]


@dataclass
class Played:
    """Data for the demo's table and picture."""

    scene: Scene
    sound: NDArray[np.float32]
    framework: Framework
    rig: SimulatedRig
    vibration: list[NDArray[np.float32]] = field(default_factory=list)
    acceleration: list[NDArray[np.float64]] = field(default_factory=list)
    buffer_s: list[float] = field(default_factory=list)


def run(options: argparse.Namespace) -> int:
    """Write vibration.wav, acceleration.wav, scene.wav and report.png to the folder of `--out`."""
    out: Path = options.out
    given = given_values(options, ("model", "tolerance"))
    settings = Settings().choosing(profile=options.profile or options.default_profile, **given)
    if settings.parameters.strength == "felt":
        # The demo simulates one rig, so the strength can follow the resonance of this rig.
        settings = replace(settings, parameters=replace(settings.parameters, strength="rig"))
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        what = f"the folder {out} cannot be made ({error.strerror})"
        if isinstance(error, FileExistsError):
            what = f"{out} is not a folder"
        raise UsageError(f"{what}; name another with --out") from None
    scene = demo_scene()
    framework = Framework(scene.samplerate, scene.channels, settings)
    warn(*framework.warnings)
    rate, channels = framework.samplerate, framework.haptic_channels
    picture = out / "report.png"
    if picture.is_dir():
        raise UsageError(f"cannot write {picture}: it is a folder; name another with --out")
    heard = WavOutput(out / "scene.wav", rate, scene.channels)
    recorder = WavOutput(out / "acceleration.wav", rate, channels, comment=ACCELERATION_COMMENT)
    rig = simulated_rig_of(settings, rate, channel_map_of(settings, channels), recorder)
    outputs = (WavOutput(out / "vibration.wav", rate, channels), rig)
    latency = framework.latency_frames
    faded = [FadedOutput(output, round(FADE_S * rate)) for output in outputs]
    aligned = [AlignedOutput(output, latency) for output in faded]
    chain = Pipeline(SceneClient(scene, BLOCKSIZE_FRAMES), framework, aligned)
    played = Played(scene, mixdown(scene), framework, rig)
    try:
        heard.write(played.sound)
        _play(chain, played, fast=options.fast)
        heard.close()
        chain.close()
        played.acceleration.append(rig.acceleration_m_s2)
    except BaseException:
        heard.abort()
        chain.abort()
        raise
    peak = max(float(np.abs(block).max(initial=0.0)) for block in played.vibration)
    values = {
        "latency of the transform": f"{framework.latency_s * 1e3:.1f} ms",
        "vibration, peak": level_text(peak),
        "acceleration, peak": f"{rig.peak_acceleration_m_s2:.1f} m/s² (predicted)",
    }
    drawn = True
    try:
        write_bytes_atomically(picture, _picture(played, values))
    except ImportError:
        warn("no report.png: matplotlib is not installed; `pip install matplotlib` brings it")
        drawn = False
    _print_table(out, played, values, drawn)
    print(f"to feel your own sound, type: {as_typed('setup')}")
    return 0


def _play(chain: Pipeline, played: Played, *, fast: bool) -> None:
    """Process the whole scene and show the levels, in real time unless `fast` is set."""
    scene, rig = played.scene, played.rig
    pace = RealTimePace(scene.samplerate, time.monotonic())
    frames = 0
    with Meter(scene, LineConsole(stderr=True)) as meter:
        began = time.thread_time()
        while step := chain.step(time.monotonic()):
            if len(step.audio):
                played.buffer_s.append(time.thread_time() - began)
            played.vibration.append(step.vibration)
            played.acceleration.append(rig.acceleration_m_s2)
            frames += len(step.audio)
            meter.show(frames, step.audio, step.vibration, rig.acceleration_m_s2)
            if not fast:
                time.sleep(pace.wait_s(frames, time.monotonic()))
            began = time.thread_time()


def _picture(played: Played, values: Mapping[str, str]) -> bytes:
    from audioflinger_hook.figures.report import report_png

    scene, sound, framework = played.scene, played.sound, played.framework
    settings = framework.settings
    frames = scene.frame_count
    latency = framework.latency_frames
    full_scale_r = settings.parameters.unit_strength_hz(scene.samplerate)
    principals = []
    for unit in inspect_tap(FramesTap(sound, scene.samplerate, frames), settings.parameters):
        total = sum(p.r for p in unit.principal)
        for p in unit.principal:
            level_db = amplitude_to_db(p.r * p.r / (total * full_scale_r))
            strength = min(1.0, max(0.0, 1.0 - level_db / FAINTEST_DB))
            middle_s = unit.start_s + settings.parameters.window_s / 2
            principals.append((middle_s, p.audio_hz, p.vibration_hz, strength))
    return report_png(
        title="Haptic Cushion: sound and vibration",
        samplerate=scene.samplerate,
        audio=sound,
        vibration=np.concatenate(played.vibration)[latency : latency + frames, 0],
        acceleration_m_s2=np.concatenate(played.acceleration)[:frames, 0],
        principals=principals,
        events=scene.events(),
        facts=(
            f"{settings.form} form, profile {settings.profile}",
            f"latency {framework.latency_s * 1e3:.1f} ms, taken out here",
            f"rig {settings.rig} (simulated)",
        ),
        description="; ".join(f"{name}: {value}" for name, value in values.items()),
    )


def _print_table(out: Path, played: Played, values: Mapping[str, str], drawn: bool) -> None:
    framework, rig = played.framework, played.rig
    buffer_ms = np.array(played.buffer_s) * 1e3
    buffer_length_ms = BLOCKSIZE_FRAMES / framework.samplerate * 1e3
    median, tail, worst = np.percentile(buffer_ms, (50, 99, 100))
    share = 100.0 * buffer_ms.sum() / (buffer_length_ms * buffer_ms.size)
    table = Table(title="Sound and vibration", show_header=False, title_justify="left")
    tracks = framework.mixer.tracks
    formats = ", ".join(f"{t.name} {t.format.value} {t.samplerate / 1e3:g} kHz" for t in tracks)
    table.add_row(f"{len(tracks)} tracks mixed", formats)
    table.add_row("sound", f"{len(buffer_ms)} buffers of {BLOCKSIZE_FRAMES} frames")
    for row in values.items():
        table.add_row(*row)
    table.add_row("samples limited", str(framework.limited_samples))
    table.add_row("unusable samples in the sound", str(framework.replaced_samples))
    table.add_row("excursion, peak", f"{rig.peak_displacement_m * 1e3:.2f} mm (predicted)")
    for line in in_words(rig.seconds):
        table.add_row("simulated rig", line)
    table.add_row("current, peak", f"{rig.peak_current_a:.2f} A (predicted)")
    table.add_row(
        f"time taken for {buffer_length_ms:.2f} ms of sound",
        f"median {median:.2f}, p99 {tail:.2f}, max {worst:.2f} ms ({share:.1f} % of one core)",
    )
    written = {
        "scene.wav": "what was played",
        "vibration.wav": "the vibration, for headphones",
        "acceleration.wav": f"full scale = {ACCELERATION_FULL_SCALE_M_S2:g} m/s²",
        "report.png": "all of it as a picture" if drawn else "not drawn",
    }
    for name, what in written.items():
        table.add_row(f"{name}: {what}", "" if what == "not drawn" else escape(str(out / name)))
    LineConsole().print(table)


class Meter:
    """Draws level meters if the console is a terminal. Only one thread may use it."""

    def __init__(self, scene: Scene, console: Console) -> None:
        self._scene = scene
        self._events = scene.events()
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._on = console.file.isatty()
        self._next_frame = 0
        self._peaks = np.zeros(3)
        self._recent = np.zeros(round(SPECTRUM_WINDOW_S * scene.samplerate))
        times_s = np.arange(self._recent.size) / scene.samplerate
        self._probe = np.exp(-2j * np.pi * SPECTRUM_BANDS_HZ[:, None] * times_s)
        self._probe *= np.hanning(self._recent.size) * (4.0 / self._recent.size)

    def __enter__(self) -> "Meter":
        if self._on:
            self._live.start()
        return self

    def __exit__(self, *_error: object) -> None:
        if self._on:
            self._live.stop()

    def show(self, frames: int, audio: Block, vibration: Block, acceleration: Block) -> None:
        """Add the next blocks, and redraw once per REFRESH_S. frames: frames played so far."""
        if not self._on:
            return
        peaks = [np.abs(block).max(initial=0.0) for block in (audio, vibration, acceleration)]
        self._peaks = np.maximum(self._peaks, peaks)
        newest = vibration[-self._recent.size :, 0]
        self._recent = np.concatenate((self._recent[newest.size :], newest))
        if frames >= self._next_frame:
            self._next_frame = frames + round(REFRESH_S * self._scene.samplerate)
            self._live.update(self._view(frames / self._scene.samplerate), refresh=True)
            self._peaks *= 0.6  # shown peaks decay over a few redraws

    def _view(self, now_s: float) -> Group:
        playing = ", ".join(label for start, end, label in self._events if start <= now_s < end)
        sound, vibration, acceleration = self._peaks
        level_db = 20.0 * np.log10(np.abs(self._probe @ self._recent) + 1e-9)
        height = np.clip(1.0 + level_db / 50.0, 0.0, 1.0) * (len(STEPS) - 1)
        spectrum = "".join(STEPS[round(h)] for h in height)
        return Group(
            Text(f"{now_s:5.1f} of {self._scene.duration_s:.0f} s   {playing or '-'}", "bold"),
            _bar("sound", sound, _level(sound), "cyan"),
            _bar("vibration", vibration, _level(vibration), "yellow"),
            _bar("cushion", acceleration / 100.0, f"{acceleration:5.1f} m/s²", "magenta"),
            Text.assemble(f"{'felt at':>10} 20 Hz ", (spectrum, "yellow"), " 220 Hz"),
        )


def _bar(label: str, amplitude: float, reading: str, colour: str) -> Text:
    share = min(1.0, max(0.0, 1.0 + amplitude_to_db(amplitude) / BAR_RANGE_DB))
    filled = round(share * BAR_CELLS)
    return Text.assemble(
        f"{label:>10} ", ("█" * filled, colour), ("░" * (BAR_CELLS - filled), "dim"), f" {reading}"
    )


def _level(amplitude: float) -> str:
    level_db = amplitude_to_db(amplitude)
    # The bar is already empty at -60 dBFS.
    return " silence" if level_db < SILENCE_DB else f"{round(level_db, 1) + 0.0:6.1f} dBFS"
