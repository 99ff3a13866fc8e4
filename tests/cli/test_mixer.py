"""A card's volume and mute in a word, whatever its mixer has."""

from __future__ import annotations

from typing import Any

import pytest

from audioflinger_hook.cli.usb import mixer_lines, volume_now

SILENT = {"name": "PCM Playback Volume", "db": [None, None], "lowest_db": None, "highest_db": 0.0}
SOFT = {**SILENT, "db": [-30.0, -12.5]}
NO_TABLE = {"name": "PCM Playback Volume"}
MUTED = {"name": "PCM Playback Switch", "muted": [True, True]}
HALF = {"name": "PCM Playback Switch", "muted": [True, False]}


@pytest.mark.parametrize(
    ("volumes", "mutes", "word"),
    [
        ([SOFT], [], "-12.5 dB"),
        ([SOFT], [HALF], "-12.5 dB"),
        ([SOFT], [MUTED], "muted"),
        ([SILENT], [], "silence"),
        ([NO_TABLE], [HALF], ""),
        ([], [], ""),
    ],
)
def test_the_loudest_channel_counts_and_a_mute_of_all_before_it(
    volumes: list[dict[str, Any]], mutes: list[dict[str, Any]], word: str
) -> None:
    assert volume_now({"volumes": volumes, "mutes": mutes, "problem": None}) == word


def test_every_control_has_a_line_of_its_own() -> None:
    mixer = {"volumes": [SOFT, NO_TABLE], "mutes": [MUTED, HALF], "problem": None}
    assert mixer_lines(mixer) == [
        "PCM Playback Volume of the sound card: -30.00 dB, -12.50 dB, silence to +0.00 dB",
        "PCM Playback Volume of the sound card: in steps of unknown size",
        "PCM Playback Switch of the sound card: muted",
        "PCM Playback Switch of the sound card: partly muted",
    ]


def test_why_a_mixer_could_not_be_read_is_told() -> None:
    mixer = {"volumes": [], "mutes": [], "problem": "this user may not open it"}
    assert mixer_lines(mixer) == ["volume of the sound card unknown: this user may not open it"]
