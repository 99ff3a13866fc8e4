"""Sliders that are dragged while a steady sound plays: no gap, no click, no new process."""

import math
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from tests.browser.conftest import CONFIG, says
from tests.servers.daemons import tone
from tests.servers.listening import RATE_HZ, more, playing, recording, wait_for
from tests.servers.test_live_changes import is_steady, loudest_above
from tests.servers.witness import Verdict, tears, witness_tone

pytestmark = [pytest.mark.browser, pytest.mark.calm]

FOR_S = 20.0
MOVES_HZ = 20.0  # of the pointer; a hand's movements are not faster
SLIDERS = {  # shares of their lengths between which they are dragged
    "gain_db": (0.85, 0.98),
    "offset_ms": (0.0, 0.1),
    "transform-loudness_db": (0.5, 0.95),
    "transform-merge_ratio": (0.1, 0.9),
}


def drag_about(page, key: str, ends: tuple[float, float], seconds: float) -> None:
    """Hold the thumb of a slider and move it to and fro, twice a second."""
    slider = page.locator(f"#control-{key}")
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    page.mouse.move(box["x"] + ends[0] * box["width"], box["y"] + box["height"] / 2)
    page.mouse.down()
    for number in range(int(seconds * MOVES_HZ)):
        share = 0.5 - 0.5 * math.cos(4.0 * math.pi * number / MOVES_HZ)
        x = box["x"] + (ends[0] + share * (ends[1] - ends[0])) * box["width"]
        page.mouse.move(x, box["y"] + box["height"] / 2)
        page.wait_for_timeout(1e3 / MOVES_HZ)
    page.mouse.up()


def test_dragged_sliders_are_felt_without_gaps_clicks_or_lost_cycles(room, page):
    with (
        TemporaryDirectory(prefix="cushion-") as folder,
        witness_tone(Path(folder)) as witness,
        playing(room.server, "desktop", tone(110.0, 240.0)),
        recording(room.server, "haptic.monitor", Path(folder) / "felt", stays=True) as felt,
        recording(room.server, "desktop.monitor", Path(folder) / "sound", stays=True) as sound,
    ):
        wait_for(lambda: len(felt()) > 0 and abs(felt()[-480:]).max() > 0.01, "vibration")
        process = room.daemon.wait(lambda status: status.engine_pid, "the engine").engine_pid
        more(felt, 3.0)
        steady_db = loudest_above(felt()[-2 * RATE_HZ :])
        verdict, shown = Verdict("dragged sliders", needed=1), False
        while not shown:
            begins = [len(one()) for one in (felt, sound, witness)]
            for key, ends in SLIDERS.items():
                drag_about(page, key, ends, FOR_S / len(SLIDERS))
            more(felt, 1.0)
            parts = [one()[at:] for one, at in zip((felt, sound, witness), begins, strict=True)]
            found = is_steady(parts[0], steady_db), tears(parts[1]) == 0
            shown = verdict.add(found, good=all(found), witness_torn=tears(parts[2]) > 0)
        assert room.daemon.status().engine_pid == process
    says(page, "#unsaved", "Not saved")
    room.config.write_text(CONFIG)
