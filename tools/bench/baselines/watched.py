"""A comparator that may fail: which one did is told by what it raises."""

from __future__ import annotations

from audioflinger_hook.transform import FloatArray, Frames
from tools.bench.workbench import Stream, Subject


class ComparatorFailed(Exception):
    """A comparator could not do what it is for; name: which one."""

    def __init__(self, name: str, error: Exception) -> None:
        super().__init__(f"it failed ({type(error).__name__}: {' '.join(str(error).split())})")
        self.name = name


def watched(subject: Subject) -> Subject:
    """Return a comparator that raises `ComparatorFailed` whatever goes wrong in it."""

    def start(samplerate: int, channels: int) -> Stream:
        try:
            return _Watched(subject.name, subject.start(samplerate, channels))
        except Exception as error:
            raise ComparatorFailed(subject.name, error) from error

    return Subject(subject.name, start)


class _Watched:
    def __init__(self, name: str, stream: Stream) -> None:
        self._name = name
        self._stream = stream

    def process(self, frames: Frames) -> FloatArray:
        try:
            return self._stream.process(frames)
        except Exception as error:
            raise ComparatorFailed(self._name, error) from error

    def finish(self) -> FloatArray:
        try:
            return self._stream.finish()
        except Exception as error:
            raise ComparatorFailed(self._name, error) from error
