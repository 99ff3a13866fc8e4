"""The process's one PyAudio instance: opening and closing streams, each within a time limit.

PyAudio is loaded at the first opening. Every call into it that may wait for a sound server runs on
a thread of its own: a server that hangs then costs that thread, not the caller's.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

from device.errors import InternalError, LostError, NotFoundError
from device.stream.pcms import Pcm
from device.stream.sample_format import SampleFormat

BLOCK_FRAMES = 256
"""Frames a callback, usually. Fewer are unstable through ALSA's pulse plugin, more add 30 ms and
above."""

OPEN_LIMIT_S = 5.0
START_LIMIT_S = 1.5
"""PortAudio itself gives up after 1 s."""

ATTEMPTS = 3
CLOSE_LIMIT_S = 2.0

_NAMES = {
    SampleFormat.FLOAT32: "paFloat32",
    SampleFormat.S16: "paInt16",
    SampleFormat.S24_3: "paInt24",
    SampleFormat.S32: "paInt32",
}
"""PortAudio's are in the machine's order of bytes, which has to be little endian."""

Callback = Callable[[bytes | None, int, Any, int], tuple[bytes | None, int]]
"""PyAudio's: (input, frames, times, flags) to (output, continue)."""

Result = TypeVar("Result")

_lock = threading.Lock()
"""Held while PortAudio starts, ends or opens a stream: it cannot do two of these at once."""

_count = threading.Lock()
_pyaudio: Any = None
_open = 0
_abandoned = 0
_numbers = itertools.count(1)


@dataclass(frozen=True)
class OpenStream:
    """PyAudio's stream, the tag that the server shows for it (`pcms.TAG`), and its format."""

    stream: Any
    tag: str
    sample_format: SampleFormat = SampleFormat.FLOAT32

    def start(self) -> OpenStream:
        """Let callbacks come; returns itself."""
        self.stream.start_stream()
        return self


def open_stream(
    pcm: Pcm,
    *,
    output: bool,
    samplerate: int,
    channels: int,
    callback: Callback,
    block_frames: int = BLOCK_FRAMES,
    sample_format: SampleFormat = SampleFormat.FLOAT32,
) -> OpenStream:
    """A running stream of the PCM's device; `callback` is called by a thread of PortAudio.

    samplerate: Hz; block_frames: how many a callback. sample_format: of the callback's bytes; a
    card that has another one only gets them converted by PortAudio, with dither. Any thread but a
    callback's may call this; openings go one after another.

    Raises
    ------
    LostError
        No server answers, there is no such device (or it ended meanwhile) or it is in use, or it
        takes longer than OPEN_LIMIT_S and START_LIMIT_S.
    NotFoundError
        PyAudio or PortAudio is not installed.
    """
    what = f"{pcm.target} for {'playback' if output else 'capture'}"
    shape = _Shape(samplerate, channels, block_frames, sample_format)
    try:
        for attempt in range(1, ATTEMPTS + 1):
            opened = _within(
                OPEN_LIMIT_S,
                f"open {what}",
                lambda: _open_still(pcm, output, shape, callback),
                close_stream,
            )
            try:
                return _within(START_LIMIT_S, f"start {what}", opened.start, _close_late)
            except LostError:
                # PortAudio 19.6 waits for ever if its thread fails to start, as happens now and
                # then on PipeWire. That stream cannot be closed: leave it.
                _note(opened=-1, abandoned=1)
                if attempt == ATTEMPTS:
                    raise
            except OSError:
                close_stream(opened)
                raise
    except (OSError, ValueError) as error:
        raise LostError(
            f"cannot open {what} with {shape} ({_reason(error)}): {pcm.target.trouble}"
        ) from None
    raise InternalError("unreachable")


@dataclass(frozen=True)
class _Shape:
    """What a stream is made of."""

    samplerate: int
    channels: int
    block_frames: int
    sample_format: SampleFormat

    def __str__(self) -> str:
        name = self.sample_format.value
        in_format = "" if self.sample_format is SampleFormat.FLOAT32 else f" in {name}"
        return f"{self.channels} channels at {self.samplerate} Hz{in_format}"


