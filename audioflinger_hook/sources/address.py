"""Addresses of sound sources, as the option `--tap` accepts them."""

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

# A text with one of these endings is a path, not the name of a sink.
SOUND_SUFFIXES = (".wav", ".flac", ".ogg", ".mp3", ".aiff", ".aif", ".opus")


@dataclass(frozen=True)
class TapAddress:
    """Address of a source of sound. kind: one of `KINDS`. name: name or path; "" for `default`."""

    kind: Kind
    name: str = ""

    def __str__(self) -> str:
        return f"{self.kind}:{self.name}" if self.name else self.kind


def parse_tap(text: str) -> TapAddress:
    """Parse an address. text: of the form `GRAMMAR`; without a colon, it is the name of a sink.

    UsageError: the kind is unknown, a name is missing or of `default`, or a path has no "file:".
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
    """Open a client, with one track for each sound of a scene, or one track for other sources.

    address: of the sound. UsageError, NotFoundError: as for `open_tap`.
    """
    return SceneClient(_scene(address)) if address.kind == "scene" else TapClient(open_tap(address))


def open_tap(address: TapAddress) -> Tap:
    """Open a tap for a file, a capture or a scene.

    address: address of the sound.
    UsageError: the source cannot be used. NotFoundError: the source needs a sound server.
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
