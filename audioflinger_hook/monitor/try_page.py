"""The page "Try it": static files that turn sound into vibration in a browser, with the same core.

`cushion monitor` serves them at /try/. `python -m tools.try_page` writes them to a folder, which
any web server can serve.
"""

import hashlib
import io
import json
from collections.abc import Callable
from functools import cache, partial
from importlib.resources import files
from mimetypes import MimeTypes

import numpy as np
import soundfile

from audioflinger_hook import __version__
from audioflinger_hook.config.profiles import parameters_of
from audioflinger_hook.core.design import core_design
from audioflinger_hook.scenes.demo import DEMO_TRACKS, SAMPLERATE, demo_sound
from audioflinger_hook.transform.design import LiveDesign

CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; connect-src 'self'; "
    "style-src 'self'; worker-src 'self'; manifest-src 'self'; media-src blob:; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'"
)
RATES = (44_100, 48_000)
PROFILES = ("cinema", "game", "music", "speech")
SCENES = ("engine", "explosion", "chord")
SCENE_CODE = ("demo.py", "sounds.py")

OF_THE_LIVE_PAGE = (
    *("drawing.js", "elements.js", "mapping.js", "meters.js", "panels.js", "theme.js"),
    *("waterfall.js", "style.css", "icon.svg"),
)
OWN = (
    *("core.js", "output.js", "player.js", "render.js", "sound.js", "sources.js", "try.js"),
    *("vibration.js", "wav.js", "worker.js", "try.css", "try.webmanifest"),
    "core.wasm",
)
OFFLINE = "offline.js"  # keeps the page in the browser


def page_files() -> dict[str, Callable[[], bytes]]:
    """Return functions that give the content of each file, by the file's name.

    Designs and scenes are computed at the first call, in up to 2 s. Any thread may call them.
    """
    made: dict[str, Callable[[], bytes]] = {"index.html": _index, OFFLINE: _offline}
    made |= {name: partial(_static, name) for name in OF_THE_LIVE_PAGE}
    made |= {name: partial(_static, f"try/{name}") for name in OWN}
    for profile in PROFILES:
        made |= {f"{profile}-{rate}.design": partial(_design, profile, rate) for rate in RATES}
    return made | {f"{name}.wav": partial(_scene, name) for name in SCENES}


def content_type(name: str) -> str:
    """Return the media type of a file of the page."""
    return MimeTypes().guess_type(name)[0] or "application/octet-stream"


def first_files() -> list[str]:
    """Return the names of the files that the page needs to start with the first profile."""
    designs = [f"{PROFILES[0]}-{rate}.design" for rate in RATES]
    return ["index.html", *OF_THE_LIVE_PAGE, *OWN, *designs]


@cache
def _static(name: str) -> bytes:
    return files("audioflinger_hook.monitor").joinpath("static", *name.split("/")).read_bytes()


def _index() -> bytes:
    return _static("try/index.html").replace(b'"CSP"', f'"{CONTENT_SECURITY_POLICY}"'.encode())


@cache
def _offline() -> bytes:
    contents = page_files()
    digest = hashlib.sha256(__version__.encode() + _static(f"try/{OFFLINE}"))
    for name, content in contents.items():
        digest.update(b"" if name.endswith((OFFLINE, ".wav")) else content())
    code = files("audioflinger_hook.scenes")  # the scenes themselves take 1 s
    digest.update(b"".join(code.joinpath(name).read_bytes() for name in SCENE_CODE))
    lists = {
        "FILES": ["./", *first_files()],
        "MORE": [name for name in contents if name not in (*first_files(), OFFLINE)],
        "VERSION": digest.hexdigest()[:16],
    }
    head = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in lists.items())
    return head.encode() + _static(f"try/{OFFLINE}")


@cache
def _design(profile: str, samplerate: int) -> bytes:
    """Return a profile's design for one channel; core.js changes the number of channels."""
    design = LiveDesign.of(parameters_of(profile), samplerate)
    return core_design(samplerate, 1, transform=design.records())


@cache
def _scene(name: str) -> bytes:
    """Return a sound of the demo scene as WAV of 16 bits."""
    (number,) = [number for number, track in enumerate(DEMO_TRACKS) if track.name == name]
    sound = demo_sound(number, SAMPLERATE)
    written = io.BytesIO()
    soundfile.write(written, np.clip(sound, -1.0, 1.0), SAMPLERATE, "PCM_16", format="WAV")
    return written.getvalue()
