"""`cushion dump`: prints the mixer's tracks and effects, like `dumpsys media.audio_flinger`."""

import argparse
import time
from contextlib import closing

from audioflinger_hook.cli.terminal import warn
from audioflinger_hook.config import file as config
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.mixer import dump
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.pipeline.step import Pipeline
from audioflinger_hook.sources import open_client, parse_tap
from device.errors import UsageError


def run(options: argparse.Namespace) -> int:
    """Process a sound up to the time of `--at`, as fast as possible; print the mixer's state."""
    settings = config.load(options.config).settings if options.config else Settings()
    client = open_client(parse_tap(options.tap))
    cycle_times_s = []
    frames = 0
    with closing(client):
        framework = Framework(client.samplerate, client.channels, settings, clock=time.thread_time)
        chain = Pipeline(client, framework, ())
        until_s = 1.0 if options.at is None else options.at  # a shorter sound is played whole
        while frames < until_s * framework.samplerate:
            began_s = time.thread_time()
            step = chain.step(frames / framework.samplerate)
            if step is None and options.at is None:
                break
            if step is None:
                late = f"time {options.at:g} s is after the end of the sound"
                raise UsageError(f"{late}; allowed: 0 to {frames / framework.samplerate:.3f} s")
            cycle_times_s.append(time.thread_time() - began_s)
            frames += len(step.audio)
    warn(*framework.warnings)
    print(dump(framework.mixer, cycle_times_s), end="")
    return 0
