"""Scenes: several sounds made by code, each on its own track."""

from audioflinger_hook.scenes.demo import demo_scene
from audioflinger_hook.scenes.tracks import Scene, SceneTrack

__all__ = ["Scene", "SceneTrack", "demo_scene"]
