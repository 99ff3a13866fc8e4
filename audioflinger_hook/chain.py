"""The chain: tap -> effect -> outputs, one buffer a step, whatever paces it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.effect import HapticEffect
from audioflinger_hook.taps import Tap
from device.output import VibrationOutput


@dataclass(frozen=True)
class Step:
    """What one step moved: the sound as tapped and the vibration as sent, float32.

    At the end of the sound comes one step of no sound, with the vibration still owed.
    """

    audio: NDArray[np.float32]
    vibration: NDArray[np.float32]


class Chain:
    """Moves sound from a tap through the effect to every output.

    A live tap, a replay and a rendering differ only in who calls `step` and when. All calls come
    from one thread.
    """

    def __init__(self, tap: Tap, effect: HapticEffect, outputs: Sequence[VibrationOutput]) -> None:
        self._tap = tap
        self._effect = effect
        self._outputs = tuple(outputs)
        self._ended = False

    def step(self) -> Step | None:
        """Move one buffer and return it, or None once everything has been sent."""
        if self._ended:
            return None
        audio = self._tap.read()
        if audio is None:
            self._ended = True
            audio = np.zeros((0, self._tap.channels), np.float32)
            vibration = self._effect.finish()
        else:
            vibration = self._effect.process(audio)
        for output in self._outputs:
            output.write(vibration)
        return Step(audio, vibration)

    def close(self) -> None:
        """Let go of the tap and finish every output, the first one last: what was sent is kept.

        So where one of the others cannot be finished, the first has not yet replaced anything.
        """
        self._tap.close()
        for output in reversed(self._outputs):
            output.close()

    def abort(self) -> None:
        """Let go of the tap and discard what the outputs took."""
        self._tap.close()
        for output in self._outputs:
            output.abort()
