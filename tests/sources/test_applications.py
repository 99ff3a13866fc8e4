import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.sources import VoicesClient
from audioflinger_hook.sources.applications import PACE_LOST_S, WAITING_S
from tests.support.taps import mixed as cycles
from tests.support.taps import mixer_for, noise

RATE_HZ = 48_000
BLOCK = 256
BLOCK_S = BLOCK / RATE_HZ


def a_mix(*names):
    client = VoicesClient(RATE_HZ, 1)
    return mixer_for(client), client, [client.add(name) for name in names]


def mixed(mixer, client):
    return np.concatenate([level(0.0, 0), *cycles(client, mixer)])[:, 0]


def level(value, count=BLOCK):
    return np.full((count, 1), value, np.float32)


def test_one_voice_passes_bit_for_bit_and_a_second_is_added_a_block_late_at_most():
    mixer, client, (voice,) = a_mix("player")
    counts, sound, parts = np.cumsum([256, 7, 1, 960, 5_000, 333]), noise(7_000, 1), []
    for part in np.split(sound, counts):
        client.push(voice, part, 0.0)
        parts.append(mixed(mixer, client))
    np.testing.assert_array_equal(np.concatenate(parts), sound[:, 0])
    mixer, client, (one, other) = a_mix("one", "other")
    heard = []
    for block in range(20):
        client.push(one, level(0.25), block * BLOCK_S)
        heard.append(mixed(mixer, client))
        client.push(other, level(0.5), block * BLOCK_S)
        assert not client.pending_frames
    assert (heard[0] == 0.25).all()
    assert (np.array(heard[1:]) == 0.75).all()


def test_when_the_voice_that_set_the_pace_is_silent_or_removed_another_does():
    mixer, client, (one, other) = a_mix("one", "other")
    client.push(one, level(0.25), 0.0)
    mixed(mixer, client)
    client.push(other, level(0.5), PACE_LOST_S / 2)
    assert not client.pending_frames
    client.push(other, level(0.5), PACE_LOST_S * 1.1)
    assert mixed(mixer, client)[-1] == 0.5
    mixer, client, (one, other) = a_mix("one", "other")
    client.push(one, level(0.25), 0.0)
    mixed(mixer, client)
    client.remove(one)
    client.push(other, level(0.5), BLOCK_S)
    assert (mixed(mixer, client)[-1], len(mixer.cycle(1.0, BLOCK).buffer.audio)) == (0.5, BLOCK)


def test_what_waits_longer_than_it_should_is_dropped_and_counted():
    mixer, client, (one, other) = a_mix("one", "other")
    client.push(one, level(0.25), 0.0)
    for _ in range(100):
        client.push(other, level(0.5), 0.01)
    assert other.frames <= WAITING_S * RATE_HZ + BLOCK
    assert (other.frames + other.dropped, mixed(mixer, client)[-1]) == (100 * BLOCK, 0.75)


pushes = st.tuples(st.integers(0, 2), st.integers(1, 3_000), st.floats(0.0, 0.1))


@settings(max_examples=50)
@given(st.lists(pushes, max_size=40))
def test_no_order_of_buffers_loses_a_cycle(calls):
    mixer, client, voices = a_mix("a", "b", "c")
    now_s = paced = heard = 0
    for number, count, seconds in calls:
        now_s += seconds
        client.push(voices[number], level(0.1, count), now_s)
        paced = paced + count if client.pending_frames else paced
        samples = mixed(mixer, client)
        heard += len(samples)
        assert np.abs(samples).max(initial=0.0) < 0.31
    assert heard == paced


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_is_due_before_anything_came(count):
    _, client, _ = a_mix(*["voice"] * count)
    assert client.play() is None
    client.close()
