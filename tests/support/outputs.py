from typing import Any

import numpy as np
from numpy.typing import NDArray


class KeptOutput:
    """Keeps copies of its blocks, and how it ended: "closed" or "aborted", once for each call."""

    def __init__(self, samplerate: int, channels: int = 1) -> None:
        self.samplerate = samplerate
        self.channels = channels
        self.blocks: list[NDArray[Any]] = []
        self.ended: list[str] = []

    def write(self, vibration: NDArray[Any]) -> None:
        self.blocks.append(np.array(vibration))

    def close(self) -> None:
        self.ended.append("closed")

    def abort(self) -> None:
        self.ended.append("aborted")

    @property
    def whole(self) -> NDArray[Any]:
        return np.concatenate([np.zeros((0, self.channels), np.float32), *self.blocks])
