"""The grammar of `--tap`: where the sound comes from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from audioflinger_hook.scenes import Scene, demo_scene
from audioflinger_hook.sources.file import CaptureTap, FileTap, FramesTap
from audioflinger_hook.sources.scene import CYCLE_FRAMES, SceneClient, mixdown
from audioflinger_hook.sources.tap import Client, Tap
from audioflinger_hook.sources.tap_client import TapClient
from device.errors import NotFoundError, UsageError

Kind = Literal["default", "sink", "app", "file", "capture", "scene"]
KINDS: tuple[Kind, ...] = get_args(Kind)

GRAMMAR = (
    "default, sink:NAME, app:NAME, file:PATH, capture:DIR, scene:demo, or the name of a sink alone"
)
SCENES = ("demo",)

SOUND_SUFFIXES = (".wav", ".flac", ".ogg", ".mp3", ".aiff", ".aif", ".opus")
"""A word that ends so is taken for a path, not for the name of a sink."""


@dataclass(frozen=True)
class TapAddress:
    """A source of sound. kind: one of `KINDS`. name: name, path or folder; empty for `default`."""

    kind: Kind
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind}:{self.name}" if self.name else self.kind


def parse_tap(text: str) -> TapAddress:
    """Return the address that a text stands for; a word without a colon is the name of a sink.

    text: of the user. UsageError: the kind is unknown, a name is missing, `default` has a name, or
    a path has no "file:".
    """
    if text == "default":
        return TapAddress("default")
    kind, colon, name = text.partition(":")
    if not colon:
        kind, name = "sink", text
        if "/" in text or Path(text).suffix.lower() in SOUND_SUFFIXES:
            raise UsageError(
                f"tap {text!r} is not the name of a sink; did you mean file:{text}? allowed: "
                f"{GRAMMAR}"
            )
    for known in KINDS:
        if kind == known != "default" and name.strip():
            return TapAddress(known, name)
    if kind == "default":
        what = "has a name, but default has none"
    elif kind in KINDS:
        what = "has an empty name"
    else:
        what = f"has the unknown kind {kind!r} (for a sink of that name write sink:{text})"
    raise UsageError(f"tap {text!r} {what}; allowed: {GRAMMAR}")


def open_client(address: TapAddress) -> Client:
    """Return a client of the mixer: one track per sound for a scene, else one track.

    address: the source. Raises as `open_tap`.
    """
    return SceneClient(_scene(address)) if address.kind == "scene" else TapClient(open_tap(address))


def open_tap(address: TapAddress) -> Tap:
    """Return an open tap.

    address: a file, a capture or a scene. UsageError: it cannot be used. NotFoundError: the source
    needs a sound server.
    """
    if address.kind == "file":
        return FileTap(Path(address.name))
    if address.kind == "capture":
        return CaptureTap(Path(address.name))
    if address.kind == "scene":
        scene = _scene(address)
        return FramesTap(mixdown(scene), scene.samplerate, CYCLE_FRAMES)
    raise NotFoundError(
        f"tap {str(address)!r}: this command cannot capture live sound; "
        "use file:PATH, capture:DIR or scene:demo"
    )


def _scene(address: TapAddress) -> Scene:
    if address.name not in SCENES:
        allowed = ", ".join(f"scene:{name}" for name in SCENES)
        raise UsageError(f"tap {str(address)!r}: unknown scene; allowed: {allowed}")
    return demo_scene()
