"""Golden digests: SHA-256 of what the commands write, to hold a redesign to the same bytes.

    python -m tests.golden.golden              compare with digests.json
    python -m tests.golden.golden --write      record digests.json again

Digests hold for one kind of machine, whose libraries round in their way. Where the entry `machine`,
a probe of these, differs, nothing can be compared.
"""

import argparse
import functools
import hashlib
import itertools
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import scipy.fft
import soundfile

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.transform import TRANSFORM_VERSION
from audioflinger_hook.transform.design import LiveDesign
from tests.support.commands import call
from tests.support.recordings import FOLDER as RECORDINGS
from tests.support.signals import FORMS

EXCERPT_S = 2.5
DIGESTS = Path(__file__).with_name("digests.json")
TWO_ACTUATORS = """
profile = "cinema"
gain_db = -3
actuator = [{ source = "left", channels = [0] }, { source = "right", channels = [2], OTHER }]
""".replace(
    "OTHER",
    'polarity = "inverted", gain_db = -2.5, delay_ms = 3, rig = "consumer", protection = "on", '
    'exposure_cap = "limit"',
)
CONFIGS = {
    "level": "gain_db = -7.5\n",
    "parameters": 'profile = "music"\n[transform]\nthreshold_hz = 0.1\npartials_max = 9\n',
    "follower": "[transform]\nloudness_db = 20\ndynamics = 0.4\n",
    "jnd": (
        '[transform]\nmapping = "jnd"\namplitude_mapping = "energy"\nspeech_suppression_db = 12\n'
    ),
    "damped": 'damping = "auto"\nrig = "consumer"\n',
    "protected": 'protection = "on"\nexposure_cap = "action"\n',
    "one actuator": '[[actuator]]\nchannels = [1]\ngain_db = -6\ndamping = "auto"\n',
    "two actuators": TWO_ACTUATORS,
}

Case = tuple[str, Callable[[Path], bytes]]


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def machine() -> str:
    """Return a digest of how this machine rounds logarithms, cosines, spectra and matrices."""
    x = np.linspace(0.1, 9.7, 5_000)
    parts = [np.log(x), np.cos(x), np.exp(-x), np.tanh(x), np.abs(scipy.fft.rfft(x))]
    square = np.cos(np.outer(x[:24], x[:24] + 3.0))
    parts += [square @ square, np.linalg.solve(square + 9.0 * np.eye(24), x[:24])]
    parts += [np.abs(np.roots(x[:13])), np.linalg.svd(square, compute_uv=False)]
    return digest(b"".join(part.tobytes() for part in parts))


def run(*arguments: object) -> str:
    """Run a command in this process and return what it printed; raise where it fails."""
    done = call(*arguments)
    assert done.code == 0, (arguments, done)
    return done.stdout


def excerpt(recording: Path, folder: Path) -> Path:
    with soundfile.SoundFile(recording) as file:
        sound = file.read(int(EXCERPT_S * file.samplerate), dtype="float32", always_2d=True)
        path = folder / f"{recording.stem}.wav"
        soundfile.write(path, sound, file.samplerate, subtype="FLOAT")
    return path


def rendered(recording: Path, *options: str, config: str = "") -> Callable[[Path], bytes]:
    """Return a case: the vibration of a recording, and its acceleration where that is asked for."""

    def render(folder: Path) -> bytes:
        out, rig, settings = folder / "out.wav", folder / "rig.wav", folder / "config.toml"
        chosen: list[object] = list(options)
        if config:
            settings.write_text(config)
            chosen += ["--config", settings]
        if config or "--rig" in options:
            chosen += ["--acceleration", rig]
        run("render", excerpt(recording, folder), out, *chosen)
        return out.read_bytes() + (rig.read_bytes() if rig.exists() else b"")

    return render


def kernel_settings(samplerate: int, profile: str, _folder: Path) -> bytes:
    """Return all numbers and tables that the compiled kernel is given."""
    found = sorted(LiveDesign.of(parameters_of(profile), samplerate).settings().items())
    return b"".join(
        name.encode() + np.asarray(value, np.float64).tobytes() for name, value in found
    )


