"""Whose sound it is: the numbers by which Android tells the players and the mix apart."""

from __future__ import annotations

OUTPUT_MIX, OUTPUT_STAGE, DEVICE = 0, -1, -2
"""The sessions that are nobody's: what all players make together, after that, and the device's;
run in this order. A player's session is a number from 1 up."""
