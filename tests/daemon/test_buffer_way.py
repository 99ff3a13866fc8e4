import gc
import re
import sys
from pathlib import Path
from types import FrameType

import numpy as np

from audioflinger_hook.daemon.capture_queue import CaptureQueue
from device.drive import ChannelMap
from device.drive.channel_router import ChannelRouter
from tests.daemon.test_capture_queue import BLOCK, BLOCK_S, Live, music

ROOT = Path(__file__).resolve().parents[2]
WAY = (ROOT / "docs/architecture.md").read_text().partition("\n## One buffer's way\n")[2]
WAY = WAY.partition("\nWhat happens on the way:")[0]

CARRIERS_MAX = 16


def files_of_a_cycle() -> set[str]:
    live = Live(CaptureQueue())
    fill = ChannelRouter(()).connect(live.engine.fill, ChannelMap.repeated(1, 2), BLOCK)
    sound, out = music(2.0), np.zeros((BLOCK, 2), np.float32)
    files: set[str] = set()

    def called(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            files.add(frame.f_code.co_filename)

    def play(first: int, last: int) -> None:
        for block in range(first, last):
            now_s = (block + 1) * BLOCK_S
            live.feed.push(sound[block * BLOCK : (block + 1) * BLOCK], now_s)
            fill(out, now_s + 0.3 * BLOCK_S)

    play(0, 200)  # past the first second, after which effects are asked for their state
    assert out.any(), "the vibration arrives"
    gc.collect()  # what other tests left runs its own files when it goes
    gc.disable()
    sys.setprofile(called)
    try:
        play(200, 350)
    finally:
        sys.setprofile(None)
        gc.enable()
    ours = [Path(name).relative_to(ROOT) for name in files if name.startswith(str(ROOT / ""))]
    return {str(path) for path in ours if path.parts[0] in ("audioflinger_hook", "device")}


def test_a_live_buffer_passes_the_files_that_the_page_lists_and_no_others():
    carriers = set()
    for package, cell in re.findall(r"^\| `([\w/]+)` \| (.*) \|$", WAY, re.MULTILINE):
        owner = package if package.startswith("device") else f"audioflinger_hook/{package}"
        carriers |= {f"{owner}/{name}" for name in re.findall(r"`(\w+\.py)`", cell)}
    assert len(carriers) <= CARRIERS_MAX
    assert all((ROOT / name).is_file() for name in carriers)
    ran = files_of_a_cycle()
    # PortAudio's callbacks need a sound card.
    assert carriers - ran == {"device/stream/streams.py"}
    text = WAY.partition("call files that change no sample")[2].partition("`tests/")[0]
    helpers = {Path(name).name for name in re.findall(r"`([\w/]+\.py)`", text)}
    assert {Path(name).name for name in ran - carriers} == helpers
