"""The chain: client -> mixer -> effect -> outputs, one cycle a step, whatever paces it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.mixer import HapticSink
from audioflinger_hook.pipeline.framework import Framework
from audioflinger_hook.sources import Client
from device.output import VibrationOutput


class Step(NamedTuple):
    """What one step moved: the sound as mixed and the vibration as sent, float32.

    At the end of the sound comes one step of no sound, with the vibration still owed. Nothing at
    all where the client has nothing yet.
    """

    audio: NDArray[np.float32]
    vibration: NDArray[np.float32]


class Chain:
    """Moves sound from a client through mixer and effect to every output.

    A live tap, a replay and a rendering differ only in who calls `step` and when. All calls come
    from one thread.
    """

    def __init__(
        self, client: Client, framework: Framework, outputs: Sequence[VibrationOutput]
    ) -> None:
        self._client = client
        self._framework = framework
        self._outputs = tuple(outputs)
        self._sink = HapticSink(*outputs, clip=framework.settings.form != "reference")
        self._ended = False
        framework.send_to(self._sink)
        client.connect(framework.mixer)

    def step(self, now_s: float = 0.0) -> Step | None:
        """Do one cycle and return what it moved, or None once everything has been sent.

        now_s: seconds of any clock that does not run backwards.
        """
        if self._ended:
            return None
        frames = self._client.play()
        if frames is None:
            self._ended = True
            self._sink.send(self._framework.drain())
            audio = np.zeros((0, self._framework.mixer.channels), np.float32)
        elif frames == 0:
            mixer = self._framework.mixer
            nothing = np.zeros((0, mixer.channels + mixer.haptic_channels), np.float32)
            return Step(nothing[:, : mixer.channels], nothing[:, mixer.channels :])
        else:
            audio = self._framework.cycle(now_s, frames).buffer.audio.copy()
        return Step(audio, self._sink.sent.copy())

    def close(self) -> None:
        """Let go of the client and finish every output, the first one last: what was sent is kept.

        So where one of the others cannot be finished, the first has not yet replaced anything.
        """
        self._client.close()
        for output in reversed(self._outputs):
            output.close()

    def abort(self) -> None:
        """Let go of the client and discard what the outputs took."""
        self._client.close()
        for output in self._outputs:
            output.abort()