def _open_still(pcm: Pcm, output: bool, shape: _Shape, callback: Callback) -> OpenStream:
    """The stream, opened and not started yet."""
    if not _lock.acquire(timeout=OPEN_LIMIT_S):
        raise LostError(
            f"cannot open {pcm.target}: an earlier opening has not come back; the sound server or "
            "the card hangs, restart it"
        )
    try:
        pyaudio, instance, index = _instance(pcm)
        tag = f"{os.getpid()}-{next(_numbers)}"
        side = "output" if output else "input"
        with pcm.config.opening(pcm, tag, output=output):
            stream = instance.open(
                rate=shape.samplerate,
                channels=shape.channels,
                format=getattr(pyaudio, _NAMES[shape.sample_format]),
                frames_per_buffer=shape.block_frames,
                stream_callback=callback,
                start=False,
                **{side: True, f"{side}_device_index": index},
            )
        _note(opened=1)
        return OpenStream(stream, tag, shape.sample_format)
    finally:
        _lock.release()


def close_stream(opened: OpenStream) -> bool:
    """Close the stream; whether that was done within CLOSE_LIMIT_S, else it goes on by itself.

    Any thread but a callback's may call this, once. It raises nothing.
    """

    def work() -> None:
        with suppress(OSError, ValueError, SystemError):  # PortAudio gave it up already
            opened.stream.close()
        _note(opened=-1)

    try:
        _within(CLOSE_LIMIT_S, "close a stream", work)
    except LostError:
        return False
    return True


def _close_late(opened: OpenStream) -> None:
    """Close a stream that was given up and has started after all."""
    _note(opened=1, abandoned=-1)
    close_stream(opened)


def _note(opened: int = 0, abandoned: int = 0) -> None:
    global _open, _abandoned
    with _count:
        _open += opened
        _abandoned += abandoned


def terminate() -> bool:
    """End PortAudio and unload its device list; False, and nothing done, while streams are open.

    Any thread but a callback's may call this; it raises nothing. `open_stream` starts it anew.
    """
    global _pyaudio
    if not _lock.acquire(timeout=CLOSE_LIMIT_S):
        return False
    try:
        if _open or _abandoned:
            return False
        instance, _pyaudio = _pyaudio, None
        if instance is not None:
            instance.terminate()
        return True
    finally:
        _lock.release()


def open_streams() -> int:
    """How many streams are open, those included whose closing has not come back."""
    return _open


def abandoned_streams() -> int:
    """How many streams never started and cannot be closed: each holds a thread until the end."""
    return _abandoned


def _instance(pcm: Pcm) -> tuple[Any, Any, int]:
    """PyAudio's module, the one instance, and the index that it has for this PCM."""
    global _pyaudio
    try:
        import pyaudio
    except ImportError as error:
        raise NotFoundError(
            f"PyAudio cannot be loaded ({error}); install PortAudio (libportaudio2) and PyAudio"
        ) from None
    if _pyaudio is None:
        _pyaudio = pyaudio.PyAudio()
    elif _index(_pyaudio, pcm) is None:  # its list is older than this PCM
        if _open or _abandoned:
            raise InternalError(f"PortAudio learns of {pcm.name} only without open streams")
        _pyaudio.terminate()
        _pyaudio = pyaudio.PyAudio()
    index = _index(_pyaudio, pcm)
    if index is None:
        raise InternalError(f"PortAudio does not know the PCM {pcm.name}")
    return pyaudio, _pyaudio, index


def _index(instance: Any, pcm: Pcm) -> int | None:
    for index in range(instance.get_device_count()):
        if instance.get_device_info_by_index(index)["name"] == pcm.name:
            return index
    return None


def _within(
    limit_s: float,
    what: str,
    work: Callable[[], Result],
    late: Callable[[Result], object] = lambda _: None,
) -> Result:
    """What `work` returns or raises on a thread of its own, LostError if that takes longer.

    late: called with the result, on that thread, if nobody waits for it any more.
    """
    outcome: list[Result] = []
    errors: list[BaseException] = []
    claim = threading.Lock()
    given_up = False

    def run() -> None:
        try:
            result = work()
        except BaseException as error:  # raised again below, for the caller
            errors.append(error)
            return
        with claim:
            outcome.append(result)
            unwanted = given_up
        if unwanted:
            late(result)

    thread = threading.Thread(target=run, name=what, daemon=True)
    thread.start()
    thread.join(limit_s)
    with claim:
        given_up = not outcome
    if outcome:
        return outcome[0]
    if errors:
        raise errors[0]
    raise LostError(
        f"cannot {what}: the sound server or the card has not answered for {limit_s:g} s; "
        "see whether it hangs, and restart it if so"
    )


def _reason(error: Exception) -> str:
    """What PyAudio says: its text where there is one, else its number."""
    return str(error.args[-1]) if error.args else type(error).__name__
