"""The plugin in the programs that people use: FFmpeg, LADSPA and LV2 hosts, PipeWire."""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import soundfile

from audioflinger_hook.core.compiled_core import Core
from tests.plugin import hosting
from tests.servers.daemons import ROOT, felt_now, tone
from tests.servers.listening import need, playing, recording, wait_for
from tests.support.commands import call
from tests.support.commands import vibration as samples
from tests.support.data import text

pytestmark = pytest.mark.servers

RATE_HZ = 48_000


def needs(*programs: str) -> None:
    need([program for program in programs if shutil.which(program) is None])


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "LADSPA_PATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("LV2_PATH", str(tmp_path / ".lv2"))
    cushion("plugin", "install")
    return tmp_path


def cushion(*arguments: str) -> str:
    """What a command prints; it must succeed."""
    done = call(*arguments)
    assert done.code == 0, done
    return done.stdout.strip()


def ran(*command: str | Path) -> str:
    """What another program prints, both streams; it must succeed."""
    done = subprocess.run(
        list(map(str, command)), capture_output=True, text=True, stdin=subprocess.DEVNULL
    )
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def sound(tmp_path):
    """A stereo file of 32-bit floats: bursts with silence before, between and after them."""
    at_s = np.arange(3 * RATE_HZ) / RATE_HZ
    burst = 0.4 * np.sin(2 * np.pi * 330.0 * at_s) * ((at_s % 1.0) > 0.6)
    path = tmp_path / "sound.wav"
    soundfile.write(path, np.stack([burst, 0.5 * burst], 1), RATE_HZ, subtype="FLOAT")
    return path


@pytest.mark.parametrize("rate_hz", hosting.RATES_HZ)
def test_ffmpeg_gives_the_bytes_of_ctypes_at_every_rate_in_any_blocks(home, monkeypatch, rate_hz):
    needs("ffmpeg")
    rng, plugin_file = np.random.default_rng(rate_hz), cushion("plugin", "path")
    raw = "f32le", "-ar", str(rate_hz), "-ac"
    profile = hosting.PROFILES[rng.integers(len(hosting.PROFILES))]
    variants = {
        f"haptic_cushion_{profile}": hosting.write_design(home / ".local/share", profile, rate_hz)
    }
    for kind in hosting.DESIGNS:
        (home / kind).write_bytes(hosting.any_design(kind, rate_hz, 8))
        variants[f"haptic_cushion_daemon:{kind}"] = home / kind
    for variant, design in variants.items():
        core, label = Core(design.read_bytes()), variant.partition(":")[0]
        sound = hosting.any_sound(rng, rate_hz, 2 * rate_hz, core.info.inputs)
        sound.tofile(home / "sound")
        wanted = core.process(sound)
        monkeypatch.setenv("HAPTIC_CUSHION_DESIGN", str(design))
        for blocks in ("", *(f"asetnsamples=n={2 ** rng.uniform(0, 16):.0f}:p=0," for _ in "ab")):
            ran(
                *("ffmpeg", "-v", "error", "-y", "-f", *raw, str(core.info.inputs)),
                *("-i", home / "sound", "-af", f"{blocks}ladspa=file={plugin_file}:plugin={label}"),
                *("-f", "f32le", "-c:a", "pcm_f32le", home / "out"),
            )
            got = np.fromfile(home / "out", np.float32).reshape(len(sound), -1)
            assert got[:, : core.outputs].tobytes() == wanted.tobytes(), (variant, blocks)


def test_with_a_damaged_design_ffmpeg_goes_on_and_says_what_is_wrong(home, sound):
    needs("ffmpeg")
    path = hosting.write_design(home / ".local/share", "game", RATE_HZ)
    effect = f"ladspa=file={cushion('plugin', 'path')}:plugin=haptic_cushion_game"
    for reason, design in hosting.damaged(path.read_bytes()).items():
        path.write_bytes(design)
        out = home / "vibration.wav"
        assert reason in ran("ffmpeg", "-v", "error", "-y", "-i", sound, "-af", effect, out)
        assert len(samples(out)) == len(samples(sound))
        assert not samples(out).any()


def test_a_film_gets_the_vibration_as_another_track(home, sound):
    needs("ffmpeg", "ffprobe")
    film, path = home / "film.mkv", cushion("plugin", "path")
    picture = "testsrc=size=64x64:rate=5:duration=3"
    ran("ffmpeg", "-v", "error", "-f", "lavfi", "-i", picture, "-i", sound, "-c:a", "flac", film)
    ran(
        *("ffmpeg", "-v", "error", "-i", film, "-filter_complex"),
        f"[0:a:0]ladspa=file={path}:plugin=haptic_cushion_cinema[vibration]",
        *("-map", "0", "-map", "[vibration]", "-c", "copy", "-c:a:1", "flac"),
        *("-metadata:s:a:1", "title=Vibration", home / "felt.mkv"),
    )
    shown = ran("ffprobe", "-v", "error", "-show_entries", "stream=codec_type", home / "felt.mkv")
    assert (shown.count("codec_type=audio"), shown.count("codec_type=video")) == (2, 1)


def test_gstreamer_finds_the_plugin_and_gives_the_bytes_of_the_transform(home, sound, monkeypatch):
    needs("gst-inspect-1.0", "gst-launch-1.0")
    monkeypatch.setenv("LADSPA_PATH", str(Path(cushion("plugin", "path")).parent))
    monkeypatch.setenv("GST_REGISTRY", str(home / "registry"))
    listed = ran("gst-inspect-1.0", "ladspa")
    element = next(word.rstrip(":") for word in listed.split() if word.endswith("-music:"))
    ran(
        *("gst-launch-1.0", "-q", "filesrc", f"location={sound}", "!", "wavparse", "!"),
        *("audioconvert", "!", element, "!", "audio/x-raw,format=F32LE", "!"),
        *("filesink", f"location={home / 'vibration.raw'}"),
    )
    got = np.fromfile(home / "vibration.raw", np.float32).reshape(-1, 2)[:, 0]
    assert np.array_equal(got, hosting.vibration(samples(sound), "music", RATE_HZ)[: len(got)])
    assert len(got) > RATE_HZ


