"""Takes buffers from the audio thread; a second thread writes them to a capture."""

import threading
from contextlib import AbstractContextManager
from queue import SimpleQueue
from typing import NamedTuple

import numpy as np

from audioflinger_hook.capture.writer import CaptureWriter, check_frames
from device.errors import CushionError, InternalError
from device.units import Float32Array


class _Handed(NamedTuple):
    start: int
    end: int
    shape: tuple[int, int]
    samplerate: int
    time_s: float
    discontinuity: bool
    dropped_before: tuple[int, int]


class CaptureRecorder(AbstractContextManager["CaptureRecorder"]):
    """Writes a capture for audio threads. For each stream, only one thread may call `offer`.

    writer: `close` also closes the writer. capacity_samples, capacity_buffers: largest size of each
    stream's queue. error: why writing ended, such as a full disk; None without an error. After an
    error, buffers are dropped, and `close` raises the error.
    """

    def __init__(
        self,
        writer: CaptureWriter,
        *,
        capacity_samples: int = 1 << 22,  # 16 MB, or 43 s of 48 kHz stereo
        capacity_buffers: int = 1 << 14,
    ) -> None:
        self.error: CushionError | None = None
        self._writer = writer
        self._lanes = {name: _Lane(capacity_samples, capacity_buffers) for name in writer.streams}
        # `put` never blocks, and wakes the writing thread.
        self._queue: SimpleQueue[tuple[str, _Handed] | None] = SimpleQueue()
        self._closed = False
        # A daemon thread, so that a program can exit without `close`.
        self._thread = threading.Thread(target=self._run, name="capture", daemon=True)
        self._thread.start()

    def offer(
        self,
        stream: str,
        frames: Float32Array,
        samplerate: int,
        time_s: float,
        *,
        discontinuity: bool = False,
    ) -> bool:
        """Queue a copy of a buffer without blocking; return False if the buffer was dropped.

        samplerate: Hz. time_s, discontinuity: see `CaptureWriter.write_buffer`.
        """
        lane = self._lanes[stream]
        try:
            check_frames(frames)
        except InternalError as error:
            self.error = self.error or error
        if self._closed or self.error is not None:
            lane.drop(frames.shape[0] if frames.ndim else 0)
            return False
        handed = lane.put(frames, samplerate, time_s, discontinuity)
        if handed is not None:
            self._queue.put((stream, handed))
        return handed is not None

    def dropped(self, stream: str) -> tuple[int, int]:
        """Return how many buffers and frames of a stream were dropped. Any thread may call this."""
        return self._lanes[stream].dropped()

    def close(self) -> None:
        """Write the queued buffers; raise `error`, if any. No thread may call `offer` any more."""
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        try:
            for stream, lane in self._lanes.items():
                lane.drop_unwritten()
                self._note(stream, lane.take_dropped())
            self._writer.close()
        except CushionError as error:
            self.error = self.error or error
        if self.error is not None:
            raise self.error

    def __exit__(self, *_error: object) -> None:
        self.close()

    def _run(self) -> None:
        """Write buffers until `close` is called. After an error, only count the buffers."""
        failure: CushionError | None = None
        while (item := self._queue.get()) is not None:
            stream, handed = item
            lane = self._lanes[stream]
            if not failure:
                try:
                    self._note(stream, handed.dropped_before)
                    missing = handed.discontinuity or handed.dropped_before[0] > 0
                    samples, rate, at_s = lane.samples_of(handed), handed.samplerate, handed.time_s
                    self._writer.write_buffer(stream, samples, rate, at_s, discontinuity=missing)
                except Exception as error:
                    ended = InternalError(f"the capture ended: {type(error).__name__}: {error}")
                    self.error = failure = error if isinstance(error, CushionError) else ended
            if failure:
                lane.unwritten_buffers += 1
                lane.unwritten_frames += handed.shape[0]
            lane.release(handed)

    def _note(self, stream: str, dropped: tuple[int, int]) -> None:
        if dropped[0]:
            self._writer.note_dropped(stream, *dropped)


class _Lane:
    """Ring buffer of one stream. The audio thread calls `put`, the writing thread `release`.

    Positions count samples, and restart at 0 if `put` finds the ring empty. The samples of a buffer
    are contiguous. If they do not fit at the end of the ring, they begin at its start.
    """

    def __init__(self, capacity_samples: int, capacity_buffers: int) -> None:
        self._ring = np.empty(capacity_samples, np.float32)
        self._ring.fill(0.0)  # writes all memory pages, so that `put` causes no page fault
        self._capacity_buffers = capacity_buffers
        self._head = self._put = 0  # changed by the audio thread
        self._tail = self._released = 0  # changed by the writing thread while buffers are queued
        self.dropped_buffers = self.dropped_frames = 0
        self._reported = (0, 0)
        self.unwritten_buffers = self.unwritten_frames = 0

    def put(
        self, frames: Float32Array, samplerate: int, time_s: float, discontinuity: bool
    ) -> _Handed | None:
        """Copy a buffer into the ring, or count it as dropped and return None."""
        capacity = len(self._ring)
        if self._put == self._released:
            # The ring is empty, so the writing thread changes no position. Restart at 0.
            self._head = self._tail = 0
        start = self._head
        if start % capacity + frames.size > capacity:
            start += capacity - start % capacity
        end = start + frames.size
        if end - self._tail > capacity or self._put - self._released >= self._capacity_buffers:
            self.drop(len(frames))
            return None
        shape = (frames.shape[0], frames.shape[1])
        handed = _Handed(start, end, shape, samplerate, time_s, discontinuity, self.take_dropped())
        self.samples_of(handed)[...] = frames
        self._head = end
        self._put += 1
        return handed

    def drop(self, frames: int) -> None:
        self.dropped_buffers += 1
        self.dropped_frames += frames

    def dropped(self) -> tuple[int, int]:
        """Return how many buffers and frames were dropped or could not be written."""
        buffers = self.dropped_buffers + self.unwritten_buffers
        return buffers, self.dropped_frames + self.unwritten_frames

    def drop_unwritten(self) -> None:
        """Count unwritten buffers as dropped. No thread may use the ring any more."""
        self.dropped_buffers, self.dropped_frames = self.dropped()
        self.unwritten_buffers = self.unwritten_frames = 0

    def take_dropped(self) -> tuple[int, int]:
        buffers, frames = self._reported
        self._reported = (self.dropped_buffers, self.dropped_frames)
        return self.dropped_buffers - buffers, self.dropped_frames - frames

    def samples_of(self, handed: _Handed) -> Float32Array:
        start = handed.start % len(self._ring)
        return self._ring[start : start + handed.end - handed.start].reshape(handed.shape)

    def release(self, handed: _Handed) -> None:
        self._tail = handed.end
        self._released += 1
