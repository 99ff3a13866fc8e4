"""The interface of all effect chains, by session, as the mixer uses it."""

from __future__ import annotations

from collections.abc import Collection
from typing import Protocol

from audioflinger_hook.mixer.mix_buffer import MixBuffer

OUTPUT_MIX, OUTPUT_STAGE, DEVICE = 0, -1, -2
"""The sessions that belong to no player, in running order: the mix of all players, the stage after
the mix, and the device. A player's session is a number from 1 up."""


class EffectsPort(Protocol):
    """The effect chains by session, as the mixer sees them. All calls come from its thread."""

    def sessions(self) -> Collection[int]:
        """The sessions that have a chain now."""
        ...

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        """Run the session's chain over the buffer, in place.

        `buffer.audio` holds the sound, `buffer.haptic` zeros or the output of earlier chains.
        """
        ...

    def end_of_cycle(self, now_s: float) -> None:
        """Do the work due at the end of a cycle that wrote, such as ENABLE or the end of a tail."""
        ...

    def set_format(self, samplerate: int, channels: int, haptic_channels: int, frames: int) -> None:
        """Set the format of all buffers from now on: before the first buffer, and at changes."""
        ...

    def dump(self) -> list[str]:
        """Return the number of chains as a heading, then each chain's effects. Any thread."""
        ...


class NoEffects:
    """No chain for any session: the mix goes to the sinks unchanged."""

    def sessions(self) -> Collection[int]:
        """None."""
        return ()

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        """Leave the buffer unchanged."""

    def end_of_cycle(self, now_s: float) -> None:
        """Do nothing."""

    def set_format(self, samplerate: int, channels: int, haptic_channels: int, frames: int) -> None:
        """Do nothing."""

    def dump(self) -> list[str]:
        """The heading alone."""
        return ["0 Effect Chains"]
