from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from audioflinger_hook.drive.drive import Drive
from device.drive import ActuatorSettings, ChannelMap, channels_needed, sources_of
from device.drive.channel_router import ChannelRouter, RoutedFill
from device.drive.outputs import AlignedOutput, DrivenOutput
from device.errors import InternalError, UsageError
from device.rig import CONSUMER, PAPER
from device.rig.simulated_rig import SimulatedRig
from tests.support.outputs import KeptOutput
from tests.support.signals import tone
from tests.support.taps import noise
from tools.rig_driver import RigDriver

RATE = 8_000
FADE_S = 0.04
LEFT = ActuatorSettings((0,), "left")
RIGHT = ActuatorSettings((1,), "right")


def cut(signal, lengths):
    start, turn = 0, 0
    while start < len(signal):
        stop = start + lengths[turn % len(lengths)]
        yield signal[start:stop]
        start, turn = stop, turn + 1


def test_an_actuator_gets_its_source_bit_for_bit_and_the_level_polarity_and_delay_it_asks_for():
    vibration, drive = noise(9_000, 2), Drive([RIGHT, LEFT], RATE)
    assert (drive.sources, drive.latency_frames) == (("left", "right"), 0)
    assert np.array_equal(drive.process(vibration), vibration[:, ::-1])
    one = ActuatorSettings((0,), "mix", gain_db=-6.0, polarity="inverted", delay_ms=12.5)
    vibration = noise(3_000, 1)
    out, late = Drive([one], RATE).process(vibration), round(12.5e-3 * RATE)
    assert not out[:late].any()
    expected = -(10.0 ** (-6.0 / 20.0)) * vibration[:-late].astype(float)
    np.testing.assert_allclose(out[late:], expected, atol=1e-7)  # float32 of what is below 0.5


@settings(max_examples=40, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 700), min_size=1, max_size=6),
    delays=st.tuples(st.floats(0.0, 500.0), st.floats(0.0, 500.0)),
    gain_db=st.floats(-60.0, 0.0),
    source=st.sampled_from(["left", "right"]),
    protection=st.sampled_from(["off", "on"]),
    again_after=st.integers(1, 150),
)
def test_no_byte_depends_on_the_cuts(lengths, delays, gain_db, source, protection, again_after):
    care = {"protection": protection}
    settings = [
        [ActuatorSettings((0,), "left", delay_ms=delays[0], **care), RIGHT],
        [ActuatorSettings((0,), source, gain_db=gain_db, delay_ms=delays[1], **care), RIGHT],
        [ActuatorSettings((0,), "left", polarity="inverted", **care), RIGHT],
    ]
    parts = np.split(noise(5_000, 2), [1_500, 1_500 + again_after])

    def through(lengths):
        drive, out = Drive(settings[0], RATE), []
        for chosen, part in zip(settings, parts, strict=True):
            drive.change(chosen)
            out += [drive.process(block) for block in cut(part, lengths)]
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
    wave = tone(60.0, 1.0, RATE, 0.5).astype(np.float32)
    vibration, drive = np.column_stack([wave, -wave]), Drive([LEFT, RIGHT, LEFT], RATE)
    before = drive.process(vibration[:4_001])
    drive.change([changed, RIGHT, LEFT])
    heard = np.concatenate([before, drive.process(vibration[4_001:])])[:, 0].astype(float)
    done = 4_001 + round(FADE_S * RATE)
    settled = Drive([changed, RIGHT, LEFT], RATE).process(vibration)[:, 0]
    np.testing.assert_allclose(heard[done:], settled[done:], atol=1e-7)
    steepest = np.abs(np.diff(wave.astype(float))).max()
    # From one end of the wave to the other, on top of the wave. The steepest slope of the fade is
    # 15 / 8 of the mean.
    assert np.abs(np.diff(heard)).max() < steepest + 15 / 8 / (FADE_S * RATE)
    assert np.array_equal(heard[:4_001], vibration[:4_001, 0])


