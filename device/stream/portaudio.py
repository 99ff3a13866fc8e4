"""The single PyAudio instance: streams open and close on new threads, with time limits."""

import ctypes
import itertools
import os
import platform
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from device.errors import InternalError, LostError, NotFoundError, not_installed
from device.stream.pcms import Pcm, ServerDevice, missing_plugin
from device.stream.sample_format import SampleFormat

BLOCK_FRAMES = 256  # frames per callback; ALSA's pulse plugin is unstable with fewer

OPEN_LIMIT_S, CLOSE_LIMIT_S = 5.0, 2.0
START_LIMIT_S = 1.5  # PortAudio itself gives up after 1 s
ATTEMPTS = 3

_FORMATS = {
    SampleFormat.FLOAT32: 0x01,
    SampleFormat.S32: 0x02,
    SampleFormat.S24_3: 0x04,
    SampleFormat.S16: 0x08,
}
"""PortAudio's format numbers, in the machine's byte order, which must be little endian."""

# PyAudio's callback: (input, frames, times, flags) to (output, continue)
Callback = Callable[[bytes | None, int, Any, int], tuple[bytes | None, int]]

Result = TypeVar("Result")

_lock = threading.Lock()  # held to start or end PortAudio, open a stream or replace stderr
_pyaudio: Any = None
open_tags: set[str] = set()  # tags of streams that are open, closing or abandoned
_numbers = itertools.count(1)


@dataclass(frozen=True)
class OpenStream:
    """An open stream. stream: PyAudio's object. tag: its property `pcms.TAG` on the server."""

    stream: Any
    tag: str


@dataclass(frozen=True)
class StreamSetup:
    """Parameters of a stream. sample_format: in the callback; the device's format may differ."""

    output: bool
    samplerate: int
    channels: int
    block_frames: int
    sample_format: SampleFormat


def open_stream(pcm: Pcm, setup: StreamSetup, callback: Callback) -> OpenStream:
    """Open and start a stream on the PCM's target; a thread of PortAudio calls `callback`.

    Any thread except a callback's may call this function. LostError: the server or the device is
    missing or in use, does not support `setup`, or does not answer in time. NotFoundError: PyAudio,
    PortAudio or ALSA's plugin for sound servers is not installed.
    """
    what = f"{pcm.target} for {'playback' if setup.output else 'capture'}"
    side = "output" if setup.output else "input"

    def open_stopped() -> OpenStream:
        if not _lock.acquire(timeout=OPEN_LIMIT_S):
            raise LostError(
                f"cannot open {pcm.target}: an earlier opening has not returned; the sound server "
                "or the card hangs, restart it"
            )
        try:
            instance, index = _instance(pcm)
            tag = f"{os.getpid()}-{next(_numbers)}"
            with pcm.config.opening(pcm, tag, output=setup.output):
                stream = instance.open(
                    rate=setup.samplerate,
                    channels=setup.channels,
                    format=_FORMATS[setup.sample_format],
                    frames_per_buffer=setup.block_frames,
                    stream_callback=callback,
                    start=False,
                    **{side: True, f"{side}_device_index": index},
                )
            open_tags.add(tag)
            return OpenStream(stream, tag)
        finally:
            _lock.release()

    def start(opened: OpenStream) -> OpenStream:
        opened.stream.start_stream()
        return opened

    attempt = 0
    try:
        while True:
            attempt += 1
            opened = _call_within(OPEN_LIMIT_S, f"open {what}", open_stopped, close_stream)
            try:
                work = partial(start, opened)
                return _call_within(START_LIMIT_S, f"start {what}", work, close_stream)
            except LostError:
                # PortAudio 19.6 never returns if its thread fails to start, which happens
                # occasionally on PipeWire. Such a stream cannot be closed: abandon it.
                if attempt == ATTEMPTS:
                    raise
            except OSError:
                close_stream(opened)
                raise
    except (OSError, ValueError) as error:
        if isinstance(pcm.target, ServerDevice) and (missing := missing_plugin()):
            raise NotFoundError(missing) from None
        reason = str(error.args[-1]) if error.args else type(error).__name__
        format_ = setup.sample_format
        in_format = "" if format_ is SampleFormat.FLOAT32 else f" in {format_.value}"
        raise LostError(
            f"cannot open {what} with {setup.channels} channels at {setup.samplerate} Hz"
            f"{in_format} ({reason}): {pcm.target.trouble}"
        ) from None


def close_stream(opened: OpenStream) -> bool:
    """Close the stream; return whether it closed in time. A callback must not call this."""

    def work() -> None:
        with suppress(OSError, ValueError, SystemError):  # PortAudio has already closed the stream
            opened.stream.close()
        open_tags.discard(opened.tag)

    try:
        _call_within(CLOSE_LIMIT_S, "close a stream", work)
    except LostError:
        return False
    return True


def _instance(pcm: Pcm) -> tuple[Any, int]:
    """Return the single instance of PyAudio, and its index of the device named like the PCM."""
    global _pyaudio
    try:
        import pyaudio
    except ModuleNotFoundError:
        raise NotFoundError(not_installed("PyAudio", "live")) from None
    except ImportError as error:
        raise NotFoundError(
            f"PyAudio cannot be loaded ({error}); install PortAudio (libportaudio2) and PyAudio"
        ) from None
    index = None if _pyaudio is None else _index(_pyaudio, pcm)
    if index is None and not open_tags:
        if _pyaudio is not None:  # the instance is older than this PCM
            _pyaudio.terminate()
        _pyaudio = pyaudio.PyAudio()
        index = _index(_pyaudio, pcm)
    if index is None:
        raise InternalError(f"PortAudio does not know the PCM {pcm.name}")
    return _pyaudio, index


def _index(instance: Any, pcm: Pcm) -> int | None:
    devices = map(instance.get_device_info_by_index, range(instance.get_device_count()))
    return next((index for index, known in enumerate(devices) if known["name"] == pcm.name), None)


def _call_within(
    limit_s: float,
    what: str,
    work: Callable[[], Result],
    late: Callable[[Result], object] = lambda _: None,
) -> Result:
    """Run `work` on a new thread. LostError: no result in limit_s; `late` gets a late result."""
    future: Future[Result] = Future()

    def run() -> None:
        try:
            result = work()
        except BaseException as error:  # the caller's thread raises it
            if future.set_running_or_notify_cancel():
                future.set_exception(error)
            return
        if future.set_running_or_notify_cancel():
            future.set_result(result)
        else:
            late(result)

    threading.Thread(target=run, name=what, daemon=True).start()
    try:
        return future.result(limit_s)
    except TimeoutError:
        if not future.cancel():  # the result has just arrived
            return future.result()
    raise LostError(
        f"cannot {what}: the sound server or the card has not answered for {limit_s:g} s; "
        "see whether it hangs, and restart it if so"
    )


_filtered = False


def filter_stderr() -> bool:
    """Discard what C libraries print to stderr; return False if this is impossible.

    The function needs the GNU C library. It also hides messages of failed C assertions and of fatal
    errors of the interpreter, so avoid it for debugging. Any thread may call it, repeatedly.
    """
    global _filtered
    with _lock:
        if _filtered or platform.libc_ver()[0] != "glibc":
            return _filtered
        libc = ctypes.CDLL(None)
        libc.fopen.restype = ctypes.c_void_p
        with suppress(OSError, ValueError):  # in another C library stderr may be a constant
            stream = ctypes.c_void_p.in_dll(libc, "stderr")
            if replacement := libc.fopen(os.devnull.encode(), b"we"):
                stream.value, _filtered = replacement, True
        return _filtered
