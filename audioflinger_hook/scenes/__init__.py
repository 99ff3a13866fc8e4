"""Scenes: several synthesised sounds, each on its own track."""

from audioflinger_hook.scenes.demo import Scene, SceneTrack, demo_scene

__all__ = ["Scene", "SceneTrack", "demo_scene"]