def test_of_several_changes_within_a_fade_the_last_one_stays():
    wave = tone(60.0, 1.0, RATE, 0.5).astype(np.float32)[:, None]
    drive = Drive([ActuatorSettings((0,))], RATE)
    for delay_ms in (3.0, 90.0, 20.0):
        drive.process(wave[:10])
        drive.change([ActuatorSettings((0,), delay_ms=delay_ms)])
    drive.process(wave[:1_000])
    heard, late = drive.process(wave[1_000:]), round(20e-3 * RATE)
    assert np.array_equal(heard[late:], wave[1_000:-late])


def test_a_level_that_changes_again_before_it_is_reached_has_no_bend():
    drive, heard = Drive([ActuatorSettings((0,))], RATE), []
    for gain_db in (0.0, -40.0, 0.0, -6.0, -3.0):
        drive.change([ActuatorSettings((0,), gain_db=gain_db)])
        heard.append(drive.process(np.ones((123, 1), np.float32)))
    bend = np.abs(np.diff(np.concatenate(heard)[:, 0].astype(float), 2)).max()
    assert bend < 6.0 / (FADE_S * RATE) ** 2 * 1.1  # that of a whole fade, and float32's rounding


def test_who_needs_no_protection_waits_for_those_who_do():
    wanted = [
        ActuatorSettings((0,), "left", protection="on"),
        ActuatorSettings((1,), "left"),
        ActuatorSettings((2,), "left", delay_ms=10.0, protection="on"),
    ]
    drive = Drive(wanted, RATE)
    late = drive.latency_frames
    assert (late, drive.delays_frames) == (2 * round(0.002 * RATE), (0, 0, 80))
    vibration = 0.1 * noise(2_000, 1)
    out = np.concatenate([drive.process(vibration), drive.drain()])
    assert len(out) == 2_000 + late + 80, "the longest delay is drained, too"
    assert np.array_equal(out[late : late + 2_000, 0], vibration[:, 0])
    assert np.array_equal(out[:, 0], out[:, 1])
    assert np.array_equal(out[80:, 2], out[:-80, 0])


def test_each_has_the_rig_and_the_care_of_its_own():
    wanted = [
        ActuatorSettings((0,), "mix", rig="consumer", protection="on"),
        ActuatorSettings((1,), "mix", damping="auto", exposure_cap="limit"),
        ActuatorSettings((2,), "mix", protection="off", exposure_cap="off"),
    ]
    drive = Drive(wanted, RATE, rig="paper", protection="on", exposure_cap="action")
    vibration = tone(45.0, 0.5, RATE).astype(np.float32)[:, None]
    out = drive.process(vibration)
    processors: Any = drive.processors
    consumer, damped, plain = processors
    assert (consumer.rig.name, damped.rig.name, plain) == ("consumer", "paper", None)
    assert (consumer.exposure_cap, damped.exposure_cap) == ("action", "limit")
    alone = RigDriver(CONSUMER, RATE)
    assert np.array_equal(out[:, :1], alone.process(vibration))
    assert consumer.protection() == alone.protection()
    assert consumer.protection().least_gain != damped.protection().least_gain


@pytest.mark.parametrize(("gain_db", "is_limited"), [(0.0, True), (-40.0, False)])
def test_protection_sees_what_is_left_after_the_level(gain_db, is_limited):
    drive = Drive([ActuatorSettings((0,), rig="consumer", protection="on", gain_db=gain_db)], RATE)
    drive.process(tone(45.0, 0.5, RATE).astype(np.float32)[:, None])
    processor: Any = drive.processors[0]
    assert (processor.protection().least_gain < 1.0) == is_limited


def test_what_is_flushed_never_comes_out():
    drive = Drive([ActuatorSettings((0,), delay_ms=100.0, protection="on")], RATE)
    drive.process(noise(2_000, 1))
    drive.flush()
    assert not drive.process(np.zeros((2_000, 1), np.float32)).any()


def test_sources_are_named_once_in_their_order_and_all_is_the_mix():
    every = ActuatorSettings((3,), "all")
    assert every.source == "mix"
    assert sources_of([RIGHT, LEFT, RIGHT, every]) == ("mix", "left", "right")


