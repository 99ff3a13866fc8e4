"""A command on a terminal of its own, as whoever sits at it uses it."""

import os
import select
import time
from typing import Any, Self

from tests.support.commands import DEADLINE_S, start

CONTROLLED = """
import fcntl, os, termios
os.setsid()
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
"""
"""Makes the terminal that of the process, so that Ctrl+C there reaches it."""


class Terminal:
    """A running command whose three streams are one terminal. shown: all that was printed there."""

    def __init__(self, *arguments: object, **options: Any) -> None:
        self._ours, theirs = os.openpty()
        streams: dict[str, Any] = {"stdin": theirs, "stdout": theirs, "stderr": theirs}
        env = {"TERM": "dumb", **options.pop("env", {})}
        self.process = start(*arguments, prelude=CONTROLLED, env=env, **streams, **options)
        os.close(theirs)
        self.shown = ""
        self._seen = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.process.kill()
        self.process.wait()
        self.close()

    def expect(self, text: str) -> None:
        """Read on until a text is printed."""
        deadline_s = time.monotonic() + DEADLINE_S
        while text not in self.shown[self._seen :]:
            assert time.monotonic() < deadline_s, self.shown
            assert self._read(0.1) or self.process.poll() is None, self.shown
        self._seen = self.shown.index(text, self._seen) + len(text)

    def type(self, line: str) -> None:
        os.write(self._ours, f"{line}\n".encode())

    def press(self, key: bytes) -> None:
        """Press a key, such as b"\\x03" for Ctrl+C."""
        os.write(self._ours, key)

    def close(self) -> None:
        """Close the terminal, as with its window; nothing more is shown."""
        if self._ours >= 0:
            os.close(self._ours)
            self._ours = -1

    def wait(self) -> int:
        """Read until the command ends; return its exit code."""
        if self._ours < 0:
            return self.process.wait(DEADLINE_S)
        deadline_s = time.monotonic() + DEADLINE_S
        while self.process.poll() is None:
            assert time.monotonic() < deadline_s, self.shown
            self._read(0.05)
        while self._read(0.0):
            pass
        return self.process.returncode

    def _read(self, limit_s: float) -> bool:
        if not select.select([self._ours], [], [], limit_s)[0]:
            return False
        try:
            piece = os.read(self._ours, 65_536)
        except OSError:  # EIO: the command has ended
            return False
        self.shown += piece.decode(errors="replace").replace("\r\n", "\n")
        return bool(piece)
