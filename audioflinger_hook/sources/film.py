"""A tap of a film's sound track in any format of FFmpeg. It needs the optional package PyAV."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.sources.file import BLOCKSIZE_FRAMES
from audioflinger_hook.sources.tap import SteadyTap, named, reason_of
from audioflinger_hook.transform.parameters import check_format
from device.errors import UsageError
from device.units import Float32Array

FILMS = frozenset(  # endings of files that libsndfile cannot read or misinterprets
    {
        *(".mka", ".mkv", ".mp4", ".m4v", ".m4a", ".mov", ".avi", ".webm"),
        *(".mpg", ".mpeg", ".ts", ".m2ts", ".vob", ".wmv", ".flv", ".ogv"),
    }
)

GAP_S = 0.02  # longest gap between two packets that is not filled with silence
GAP_MAX_S = 24 * 3600.0  # a longer gap comes from a wrong time stamp and is not filled

EXTRA = "sound tracks of films need PyAV; pip install 'haptic-cushion[films]'"


class FilmTap(SteadyTap):
    """A tap of one sound track of a film. If the track begins late, silence precedes it.

    track: counted from 1; None for the first track in `language`, or for the file's default track.
    language: language of the track, as in the file, such as "eng". UsageError: PyAV is missing, the
    file cannot be read, has no such track or no sound, or its format is not supported.
    """

    def __init__(self, path: Path, *, track: int | None = None, language: str | None = None):
        try:
            import av
        except ImportError:
            raise UsageError(f"{path}: {EXTRA}") from None
        self._path = path
        self._errors = (av.error.FFmpegError, ValueError)
        try:
            # PyAV before version 19 needs an option to accept invalid text in metadata.
            is_old = int(av.__version__.partition(".")[0]) < 19
            options: Any = {"metadata_errors": "replace"} if is_old else {}
            self._container: Any = av.open(str(path), **options)
        except (*self._errors, OSError) as error:
            raise UsageError(f"{path} cannot be read as a film ({reason_of(error)})") from None
        try:
            stream = self._chosen(track, language)
            codec = stream.codec_context
            format_ = (int(codec.sample_rate), int(codec.channels))
            check_format(*format_)
            self._start_s = (self._container.start_time or 0) / av.time_base
            length_s = (self._container.duration or 0) / av.time_base
            expected = round(length_s * format_[0]) or None
            super().__init__(*format_, self._buffered(stream), expected)
            if self._next is None:
                raise UsageError(f"{path} has no sound in its track; {' '.join(self.warnings)}")
        except UsageError as error:
            self.close()
            raise named(error, path) from None

    def close(self) -> None:
        """Close the file."""
        self._container.close()

    def _chosen(self, track: int | None, language: str | None) -> Any:
        streams = list(self._container.streams.audio)
        spoken = [stream.metadata.get("language", "und") for stream in streams]
        there = ", ".join(f"{n} ({word})" for n, word in enumerate(spoken, 1))
        if not streams:
            raise UsageError(f"{self._path} has no sound track; leave this film out")
        if track is not None:
            if not 1 <= track <= len(streams):
                raise UsageError(f"{self._path} has no sound track {track}; there are {there}")
            if language not in (None, spoken[track - 1]):
                raise UsageError(f"sound track {track} of {self._path} is not {language}: {there}")
            return streams[track - 1]
        if language is None:
            return self._container.streams.best("audio") or streams[0]
        if language not in spoken:
            raise UsageError(f"{self._path} has no sound track in {language!r}; there are {there}")
        return streams[spoken.index(language)]

    def _buffered(self, stream: Any) -> Iterator[Float32Array]:
        waiting: list[Float32Array] = []
        frames = 0
        for part in self._parts(stream):
            waiting.append(part)
            frames += len(part)
            if frames >= BLOCKSIZE_FRAMES:
                yield np.concatenate(waiting)
                waiting, frames = [], 0
        if frames:
            yield np.concatenate(waiting)

    def _parts(self, stream: Any) -> Iterator[Float32Array]:
        """Yield decoded frames, with silence in gaps of the sound track."""
        import av

        even = av.AudioResampler("flt", stream.codec_context.layout, self.samplerate)
        done = 0
        for decoded in self._decoded(stream):
            if decoded.time is not None:
                due = round((decoded.time - self._start_s) * self.samplerate)
                gap = due - done
                if GAP_S * self.samplerate < gap < GAP_MAX_S * self.samplerate:
                    done = due
                    for first in range(0, gap, BLOCKSIZE_FRAMES):
                        silent = min(BLOCKSIZE_FRAMES, gap - first)
                        yield np.zeros((silent, self.channels), np.float32)
            try:
                resampled = even.resample(decoded)
            except self._errors as error:
                self._note(error)
                return
            for frame in resampled:
                part: NDArray[Any] = frame.to_ndarray().reshape(-1, self.channels)
                done += len(part)
                yield part

    def _decoded(self, stream: Any) -> Iterator[Any]:
        """Yield decoded frames; skip damaged packets, with one warning."""
        try:
            for packet in self._container.demux(stream):
                try:
                    yield from packet.decode()
                except self._errors as error:
                    self._note(error)
        except self._errors as error:
            self._note(error)

    def _note(self, error: Exception) -> None:
        if not self.warnings:
            self.warnings.append(
                f"{self._path} is damaged ({reason_of(error)}); its sound was taken"
            )
