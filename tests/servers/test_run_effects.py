"""An effect of another package in `cushion run`: what it does wrong costs no vibration for good."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.effect.test_registry import entry
from tests.pipeline.test_framework_effects import OTHER, OTHERS, OURS, effects_xml
from tests.servers.daemons import ROOT, felt_now, running, tone
from tests.servers.listening import playing, recording, wait_for
from tools.sound_server import SoundServer


@pytest.mark.parametrize(
    ("misbehave", "reason"),
    [
        ("raise KeyError('lost')", "raised KeyError: 'lost' in process (other_package.py, line "),
        ("import time; time.sleep(0.6)", "kept the audio thread for over 0.4 s in process"),
    ],
)
def test_an_effect_that_fails_or_waits_is_named_on_the_terminal_and_vibration_goes_on(
    server: SoundServer,
    tmp_path: Path,
    site: Callable[..., None],
    misbehave: str,
    reason: str,
) -> None:
    site("other_package", OTHER.replace("MISBEHAVE", misbehave), entry("other_package:LIBRARY"))
    applied = effects_xml("cushion", "other", effects=[OURS, OTHERS], applied=["other", "ours"])
    (tmp_path / "audio_effects.xml").write_text(applied)
    config = tmp_path / "config.toml"
    config.write_text('effects_file = "audio_effects.xml"\n')
    path = {"PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT)))}
    with (
        playing(server, "desktop", tone(300.0, 60.0)),
        running(server, "--config", str(config), ready=False, variables=path) as daemon,
        recording(server, "haptic.monitor", tmp_path / "felt") as felt,
    ):
        named = f"effect bypassed: session 0, Other: {reason}"
        wait_for(lambda: named in daemon.stderr, named, 15.0)
        wait_for(lambda: felt_now(felt), "vibration", 15.0)
        daemon.wait_ready()
