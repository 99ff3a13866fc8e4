import errno
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.capture import Capture, segment
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.capture_queue import Feed
from audioflinger_hook.daemon.engine import Clocks, Engine
from audioflinger_hook.daemon.inputs.applications import ApplicationsFeed
from audioflinger_hook.daemon.recording import RunRecording, facts_of, settings_from
from audioflinger_hook.effect.haptic_parameters import HAPTIC_CUSHION
from audioflinger_hook.mixer import dump
from audioflinger_hook.transform import TransformParameters
from device.errors import UsageError, WriteError
from device.units import Float32Array
from tests.effect.test_registry import HALVER, HALVER_UUID, entry
from tests.pipeline.test_framework_effects import effects_xml
from tests.support.commands import call, noise, refused, vibration

STILL = Clocks(lambda: 0.0, lambda: 0.0)
PARAMETERS = TransformParameters(window_s=0.06, vibration_top_hz=150.0, partials_max=5)
OTHER = Settings(channels="each", parameters=PARAMETERS)
FORMATS = [(48_000, 2), (44_100, 2), (48_000, 1), (96_000, 6), (8_000, 1), (48_000, 2)]


class Run:
    """A feed, an engine and a recording, as the daemon has them; time goes with the frames."""

    def __init__(self, folder, settings, samplerate=48_000, channels=2):
        self.recording = RunRecording(folder, settings, "default", "sink:haptic")
        self.recording.begin()
        self.feed = Feed(self.recording)
        client = self.feed.client(samplerate, channels)
        on_step, _ = self.recording.hooks(samplerate, channels, of_mix=False)
        self.engine = Engine(client, 48_000, settings, clocks=STILL, on_step=on_step)
        self.feed.serve(self.engine)
        self.now_s = 0.0

    def play(self, frames: Float32Array, samplerate: int) -> None:
        self.now_s += len(frames) / samplerate
        self.feed.push(frames, self.now_s)

    def hear(self, seeds: range) -> None:
        for seed in seeds:
            self.play(noise(256, 2, seed).astype(np.float32), 48_000)


def recorded(folder: Path, stream: str) -> Float32Array:
    return np.concatenate([buffer.frames for buffer in Capture(folder).buffers(stream)])


def same_again(folder: Path, out: Path) -> int:
    """Replay; every frame of vibration that was recorded has to come again. How many there are."""
    done = call("replay", folder, out, "--json")
    assert (done.code, done.stderr) == (0, "")
    return overlap(folder, out, done.stdout)


def overlap(folder: Path, out: Path, report: str) -> int:
    """How many frames a recorded effect and its replay, of this JSON, share bit for bit: all."""
    told = json.loads(report)
    latency = round(told["latency_s"] * told["samplerate"])
    effect, again = recorded(folder, "effect")[latency:], vibration(out)
    common = min(len(effect), len(again))
    assert effect[:common].tobytes() == again[:common].tobytes()
    # what is sound on one side only is what the effect still owed
    assert len(again) - common <= latency + 4 * 2_048
    return common


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("seed", "settings"),
    [(0, Settings()), (1, OTHER), (2, Settings(form="reference")), (3, Settings())],
)
def test_a_replay_gives_the_recorded_effect_bit_for_bit(tmp_path, seed, settings):
    random = np.random.default_rng(seed)
    order = [FORMATS[n] for n in random.permutation(len(FORMATS))]
    run = Run(tmp_path / "cap", settings, *order[0])
    for samplerate, channels in order:
        run.feed.opened(22_050, 1)  # nothing came of it
        run.feed.opened(samplerate, channels)
        for _ in range(60):
            frames = int(random.choice([256, 256, 256, 1, 37, 1_024, 2_000]))
            sound = noise(frames, channels, int(random.integers(1 << 30)))
            run.play(sound.astype(np.float32), samplerate)
            if random.random() < 0.05:
                run.feed.moved()
    owed = run.feed.finish(run.now_s)
    run.recording.close()
    frames = same_again(tmp_path / "cap", tmp_path / "out.wav")
    assert frames == run.engine.frames
    assert len(recorded(tmp_path / "cap", "effect")) == frames + run.engine.framework.latency_frames
    assert len(owed) >= run.engine.framework.latency_frames


def test_a_mix_that_no_buffer_has_the_format_of_is_replayed_as_that_mix(tmp_path):
    run = Run(tmp_path / "cap", Settings(), 44_100, 1)
    run.feed.opened(48_000, 2)
    run.hear(range(100))
    run.feed.finish(run.now_s)
    run.recording.close()
    same_again(tmp_path / "cap", tmp_path / "out.wav")
    assert next(Capture(tmp_path / "cap").buffers("tap")).format == (44_100, 1)


def test_discontinuities_are_marked_on_the_first_buffer_after_them(tmp_path):
    run = Run(tmp_path / "cap", Settings())
    buffers = [noise(256, 2, number).astype(np.float32) for number in range(9)]
    run.feed.opened(48_000, 2)
    for number, buffer in enumerate(buffers):
        if number == 3:
            run.feed.moved()
        if number == 6:
            run.feed.opened(48_000, 2)
        run.play(buffer, 48_000)
    for number in range(6):
        if number in (0, 4):
            run.recording.reopened()
        run.recording.sent(buffers[number], float(number), 48_000)
    run.recording.close()
    capture = Capture(tmp_path / "cap")
    assert [b.discontinuity for b in capture.buffers("tap")].count(True) == 2
    for stream, broken in (("tap", [3, 6]), ("effect", [3, 6]), ("device", [4])):
        flags = [buffer.discontinuity for buffer in capture.buffers(stream)]
        assert list(np.flatnonzero(flags)) == broken
    times = [buffer.time_s for buffer in capture.buffers("tap")]
    assert times == pytest.approx([256 * (n + 1) / 48_000 for n in range(9)])


