"""A baseline that may fail: what it raises then names it."""

from __future__ import annotations

from audioflinger_hook.transform import FloatArray, Frames
from tools.bench.workbench import Stream, Subject


class BaselineFailed(Exception):
    """A baseline raised an error; name: which one."""

    def __init__(self, name: str, error: Exception) -> None:
        super().__init__(f"it failed ({type(error).__name__}: {' '.join(str(error).split())})")
        self.name = name


def guarded(subject: Subject) -> Subject:
    """Return a baseline that raises `BaselineFailed` for every error."""

    def start(samplerate: int, channels: int) -> Stream:
        try:
            return _Guarded(subject.name, subject.start(samplerate, channels))
        except Exception as error:
            raise BaselineFailed(subject.name, error) from error

    return Subject(subject.name, start)


class _Guarded:
    def __init__(self, name: str, stream: Stream) -> None:
        self._name = name
        self._stream = stream

    def process(self, frames: Frames) -> FloatArray:
        try:
            return self._stream.process(frames)
        except Exception as error:
            raise BaselineFailed(self._name, error) from error

    def finish(self) -> FloatArray:
        try:
            return self._stream.finish()
        except Exception as error:
            raise BaselineFailed(self._name, error) from error