def demo(folder: Path) -> bytes:
    run("demo", "--fast", "--out", folder / "demo")
    names = ("scene.wav", "vibration.wav", "acceleration.wav")
    return b"".join((folder / "demo" / name).read_bytes() for name in names)


def replayed(folder: Path) -> bytes:
    run("capture", folder / "capture", "--tap", "scene:demo")
    for form in FORMS:
        run("replay", folder / "capture", folder / f"{form}.wav", "--transform", form)
    return b"".join((folder / f"{form}.wav").read_bytes() for form in FORMS)


def inspected(recording: Path) -> Callable[[Path], bytes]:
    return lambda folder: run("inspect", excerpt(recording, folder), "--json").encode()


def cases() -> Iterator[Case]:
    """Yield every case: its name, and what gives its bytes in an empty folder."""
    files = sorted(p for p in RECORDINGS.rglob("*") if p.suffix in {".wav", ".oga"})
    for file in files:
        name = f"{file.parent.name}/{file.stem}"
        for form, profile in itertools.product(FORMS, PROFILES):
            for channels in ("mono", "each"):
                options = ("--transform", form, "--profile", profile, "--channels", channels)
                yield f"render/{name}/{form}/{profile}/{channels}", rendered(file, *options)
        yield f"inspect/{name}", inspected(file)
    for file, rig in itertools.product(files[::9], ("paper", "consumer")):
        yield f"rig/{file.stem}/{rig}", rendered(file, "--rig", rig, "--damping", "auto")
    for file, (config, text) in itertools.product(files[1::12], CONFIGS.items()):
        yield f"config/{file.stem}/{config}", rendered(file, config=text)
    for rate, profile in itertools.product((8_000, 44_100, 48_000, 96_000), PROFILES):
        yield f"kernel/{rate}/{profile}", functools.partial(kernel_settings, rate, profile)
    yield "demo", demo
    yield "replay", replayed


def quick(name: str) -> bool:
    """Return whether a case, or what all depend on, belongs to the quick subset."""
    if name in ("machine", "transform_version"):
        return True
    chosen = ("bell/live/cinema/each", "bell/reference/paper/mono", "Front_Left/live/game/mono")
    return name.endswith(chosen) or name.startswith(
        ("kernel/48000", "config/Front_Left", "rig/Front_Center")
    )


def made(name: str) -> tuple[str, str]:
    """Return the name of a case and its digest, or why it has none."""
    case = dict(cases())[name]
    with tempfile.TemporaryDirectory() as folder:
        try:
            return name, digest(case(Path(folder)))
        except Exception as error:
            return name, f"failed: {type(error).__name__}: {error}"


def digests(only: Callable[[str], bool] = lambda _name: True) -> dict[str, str]:
    names = [name for name, _ in cases() if only(name)]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = dict(sorted(pool.map(made, names, chunksize=4)))
    return {"machine": machine(), "transform_version": str(TRANSFORM_VERSION), **found}


def main() -> int:
    """Write or check the digests; return 1 where they differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    found, golden = digests(), json.loads(DIGESTS.read_text())
    if options.write:
        if golden.get("transform_version") == found["transform_version"] and any(
            name.startswith("render/") and digest != found.get(name)
            for name, digest in golden.items()
        ):
            # else a catalogue would take results of both for the same
            print("renderings have changed: raise TRANSFORM_VERSION in audioflinger_hook/transform")
            return 1
        DIGESTS.write_text(json.dumps(found, indent=0, sort_keys=True) + "\n")
        print(f"{len(found)} digests written")
        return 0
    wrong = [
        f"{name}: {found.get(name, 'missing')} instead of {golden.get(name, 'nothing')}"
        for name in sorted(golden.keys() | found.keys())
        if golden.get(name) != found.get(name)
    ]
    print(*wrong, f"{len(found) - len(wrong)} of {len(golden)} are the same", sep="\n")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