def test_alsa_plays_through_the_plugin(home, sound, monkeypatch):
    needs("aplay")
    folder = Path(cushion("plugin", "path")).parent
    rc = text("asoundrc").format(folder=folder, written=home / "vibration.raw")
    (home / ".asoundrc").write_text(rc)
    soundfile.write(home / "short.wav", samples(sound), RATE_HZ, subtype="PCM_16")
    ran("aplay", "-q", "-D", "vibration", home / "short.wav")
    got = np.fromfile(home / "vibration.raw", np.float32).reshape(-1, 2)[:, 0]
    wanted = hosting.vibration(samples(home / "short.wav"), "cinema", RATE_HZ)
    length = min(len(got), len(wanted))
    assert length > RATE_HZ
    assert np.abs(got[:length] - wanted[:length]).max() < 1e-6


def test_a_ladspa_host_lists_the_variants_and_gives_the_vibration(home, sound):
    needs("analyseplugin", "applyplugin")
    path = cushion("plugin", "path")
    shown = ran("analyseplugin", path, "haptic_cushion_cinema")
    for words in ("Gain (dB)", "Delay (ms)", "Bypass", "latency"):
        assert words in shown
    # this host reads and writes 16 bits
    soundfile.write(home / "short.wav", samples(sound), RATE_HZ, subtype="PCM_16")
    out = home / "vibration.wav"
    ran("applyplugin", home / "short.wav", out, path, "haptic_cushion_paper", "0", "0", "0")
    wanted = hosting.vibration(samples(home / "short.wav"), "paper", RATE_HZ)
    got = samples(out)[:, 0]
    assert np.abs(got[: len(wanted)] - wanted[: len(got)]).max() < 2.0 / 32_768


def test_the_lv2_bundle_is_valid_and_gives_the_bytes_of_the_transform(home, sound):
    needs("lv2ls", "lv2info", "lv2apply", "lv2_validate")
    variants = sorted(f"urn:haptic-cushion:{name}" for name in (*hosting.PROFILES, "mono"))
    assert ran("lv2ls").split() == variants
    shown = ran("lv2info", "urn:haptic-cushion:cinema")
    assert "Has latency:       yes" in shown
    assert "error" not in shown.lower()
    ran("lv2_validate", *sorted((home / ".lv2/haptic-cushion.lv2").glob("*.ttl")))
    out = home / "vibration.wav"
    ran("lv2apply", "-i", sound, "-o", out, "urn:haptic-cushion:music")
    wanted = hosting.vibration(samples(sound), "music", RATE_HZ)
    assert np.array_equal(samples(out)[: len(wanted), 0], wanted)


def test_the_drop_in_plays_to_its_device_and_remove_leaves_nothing(pipewire, monkeypatch, tmp_path):
    environment = pipewire.environment | {"PYTHONPATH": str(ROOT)}
    monkeypatch.setenv("HOME", environment["HOME"])
    monkeypatch.setenv("XDG_CONFIG_HOME", environment["XDG_CONFIG_HOME"])
    said = cushion("plugin", "install", "--device", "haptic")
    assert "pipewire -c filter-chain.conf" in said
    with (
        subprocess.Popen(["pipewire", "-c", "filter-chain.conf"], env=environment) as host,
        recording(pipewire, "haptic.monitor", tmp_path / "felt") as felt,
        playing(pipewire, "desktop", tone(60.0, 20.0)),
    ):
        try:
            wait_for(lambda: felt_now(felt), "vibration")
        finally:
            host.terminate()
    assert "removed" in cushion("plugin", "remove")
    left = list(Path(environment["HOME"]).rglob("*haptic*"))
    left += list(Path(environment["XDG_CONFIG_HOME"]).rglob("*haptic*"))
    assert left == []


@pytest.fixture(scope="module")
def host(tmp_path_factory):
    """A program that runs the plugin between two marks, and a trap for allocations."""
    folder = tmp_path_factory.mktemp("host")
    hosting.write_design(folder, "cinema", RATE_HZ)
    source, include = ROOT / "tests/support", hosting.plugin().parents[1] / "plugin/native"
    host = "-I", include, source / "ladspa_host.c", "-o", folder / "host", "-ldl", "-rdynamic"
    trap = "-shared", "-fPIC", source / "allocation_trap.c", "-o", folder / "trap.so"
    for arguments in (host, trap):
        subprocess.run(["gcc", *arguments], check=True, capture_output=True)
    return folder


def test_run_allocates_nothing(host):
    done = subprocess.run(
        [host / "host", hosting.plugin()],
        env=os.environ | {"LD_PRELOAD": str(host / "trap.so"), "XDG_DATA_HOME": str(host)},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_run_makes_no_system_call(host):
    traced = host / "trace"
    needs("strace")
    subprocess.run(
        ["strace", "-f", "-o", str(traced), host / "host", hosting.plugin()],
        env=os.environ | {"XDG_DATA_HOME": str(host)},
        check=True,
        capture_output=True,
    )
    calls = [line.split(None, 1)[1].partition("(")[0] for line in traced.read_text().splitlines()]
    first, last = (i for i, call in enumerate(calls) if call == "getppid")
    assert calls[first + 1 : last] == []
