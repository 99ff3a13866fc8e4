"""The interface of all effect chains, by session, as the mixer uses it."""

from __future__ import annotations

from collections.abc import Collection

from audioflinger_hook.mixer.mix_buffer import MixBuffer

OUTPUT_MIX, OUTPUT_STAGE, DEVICE = 0, -1, -2
"""The sessions that belong to no player, in running order: mix of all players, stage after it,
device. A player's session is a number from 1 up."""


class EffectsPort:
    """The effect chains by session, as the mixer sees them; these have none: the mix is unchanged.

    All calls come from the mixer's thread, but for `dump`.
    """

    def sessions(self) -> Collection[int]:
        """Return the sessions that have a chain now."""
        return ()

    def process(self, session: int, buffer: MixBuffer, now_s: float) -> None:
        """Run the chain in place; `buffer.haptic` holds zeros or the output of earlier chains."""

    def end_of_cycle(self, now_s: float) -> None:
        """Do the work due at the end of a cycle that wrote, such as ENABLE or the end of a tail."""

    def set_format(self, samplerate: int, channels: int, haptic_channels: int, frames: int) -> None:
        """Set the format of all buffers from now on: before the first buffer, and at changes."""

    def dump(self) -> list[str]:
        """Return the number of chains as a heading, then each chain's effects. Any thread."""
        return ["0 Effect Chains"]
