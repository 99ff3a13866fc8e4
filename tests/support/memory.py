import psutil


def resident_bytes(pid: int | None = None) -> int:
    """Return the memory that a process occupies now, by default this one."""
    return int(psutil.Process(pid).memory_info().rss)
