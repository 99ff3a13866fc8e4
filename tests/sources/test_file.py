"""Part of a sound file, read from some frame on."""

import numpy as np
import pytest

from audioflinger_hook.sources import FileTap
from device.errors import UsageError
from tests.support.commands import noise, sound
from tests.support.taps import frames_of


@pytest.mark.parametrize("subtype", ["PCM_U8", "PCM_16", "PCM_24", "FLOAT"])
def test_a_file_from_some_frame_on_is_the_rest_of_the_whole(tmp_path, subtype):
    source = sound(tmp_path / "in.wav", noise(50_000, 2), 8_000, subtype=subtype)
    whole, rest = FileTap(source), FileTap(source, first=12_345)
    assert whole.divisible
    assert np.array_equal(frames_of(rest), frames_of(whole)[12_345:])
    assert whole.warnings == rest.warnings == []
    with pytest.raises(UsageError, match="60000"):
        FileTap(source, first=60_000)


def test_a_file_whose_parts_are_not_exact_is_not_divisible(tmp_path):
    packed = sound(tmp_path / "a.ogg", noise(20_000), 8_000, format="OGG", subtype="VORBIS")
    tap = FileTap(packed)
    assert not tap.divisible
    tap.close()
