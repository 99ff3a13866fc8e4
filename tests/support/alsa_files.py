"""A file in the place of a sound card: ALSA writes down what PortAudio hands to it.

Nothing there keeps time, so whoever fills a block has to take a while over it.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from device.stream import portaudio
from device.stream.pcms import PcmConfig, Target

BLOCK_S = 0.002


@dataclass(frozen=True)
class ToFile(Target):
    """A target like a card's: every byte that would go to the card goes to the file."""

    path: Path

    trouble = "the file cannot be written"

    def __str__(self) -> str:
        return str(self.path)

    @property
    def definition(self) -> str:
        return f'type file slave.pcm {{ type null }} file "{self.path}" format raw'


@contextmanager
def portaudio_with(name: str) -> Iterator[PcmConfig]:
    """PortAudio with one PCM of that name, ended afterwards."""
    pytest.importorskip("pyaudio")
    config = PcmConfig(name)
    try:
        yield config
    finally:
        config.close()
    assert len(portaudio.open_tags) == 0


def until(condition, limit_s: float = 10.0) -> None:
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)