def test_the_settings_come_back_whole_and_options_win_over_them(tmp_path, monkeypatch):
    for settings in (Settings(), OTHER, Settings(form="reference")):
        assert settings_from(facts_of(settings)) == settings
    assert settings_from({"program": "haptic-cushion 0.1.0", "tap": "default"}) is None
    monkeypatch.chdir(tmp_path)
    again: Any = settings_from(facts_of(Settings(effects_file=Path("effects.xml"))))
    assert again.effects_file == tmp_path / "effects.xml"  # the whole path
    for wrong, words in (("partials_max", "partials_max.*--config"), ("form", "1000.* not known")):
        with pytest.raises(UsageError, match=words):
            settings_from({**facts_of(Settings()), wrong: 1_000})
    run = Run(tmp_path / "cap", OTHER)
    run.hear(range(50))
    run.recording.close()
    out = tmp_path / "out.wav"
    assert (call("replay", tmp_path / "cap", out).code, vibration(out).shape[1]) == (0, 2)
    assert call("replay", tmp_path / "cap", out, "--channels", "mono").code == 0
    assert vibration(out).shape[1] == 1
    (tmp_path / "c.toml").write_text('profile = "paper"\n')
    assert call("replay", tmp_path / "cap", out, "--config", tmp_path / "c.toml").code == 0
    assert vibration(out).shape[1] == 1


@pytest.mark.exhaustive
def test_a_recording_that_is_ended_holds_what_came_before_and_nothing_before_it_begins(tmp_path):
    RunRecording(tmp_path / "cap", Settings(), "default", "twin").close()
    assert list(tmp_path.iterdir()) == []
    run = Run(tmp_path / "cap", Settings())
    run.hear(range(40))
    run.recording.end("the settings were changed")
    run.hear(range(40, 60))
    assert "the settings were changed" in run.recording.problem
    run.recording.close()
    assert len(list(Capture(tmp_path / "cap").buffers("tap"))) == 40
    same_again(tmp_path / "cap", tmp_path / "out.wav")
    assert "not empty" in refused(call("capture", tmp_path / "cap", "--tap", "scene:demo"))


def test_of_several_sounds_the_mix_is_recorded_as_no_effect_has_changed_it(tmp_path, site):
    site("halver_package", HALVER, entry("halver_package:LIBRARY"))
    xml = tmp_path / "effects.xml"
    effects = [("halver", "halving", HALVER_UUID), ("haptic", "cushion", HAPTIC_CUSHION.uuid)]
    xml.write_text(effects_xml("halving", "cushion", effects=effects, applied=["halver", "haptic"]))
    settings = Settings(effects_file=xml)
    recording = RunRecording(tmp_path / "cap", settings, "app:a", "twin")
    recording.begin()
    feed = ApplicationsFeed()
    on_step, on_mix = recording.hooks(48_000, 2, of_mix=True)
    client = feed.client(48_000, 2)
    engine = Engine(client, 48_000, settings, clocks=STILL, on_step=on_step, on_mix=on_mix)
    feed.serve(engine)
    one, other = client.add("one"), client.add("other")
    sounds = [noise(480 * 256, 2, seed).astype(np.float32) for seed in (1, 2)]
    for number in range(480):
        part = slice(256 * number, 256 * (number + 1))
        feed.push(other, sounds[1][part], number * 256 / 48_000)
        feed.push(one, sounds[0][part], number * 256 / 48_000)
    recording.close()
    assert "Halver" in dump(engine.framework.mixer)
    tap = recorded(tmp_path / "cap", "tap")
    assert np.abs(tap[2_560:]).mean() > 1.2 * np.abs(sounds[0]).mean()  # both, and not halved
    assert same_again(tmp_path / "cap", tmp_path / "out.wav") > 100_000


def test_a_disk_that_is_full_ends_the_recording_and_not_the_run(tmp_path, monkeypatch):
    run = Run(tmp_path / "cap", Settings())
    run.hear(range(100))
    write_at = segment.write_at

    def full(fd: int, content: bytes | memoryview, position: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    while sum(1 for _ in Capture(tmp_path / "cap").buffers("effect")) < 100:
        pass
    monkeypatch.setattr(segment, "write_at", full)
    run.hear(range(100, 200))
    with pytest.raises(WriteError, match="the disk is full"):
        run.recording.close()
    monkeypatch.setattr(segment, "write_at", write_at)
    assert (run.engine.buffers, run.recording.warnings) == (200, [run.recording.problem])
    assert "the recording has ended" in run.recording.problem
    done = call("replay", tmp_path / "cap", tmp_path / "out.wav", "--json")
    assert done.code == 0
    assert overlap(tmp_path / "cap", tmp_path / "out.wav", done.stdout) > 10_000
