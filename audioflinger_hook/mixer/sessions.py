"""Session numbers, by which Android distinguishes the players and the mix."""

from __future__ import annotations

OUTPUT_MIX, OUTPUT_STAGE, DEVICE = 0, -1, -2
"""The sessions of no single player, in running order: the mix of all players, the stage after it,
and the device. A player's session is a number from 1 up."""
