"""The streams that browsers really make, as tools/browser_streams.py recorded them."""

import json
from pathlib import Path

from device.server.snapshot import Stream
from tests.support.snapshots import stream

PLAYING, RECORDING = "sink-inputs", "source-outputs"

_RECORDED = Path(__file__).parents[1] / "device" / "server" / "browser_streams.json"
SCENES = json.loads(_RECORDED.read_text())

# By browser, server and scene: which of the playing streams, counted from 0, is felt. None is felt
# in the scenes that are not named: the only stream is a call, or cannot be told from one.
_ALONE = {"film": 0, "web audio": 0}
_FIRST = ("film, then call", "web audio, then call", "film, then call without echo cancellation")
_FIREFOX = {**_ALONE, **dict.fromkeys(_FIRST, 0), "call, then film": 1}
FELT = {
    ("chromium", "pipewire"): {**_ALONE, "film, then call without echo cancellation": 0},
    ("chromium", "pulse"): _ALONE,
    ("firefox-esr", "pipewire"): {**_FIREFOX, "film and call in one tab": 0},
    ("firefox-esr", "pulse"): _FIREFOX,
}


def scenes(*servers: str) -> list[tuple[str, str, str]]:
    """Browser, server and name of each scene on these servers."""
    return [
        (*pair, scene) for pair in FELT if pair[1] in servers for scene in SCENES[pair[0]][pair[1]]
    ]


def felt(browser: str, server: str, scene: str) -> list[int]:
    """Which of the playing streams of a scene are felt."""
    return [at for name, at in FELT[browser, server].items() if name == scene]


def properties(browser: str, server: str, scene: str, what: str) -> list[dict[str, str]]:
    """What a browser (chromium, firefox-esr) tells a server (pulse, pipewire) in a scene."""
    found: list[dict[str, str]] = SCENES[browser][server][scene][what]
    return found


def made(browser: str, server: str, scene: str, what: str) -> tuple[Stream, ...]:
    """The same as streams of a snapshot."""
    return tuple(
        stream(
            index,
            1,
            "desk",
            application=known["application.name"],
            binary=known["application.process.binary"],
            role=known.get("media.role", ""),
            media=known["media.name"],
            process_id=int(known["application.process.id"]),
            properties=known,
        )
        for index, known in enumerate(properties(browser, server, scene, what))
    )
