"""Several actuators: routing, level, polarity, delay, their own rigs, and their channels."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from device.drive import ActuatorSettings, ChannelMap, Spread, channels_needed, sources_of
from device.drive.actuators import Actuators
from device.drive.alignment import Aligned
from device.drive.driven import Driven
from device.drive.driving import driving_for
from device.drive.path import FADE_S
from device.drive.twins import Twins, twins_for
from device.errors import InternalError, UsageError
from device.rig import PAPER
from device.rig.twin import Twin

RATE = 8_000
LEFT = ActuatorSettings((0,), "left")
RIGHT = ActuatorSettings((1,), "right")


def noise(frames, columns, seed=1):
    values = np.random.default_rng(seed).uniform(-0.5, 0.5, (frames, columns))
    return values.astype(np.float32)


def tone(hz, seconds, level=0.5):
    return level * np.sin(2.0 * np.pi * hz * np.arange(round(seconds * RATE)) / RATE)


def cut(signal, lengths):
    """The signal in blocks of these lengths, over and over."""
    start, turn = 0, 0
    while start < len(signal):
        stop = start + lengths[turn % len(lengths)]
        yield signal[start:stop]
        start, turn = stop, turn + 1


class Kept:
    """An output that keeps everything."""

    def __init__(self, channels, samplerate=RATE):
        self.channels, self.samplerate, self.blocks = channels, samplerate, []
        self.closed = self.aborted = False

    def write(self, vibration):
        self.blocks.append(np.array(vibration))

    def close(self):
        self.closed = True

    def abort(self):
        self.aborted = True

    @property
    def whole(self):
        return np.concatenate(self.blocks)


def test_an_actuator_without_wishes_gets_its_source_bit_for_bit_and_at_once():
    vibration = noise(9_000, 2)
    actuators = Actuators([RIGHT, LEFT], RATE)
    assert actuators.sources == ("left", "right")
    assert actuators.latency_frames == 0
    assert np.array_equal(actuators.process(vibration), vibration[:, ::-1])


def test_level_polarity_and_delay_are_those_asked_for():
    one = ActuatorSettings((0,), "mix", gain_db=-6.0, polarity="inverted", delay_ms=12.5)
    vibration = noise(3_000, 1)
    out = Actuators([one], RATE).process(vibration)
    late = round(12.5e-3 * RATE)
    assert not out[:late].any()
    expected = -(10.0 ** (-6.0 / 20.0)) * vibration[:-late].astype(float)
    np.testing.assert_allclose(out[late:], expected, atol=1e-7)  # float32 of what is below 0.5


@settings(max_examples=40, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 700), min_size=1, max_size=6),
    delays=st.tuples(st.floats(0.0, 500.0), st.floats(0.0, 500.0)),
    gain_db=st.floats(-60.0, 0.0),
    protection=st.sampled_from(["off", "on"]),
)
def test_no_byte_depends_on_how_the_stream_is_cut(lengths, delays, gain_db, protection):
    wanted = [
        ActuatorSettings((0,), "left", delay_ms=delays[0], gain_db=gain_db, protection=protection),
        ActuatorSettings((1,), "right", delay_ms=delays[1], polarity="inverted"),
        ActuatorSettings((2,), "mix"),
    ]
    vibration = noise(5_000, 3)
    whole = Actuators(wanted, RATE).process(vibration)
    actuators = Actuators(wanted, RATE)
    parts = [actuators.process(part) for part in cut(vibration, lengths)]
    assert np.concatenate(parts).tobytes() == whole.tobytes()


@settings(max_examples=40, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 300), min_size=1, max_size=6),
    delay_ms=st.floats(0.0, 100.0),
    gain_db=st.floats(-60.0, 0.0),
    source=st.sampled_from(["left", "right"]),
    again_after=st.integers(1, 150),
)
def test_a_change_comes_out_the_same_however_the_stream_is_cut(
    lengths, delay_ms, gain_db, source, again_after
):
    vibration = noise(2_000, 2)
    first = [ActuatorSettings((0,), source, gain_db=gain_db, delay_ms=delay_ms), RIGHT]
    second = [ActuatorSettings((0,), "left", polarity="inverted"), RIGHT]

    def through(lengths):
        actuators = Actuators([LEFT, RIGHT], RATE)
        out = [actuators.process(part) for part in cut(vibration[:500], lengths)]
        actuators.change(first)
        middle = 500 + again_after
        out += [actuators.process(part) for part in cut(vibration[500:middle], lengths)]
        actuators.change(second)
        out += [actuators.process(part) for part in cut(vibration[middle:], lengths)]
        return np.concatenate(out)

    assert through(lengths).tobytes() == through([10_000]).tobytes()


@pytest.mark.parametrize(
    "changed",
    [
        ActuatorSettings((0,), "left", gain_db=-20.0),
        ActuatorSettings((0,), "left", polarity="inverted"),
        ActuatorSettings((0,), "left", delay_ms=7.3),
        ActuatorSettings((0,), "right"),
    ],
    ids=["level", "polarity", "delay", "source"],
)
def test_a_change_makes_no_step_and_is_done_within_its_time(changed):
    wave = tone(60.0, 1.0).astype(np.float32)
    vibration = np.column_stack([wave, -wave])
    actuators = Actuators([LEFT, RIGHT, LEFT], RATE)
    before = actuators.process(vibration[:4_001])
    actuators.change([changed, RIGHT, LEFT])
    after = actuators.process(vibration[4_001:])
    heard = np.concatenate([before, after])[:, 0].astype(float)
    done = 4_001 + round(FADE_S * RATE)
    settled = Actuators([changed, RIGHT, LEFT], RATE).process(vibration)[:, 0]
    np.testing.assert_allclose(heard[done:], settled[done:], atol=1e-7)
    steepest = np.abs(np.diff(wave.astype(float))).max()
    # From one end of the wave to the other in a straight line over the fade, on top of the wave.
    assert np.abs(np.diff(heard)).max() < steepest + 1.01 / (FADE_S * RATE)
    assert np.array_equal(heard[:4_001], vibration[:4_001, 0])


def test_of_several_changes_within_a_fade_the_last_one_stays():
    wave = tone(60.0, 1.0).astype(np.float32)[:, None]
    actuators = Actuators([ActuatorSettings((0,))], RATE)
    for delay_ms in (3.0, 90.0, 20.0):
        actuators.process(wave[:10])
        actuators.change([ActuatorSettings((0,), delay_ms=delay_ms)])
    actuators.process(wave[:1_000])
    heard = actuators.process(wave[1_000:])
    late = round(20e-3 * RATE)
    assert np.array_equal(heard[late:], wave[1_000:-late])


def test_who_needs_no_protection_waits_for_those_who_do():
    wanted = [
        ActuatorSettings((0,), "left", protection="on"),
        ActuatorSettings((1,), "left"),
        ActuatorSettings((2,), "left", delay_ms=10.0, protection="on"),
    ]
    actuators = Actuators(wanted, RATE)
    late = actuators.latency_frames
    assert late == 2 * round(0.002 * RATE)
    assert actuators.delays_frames == (0, 0, 80)
    vibration = 0.1 * noise(2_000, 1)
    out = actuators.process(vibration)
    assert np.array_equal(out[late:, 0], vibration[:-late, 0])
    assert np.array_equal(out[:, 0], out[:, 1])
    assert np.array_equal(out[80:, 2], out[:-80, 0])


def test_what_is_owed_is_everything_with_the_longest_delay():
    wanted = [
        ActuatorSettings((0,), "left", protection="on"),
        ActuatorSettings((1,), "right", delay_ms=25.0),
    ]
    vibration = 0.1 * noise(1_000, 2)
    actuators = Actuators(wanted, RATE)
    whole = np.concatenate([actuators.process(vibration), actuators.owed()])
    late = actuators.latency_frames
    assert np.array_equal(whole[late : late + 1_000, 0], vibration[:, 0])
    assert np.array_equal(whole[late + 200 :, 1], vibration[:, 1])


def test_each_has_the_rig_and_the_care_of_its_own():
    wanted = [
        ActuatorSettings((0,), "mix", rig="consumer", protection="on"),
        ActuatorSettings((1,), "mix", damping="auto", exposure_cap="limit"),
        ActuatorSettings((2,), "mix", protection="off", exposure_cap="off"),
    ]
    actuators = Actuators(wanted, RATE, rig="paper", protection="on", exposure_cap="action")
    vibration = tone(45.0, 0.5, 1.0).astype(np.float32)[:, None]
    out = actuators.process(vibration)
    consumer, damped, plain = actuators.drivings
    assert consumer is not None
    assert damped is not None
    assert (consumer.rig.name, damped.rig.name, plain) == ("consumer", "paper", None)
    assert (consumer.exposure_cap, damped.exposure_cap) == ("action", "limit")
    alone = driving_for("consumer", RATE, 1, protection="on")
    assert alone is not None
    assert np.array_equal(out[:, :1], alone.process(vibration.astype(float)).astype(np.float32))
    assert consumer.protection() == alone.protection()
    assert consumer.protection().least_gain != damped.protection().least_gain


def test_protection_sees_what_is_left_after_the_level():
    loud = tone(45.0, 0.5, 1.0).astype(np.float32)[:, None]

    def least_gain(gain_db):
        one = ActuatorSettings((0,), rig="consumer", protection="on", gain_db=gain_db)
        actuators = Actuators([one], RATE)
        actuators.process(loud)
        driving = actuators.drivings[0]
        assert driving is not None
        return driving.protection().least_gain

    assert least_gain(0.0) < 1.0
    assert least_gain(-40.0) == 1.0


def test_what_is_flushed_never_comes_out():
    actuators = Actuators([ActuatorSettings((0,), delay_ms=100.0, protection="on")], RATE)
    actuators.process(noise(2_000, 1))
    actuators.flush()
    assert not actuators.process(np.zeros((2_000, 1), np.float32)).any()


def test_sources_are_named_once_in_their_order_and_all_is_the_mix():
    assert ActuatorSettings((0,), "all").source == "mix"
    assert sources_of([RIGHT, LEFT, RIGHT, ActuatorSettings((3,), "all")]) == (
        "mix",
        "left",
        "right",
    )


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"channels": ()}, "channels=.* names no channel"),
        ({"channels": (0, 0)}, "names a channel twice"),
        ({"channels": (-1,)}, "no channel; allowed: .*counted from 0"),
        ({"channels": (True,)}, "no channel"),
        ({"channels": (0,), "source": "middle"}, "source='middle' is not known; allowed: mix"),
        ({"channels": (0,), "gain_db": 1.0}, "gain_db=1.0 is out of range; allowed: -60 to 0 dB"),
        ({"channels": (0,), "delay_ms": 501}, "delay_ms=501 is out of range; allowed: 0 to 500"),
        ({"channels": (0,), "delay_ms": float("nan")}, "delay_ms=nan is out of range"),
        ({"channels": (0,), "polarity": "up"}, "polarity='up'"),
        ({"channels": (0,), "damping": "on"}, "damping='on'"),
        ({"channels": (0,), "protection": 1}, "protection=1"),
    ],
)
def test_what_one_actuator_cannot_have_is_refused(choices, words):
    with pytest.raises(UsageError, match=words):
        ActuatorSettings(**choices)


def test_other_actuators_and_blocks_of_another_shape_are_refused():
    actuators = Actuators([LEFT], RATE)
    with pytest.raises(InternalError, match="cannot follow"):
        actuators.change([LEFT, RIGHT])
    with pytest.raises(InternalError, match="cannot follow"):
        actuators.change([RIGHT])
    with pytest.raises(InternalError, match="shape"):
        actuators.process(np.zeros((10, 2), np.float32))
    with pytest.raises(UsageError, match="'loud'"):
        Actuators([ActuatorSettings((0,), rig="loud", protection="on")], RATE)


def test_actuators_reach_the_channels_they_are_wired_to_and_others_stay_silent():
    vibration = np.array([[1.0, 2.0], [3.0, 4.0]], np.float32)
    out = np.full((2, 5), 9.0, np.float32)
    ChannelMap.of([[3, 0], [1]], 5).spread(vibration, out)
    assert out.tolist() == [[1.0, 2.0, 0.0, 1.0, 0.0], [3.0, 4.0, 0.0, 3.0, 0.0]]


def test_without_wiring_actuators_repeat_over_all_channels():
    assert ChannelMap.repeated(2, 5) == ChannelMap(2, (0, 1, 0, 1, 0))
    assert ChannelMap.repeated(1, 2).channels == 2


def test_channels_go_by_the_names_that_the_device_has_for_them():
    positions = ("front-left", "front-right", "lfe")
    assert ChannelMap.of([["lfe"], [0]], 3, positions).sources == (1, None, 0)
    assert channels_needed([["lfe"], [0, 4]]) == 5
    assert channels_needed([["lfe"]]) == 1


@pytest.mark.parametrize(
    ("wired", "words"),
    [
        (
            [[0], [2]],
            "actuator 2 wants channel 2, but the card .* has 2, counted from 0: 0 to 1",
        ),
        ([[0], [-1]], "wants channel -1"),
        ([[0], []], "actuator 2 has no channel"),
        ([[0], [0]], "actuator 2 wants channel 0, which drives actuator 1"),
        ([["lfe"]], "wants channel lfe.* it has front-left, front-right"),
        ([["front-left"], [0]], "actuator 2 wants channel 0, which drives actuator 1"),
    ],
)
def test_wiring_that_cannot_be_is_refused(wired, words):
    with pytest.raises(UsageError, match=words):
        ChannelMap.of(wired, 2, ("front-left", "front-right"), "the card")


def test_another_wiring_fades_in_over_one_block():
    def fill(out, now_s):
        out[:] = (0.5, -0.25)

    spread = Spread(fill, ChannelMap.of([[0], [1]], 3), 64)
    out = np.zeros((64, 3), np.float32)
    spread.fill(out, 0.0)
    assert np.array_equal(out, np.tile(np.array([0.5, -0.25, 0.0], np.float32), (64, 1)))
    spread.change(ChannelMap.of([[2], [0]], 3))
    spread.fill(out, 0.0)
    # 0.75 from one level to the other, in 64 steps
    assert np.abs(np.diff(out, axis=0)).max() == pytest.approx(0.75 / 64, rel=1e-3)
    assert np.array_equal(out[-1], np.array([-0.25, 0.0, 0.5], np.float32))
    spread.fill(out, 0.0)
    assert np.array_equal(out, np.tile(np.array([-0.25, 0.0, 0.5], np.float32), (64, 1)))
    with pytest.raises(InternalError, match="cannot follow"):
        spread.change(ChannelMap.of([[0], [1]], 2))


def test_files_have_what_each_channel_would_get_under_its_sound_and_as_long_as_it():
    wanted = [
        ActuatorSettings((2,), "left", protection="on", delay_ms=5.0),
        ActuatorSettings((0,), "right", polarity="inverted"),
    ]
    channel_map = ChannelMap.of([actuator.channels for actuator in wanted], 3)
    kept = Kept(3)
    actuators = Actuators(wanted, RATE)
    output = Driven(Aligned(kept, actuators.latency_frames), actuators, channel_map)
    vibration = 0.1 * noise(1_000, 2)
    for part in cut(vibration, [300, 77]):
        output.write(part)
    output.close()
    assert kept.closed
    assert kept.whole.shape == (1_000, 3)
    assert np.array_equal(kept.whole[:, 0], -vibration[:, 1])
    assert not kept.whole[:, 1].any()
    assert np.array_equal(kept.whole[40:, 2], vibration[:-40, 0])
    with pytest.raises(InternalError, match="closed"):
        output.write(vibration)


def test_simulated_rigs_stand_where_the_actuators_are_wired():
    wanted = [ActuatorSettings((2,), "left", rig="consumer"), ActuatorSettings((0,), "right")]
    channel_map = ChannelMap.of([actuator.channels for actuator in wanted], 3)
    kept, alone = Kept(3), Kept(1)
    twins = twins_for(wanted, channel_map, RATE, rig="paper", recorder=kept)
    twin = Twin(PAPER, RATE, 1, recorder=alone)
    vibration = noise(2_000, 3)
    for part in cut(vibration, [256]):
        twins.write(part)
        twin.write(part[:, :1])
    twins.close()
    assert kept.closed
    assert np.array_equal(kept.whole[:, 0], alone.whole[:, 0])
    assert not kept.whole[:, 1].any()
    assert not np.array_equal(kept.whole[:, 2], kept.whole[:, 0])
    assert twins.peak_acceleration_m_s2 >= twin.peak_acceleration_m_s2
    assert twins.peak_displacement_m >= twin.peak_displacement_m
    assert Twins([None], RATE).peak_current_a == 0.0
