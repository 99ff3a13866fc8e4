"""Sound through a pipeline, and the vibration that its transform alone makes of that sound."""

import itertools

import numpy as np

from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.transform import HapticTransform

RATE = 48_000


def music(frames, channels=2, seed=0, level=0.3):
    """Noise and tones that come and go, and samples that no transform can use."""
    random, seconds = np.random.default_rng(seed), np.arange(frames)[:, None] / RATE
    tones = np.sin(2 * np.pi * 330.0 * seconds) * (np.sin(2 * np.pi * 5.0 * seconds) > 0.0)
    mixed = level * (random.standard_normal((frames, channels)) + 2.0 * tones)
    mixed[frames // 2, 0] = np.nan
    return mixed.astype(np.float32)


def transformed(frames, samplerate=RATE, **options):
    """The vibration by the transform alone, in one block, with what it owes at the end."""
    transform = HapticTransform(samplerate, frames.shape[1], **options)
    whole = np.concatenate((transform.process(frames), transform.finish()))
    assert len(whole) == len(frames) + transform.latency_frames
    return whole.astype(np.float32)


def steps_of(client, framework):
    """Everything that moves through a chain: (sound, vibration)."""
    chain = Pipeline(client, framework, ())
    steps = list(itertools.takewhile(lambda step: step is not None, iter(chain.step, 0)))
    return tuple(
        np.concatenate([getattr(step, name) for step in steps]) for name in ("audio", "vibration")
    )
