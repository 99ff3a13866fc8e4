"""How many files a long command may have open at once."""

from __future__ import annotations

import resource

from device.errors import UsageError

NEEDED, WANTED = 64, 512
"""A daemon with a sound server, eight pages and a recording has about fifty files open."""


def allow_open_files() -> None:
    """Raise this process's limit of open files to what a daemon may need. Main thread only.

    UsageError: the limit cannot be raised far enough.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    endless = resource.RLIM_INFINITY
    if soft == endless or soft >= WANTED:
        return
    allowed = WANTED if hard == endless else min(WANTED, hard)
    if allowed < NEEDED:
        raise UsageError(
            f"only {allowed} files may be open at once (ulimit -n); cushion run needs {NEEDED}: "
            "raise the limit and start it again"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))
