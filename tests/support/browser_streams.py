"""The streams that browsers really make, as tools/browser_streams.py recorded them."""

import json
from pathlib import Path

from device.server.snapshot import Stream
from tests.support.snapshots import stream

PLAYING, RECORDING = "sink-inputs", "source-outputs"

_RECORDED = Path(__file__).parents[1] / "device" / "server" / "browser_streams.json"
SCENES = json.loads(_RECORDED.read_text())


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
