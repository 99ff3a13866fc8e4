"""No bytes make the descriptor parser raise anything but its own error, nor take long."""

import gc
import random
import resource
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from device.usb.descriptors import parse_configuration, parse_whole, playback_formats
from device.usb.descriptors.blocks import DescriptorError
from tests.support import usb_builder as usb
from tests.support.usb_shapes import SHAPES

WHOLE = tuple(SHAPES.values())
PLACES = {raw: [raw.index(part) for part in usb.split(raw)] for raw in WHOLE}

INPUTS_EACH = 100
"""Of one seed; 10 000 together."""
SOAK_INPUTS = 1_000_000


def exercise(raw: bytes) -> bool:
    """Read and play bytes; return whether they begin with a configuration."""
    try:
        configuration = parse_configuration(raw)
    except DescriptorError:
        return False
    assert configuration.raw == raw
    playback_formats(configuration)
    whole = parse_whole(raw)
    assert b"".join(one.raw for one in whole.configurations) + whole.rest == whole.raw == raw
    whole.active(None)
    return True


def mutated(chance: random.Random) -> bytes:
    """A device's bytes with one to four changes, such as firmware, cables and files make them."""
    shape = chance.choice(WHOLE)
    raw = bytearray(shape)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(raw) + 1)
        to = min(len(raw), at + chance.randrange(40))
        match chance.randrange(4):
            case 0 if at < len(raw):
                changed = raw[at] ^ 1 << chance.randrange(8), chance.randrange(256)
                raw[at] = chance.choice((0, 1, 2, 0x7F, 0x80, 0xFF, *changed))
            case 1:  # a part is missing, is there twice, or is another one
                other = chance.choice(WHOLE)[chance.randrange(200) :]
                made = chance.randbytes(chance.randrange(12))
                put = chance.choice((b"", b"", 2 * raw[at:to], other[: chance.randrange(60)], made))
                raw[at : chance.choice((at, to, to, len(raw)))] = put
            case 2:  # bLength, bDescriptorType, bDescriptorSubtype, an id or a count
                place = chance.choice(PLACES[shape]) + chance.choice((0, 0, 0, 1, 2, 3, 4, 5))
                if place < len(raw):
                    raw[place] = chance.randrange(256) if chance.random() < 0.3 else place % 24
            case _:  # two descriptors change places
                parts = usb.split(shape)
                first, second = chance.randrange(len(parts)), chance.randrange(len(parts))
                parts[first], parts[second] = parts[second], parts[first]
                raw = bytearray(b"".join(parts))
        raw = raw or bytearray(shape)
    return bytes(raw)


def made_up(chance: random.Random) -> bytes:
    """Descriptors of plausible types, of any length and content, behind a right beginning."""
    parts = []
    for _ in range(chance.randrange(30)):
        descriptor_type = chance.choice((0x04, 0x05, 0x0B, 0x24, 0x24, 0x24, 0x25, 0x30, 0x41))
        body = bytearray(chance.choices(range(16), k=chance.randrange(24)))
        if descriptor_type == 0x04 and len(body) > 5:
            body[3:6] = 1, chance.choice((1, 2, 3)), chance.choice((0, 0x20, 0x30))
        parts.append(usb.descriptor(descriptor_type, bytes(body)))
    return usb.configuration_of(b"".join(parts), chance.randrange(4))


def inputs(seed: int) -> Iterator[bytes]:
    """Endlessly one of each kind, the same for the same seed."""
    chance = random.Random(seed)
    while True:
        yield mutated(chance)
        yield mutated(chance)
        yield made_up(chance)
        yield chance.randbytes(chance.randrange(300))


@settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**32 - 1))
def test_a_damaged_device_gives_a_configuration_or_an_error_of_ours(seed):
    for _, raw in zip(range(INPUTS_EACH), inputs(seed), strict=False):
        try:
            exercise(raw)
        except BaseException:
            note(f"raw: {raw.hex()}")
            raise


@given(st.binary(max_size=400))
def test_any_bytes_behind_a_right_beginning_give_a_configuration(raw):
    exercise(raw)
    assert exercise(usb.configuration_of(raw, 1))


def test_the_changes_reach_most_of_what_can_be_wrong():
    """Else the tests above would pass without having looked anywhere."""
    said = set()
    for _, raw in zip(range(2_000), inputs(1), strict=False):
        with suppress(DescriptorError):
            problems = parse_configuration(raw).problems
            said |= {problem.split(": ", 1)[1].partition(" is ")[0] for problem in problems}
    fields = {"bLength", "bNumInterfaces", "bNumEndpoints", "bTerminalLink", "bNrInPins"}
    assert fields | {"bInCollection", "bSamFreqType", "bInterfaceProtocol"} <= said


def body_of_64_kb(part: bytes) -> bytes:
    control = usb.control(0, usb.UAC2, usb.header_2())
    return usb.configuration_of(control + part * (65_000 // len(part)), 1)


def chain() -> bytes:
    """The longest way through a function, taken by a thousand alternate settings."""
    units = b"".join(usb.feature_2(i, i + 1, [0, 0]) for i in range(1, 254))
    ends = usb.output_2(255, usb.SPEAKER, 1, 1) + usb.input_2(254, usb.STREAMING_TERMINAL, 0, 1, 0)
    parts = (usb.general_2(254, 1, 0), usb.format_2(2, 16), usb.endpoint(1, 5, 100))
    settings_of_1 = [usb.streaming(1, i % 256, usb.UAC2, *parts) for i in range(1_000)]
    control = usb.control(0, usb.UAC2, usb.header_2(units, ends))
    return usb.configuration_of(control + b"".join(settings_of_1), 2)


WORST = {
    "shortest descriptors": body_of_64_kb(b"\x02\x24"),
    "associations of all": body_of_64_kb(usb.association(0, 255)),
    "interfaces": body_of_64_kb(usb.interface(0, 0, (1, 1, 0))),
    "streams": body_of_64_kb(usb.streaming(1, 1, usb.UAC2, usb.general_2(9, 2, 3))),
    "endpoints": body_of_64_kb(usb.endpoint(1, 5, 100)),
    "lists of all": body_of_64_kb(usb.class_specific(1, bytes([0, 1, 0, 0, 60, *range(60)]))),
    "selectors of all": body_of_64_kb(usb.selector_2(5, range(1, 246))),
    "a chain of units": chain(),
    "far too much": usb.configuration() + bytes([255]) * 10_000_000,
}


@pytest.mark.sweep
@pytest.mark.parametrize("worst", WORST)
def test_the_worst_that_64_kilobytes_can_hold_takes_a_moment(worst):
    before_s = time.thread_time()
    assert exercise(WORST[worst])
    # Read twice and searched; a walk that is not bounded takes minutes.
    assert time.thread_time() - before_s < 3.0


@pytest.mark.soak
def test_a_million_inputs_are_read_quickly_and_leave_nothing_behind():
    slowest_s = before_kb = 0.0
    for number, raw in zip(range(SOAK_INPUTS), inputs(seed=1), strict=False):
        if number == SOAK_INPUTS // 10:
            gc.collect()
            slowest_s, before_kb = 0.0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        before_s = time.thread_time()
        exercise(raw)
        slowest_s = max(slowest_s, time.thread_time() - before_s)
    assert slowest_s < 0.05
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 10_000
