"""The present moment by all clocks of the machine."""

from __future__ import annotations

import time
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from audioflinger_hook.daemon.safety_keeper import Moment


def present_moment() -> Moment:
    """Return it. Raises nothing; without the kernel's number of the start, `boot` is ""."""
    boot = ""
    with suppress(OSError):
        boot = Path("/proc/sys/kernel/random/boot_id").read_text("ascii").strip()
    return Moment(
        boot=boot,
        boot_s=time.clock_gettime(time.CLOCK_BOOTTIME),
        wall_s=time.time(),
        local=datetime.now().astimezone().isoformat(timespec="minutes"),
    )