@pytest.mark.parametrize(
    ("choices", "words"),
    [
        ({"channels": ()}, "channels=.* is an empty list"),
        ({"channels": (0, 0)}, "names a channel twice"),
        ({"channels": (-1,)}, "not a list of channels; allowed: .*counted from 0"),
        ({"channels": (True,)}, "not a list of channels"),
        ({"channels": (0,), "source": "middle"}, "source='middle' is not known; allowed: mix"),
        ({"channels": (0,), "gain_db": 1.0}, "gain_db=1 is out of range; allowed: -60 to 0 dB"),
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
    drive = Drive([LEFT], RATE)
    for others in ([LEFT, RIGHT], [RIGHT]):
        with pytest.raises(InternalError, match="cannot change"):
            drive.change(others)
    with pytest.raises(InternalError, match="shape"):
        drive.process(np.zeros((10, 2), np.float32))


def test_actuators_reach_the_channels_they_are_wired_to_and_others_stay_silent():
    vibration = np.array([[1.0, 2.0], [3.0, 4.0]], np.float32)
    out = np.full((2, 5), 9.0, np.float32)
    ChannelMap.of([[3, 0], [1]], 5).write(vibration, out)
    assert out.tolist() == [[1.0, 2.0, 0.0, 1.0, 0.0], [3.0, 4.0, 0.0, 3.0, 0.0]]
    # Without wiring they repeat.
    assert ChannelMap.repeated(2, 5) == ChannelMap(2, (0, 1, 0, 1, 0))

    # Channels may go by the names that the device has for them.
    positions = ("front-left", "front-right", "lfe")
    assert ChannelMap.of([["lfe"], [0]], 3, positions).sources == (1, None, 0)
    assert (channels_needed([["lfe"], [0, 4]]), channels_needed([["lfe"]])) == (5, 1)


@pytest.mark.parametrize(
    ("wired", "words"),
    [
        ([[0], [2]], "actuator 2 wants channel 2, but the card .* has 2, counted from 0: 0 to 1"),
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

    routed = RoutedFill(fill, ChannelMap.of([[0], [1]], 3), 64)
    out = np.zeros((64, 3), np.float32)
    routed.fill(out, 0.0)
    assert (out == [0.5, -0.25, 0.0]).all()
    routed.change(ChannelMap.of([[2], [0]], 3))
    routed.fill(out, 0.0)
    # 0.75 from one level to the other, in 64 steps
    assert np.abs(np.diff(out, axis=0)).max() == pytest.approx(0.75 / 64, rel=1e-3)
    assert (out[-1] == [-0.25, 0.0, 0.5]).all()
    routed.fill(out, 0.0)
    assert (out == [-0.25, 0.0, 0.5]).all()
    with pytest.raises(InternalError, match="cannot replace"):
        routed.change(ChannelMap.of([[0], [1]], 2))


def test_files_have_what_each_channel_would_get_under_its_sound_and_as_long_as_it():
    wanted = [
        ActuatorSettings((2,), "left", protection="on", delay_ms=5.0),
        ActuatorSettings((0,), "right", polarity="inverted"),
    ]
    channel_map = ChannelMap.of([actuator.channels for actuator in wanted], 3)
    kept, drive = KeptOutput(RATE, 3), Drive(wanted, RATE)
    output = DrivenOutput(AlignedOutput(kept, drive.latency_frames), drive, channel_map)
    vibration = 0.1 * noise(1_000, 2)
    for part in cut(vibration, [300, 77]):
        before = part.copy()
        output.write(part)
        assert np.array_equal(part, before)
    output.close()
    assert (output.samplerate, output.channels, kept.ended) == (RATE, 2, ["closed"])
    assert kept.whole.shape == (1_000, 3)
    assert np.array_equal(kept.whole[:, 0], -vibration[:, 1])
    assert not kept.whole[:, 1].any()
    assert np.array_equal(kept.whole[40:, 2], vibration[:-40, 0])
    with pytest.raises(InternalError, match="closed"):
        output.write(vibration)


def test_an_aborted_output_takes_nothing_more_and_a_channel_map_must_fit():
    kept, drive = KeptOutput(RATE, 2), Drive((), RATE, 2, protection="on")
    output = DrivenOutput(kept, drive, ChannelMap.repeated(2, 2))
    output.abort()
    assert kept.ended == ["aborted"]
    with pytest.raises(InternalError, match="closed"):
        output.write(noise(100, 2))
    output.close()
    assert not kept.blocks
    with pytest.raises(InternalError, match="2 channels, the channel map 3"):
        DrivenOutput(kept, drive, ChannelMap.repeated(2, 3))


def test_each_channel_moves_its_own_simulated_rig_or_none():
    wired, vibration = [PAPER, None, CONSUMER, PAPER], 1.5 * noise(2_000, 4)
    kept = KeptOutput(RATE, 4)
    rigs = SimulatedRig(wired, RATE, recorder=kept)
    for part in cut(vibration, [256]):
        rigs.write(part)
    rigs.close()
    assert kept.ended == ["closed"]
    for channel, rig in enumerate(wired):
        record = KeptOutput(RATE)
        one = SimulatedRig([rig], RATE, recorder=record)
        one.write(vibration[:, [channel]])
        assert np.array_equal(kept.whole[:, channel], record.whole[:, 0])
        assert rigs.peak_acceleration_m_s2 >= one.peak_acceleration_m_s2
        assert rigs.peak_displacement_m >= one.peak_displacement_m
    assert not kept.whole[:, 1].any()
    assert SimulatedRig([None], RATE).peak_current_a == 0.0


@given(
    frames=st.integers(0, 300),
    channels=st.integers(1, 8),
    lengths=st.lists(st.integers(1, 90), min_size=1, max_size=6),
    seed=st.integers(0, 2**32 - 1),
)
def test_without_a_wish_the_drive_is_the_identity_without_a_copy(frames, channels, lengths, seed):
    drive = Drive((), RATE, channels)
    bits = np.random.default_rng(seed).integers(0, 2**32, (frames, channels), np.uint32)
    for part in cut(bits.view(np.float32), lengths):  # any bits: infinities and NaNs too
        before, out = part.tobytes(), drive.process(part)
        assert out is part
        assert out.tobytes() == before
    assert (drive.latency_frames, drive.drain().shape) == (0, (0, channels))


@pytest.mark.parametrize("asked", [{"protection": "on"}, {"damping": "auto"}])
def test_one_actuator_for_the_mix_plays_what_an_unnamed_one_does(asked):
    vibration = noise(6_000, 1).astype(np.float64)
    named = Drive([ActuatorSettings((0,))], RATE, **asked)
    unnamed = Drive((), RATE, 1, **asked)
    whole = np.concatenate([unnamed.process(vibration), unnamed.drain()])
    routed = np.concatenate([named.process(vibration), named.drain()])
    assert routed.tobytes() == whole.astype(np.float32).tobytes()


def test_an_unnamed_actuator_has_one_protection_for_all_channels_of_the_vibration():
    drive = Drive((), RATE, 2, protection="on")
    assert (len(drive.processors), drive.inputs, drive.outputs) == (1, 2, 2)
    vibration = noise(1_000, 2)
    out = np.concatenate([drive.process(part) for part in cut(vibration, [77])])
    late = drive.latency_frames
    assert np.array_equal(out[late:], vibration[:-late])
    assert np.array_equal(drive.drain(), vibration[-late:])


@pytest.mark.parametrize(("sources", "is_shared"), [(1, True), (3, True), (2, False)])
def test_a_direct_map_lets_the_device_be_filled_without_a_copy(sources, is_shared):
    out, shared = np.zeros((64, 3), np.float32), []

    def fill(filled, now_s):
        shared.append(np.shares_memory(filled, out))
        filled[:] = 0.25

    ChannelRouter(()).connect(fill, ChannelMap.repeated(sources, 3), 64)(out, 0.0)
    assert (shared, (out == 0.25).all()) == ([is_shared], True)
