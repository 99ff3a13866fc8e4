import gc
import random
import resource
import textwrap
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from device.usb import descriptors
from device.usb.descriptors import DescriptorError, parse_configuration, parse_dump, parse_whole
from device.usb.descriptors.dump import parse_hex
from tests.support import usb_builder as usb
from tests.support.data import DATA, table, text
from tests.support.usb_shapes import SHAPES

OLD = text("lsusb-old.txt")

OLD_BYTES = bytes.fromhex(
    "12 01 10 01 00 00 00 08 bb 08 02 29 00 01 01 02 00 01"
    "09 02 3a 00 01 01 00 80 32"
    "09 04 00 00 00 01 01 00 00"
    "0a 24 06 02 01 01 01 02 02 00"
    "0e 24 02 01 02 02 10 02 00 7d 00 80 bb 00"
    "07 24 ff aa bb cc dd"
)


TWIN, TWIN_BYTES = OLD.replace("0x2902", "0x2904"), OLD_BYTES.replace(b"\x02\x29", b"\x04\x29")
OF_8_MA = OLD_BYTES[:2] + b"\x20\x03" + OLD_BYTES[4:26] + bytes([112]) + OLD_BYTES[27:]
OLD_TEXT = OLD.encode()
changes = st.tuples(
    st.integers(0, len(OLD_TEXT)),
    st.integers(0, 60),
    st.binary(max_size=3) | st.integers(0, 400).map(lambda size: OLD_TEXT[:size]),
)


@pytest.mark.parametrize(
    ("text", "raws"),
    [
        (OLD.replace("\n", "\r\n"), [OLD_BYTES]),
        ("\ufeff" + OLD, [OLD_BYTES]),
        (textwrap.indent(OLD, "    "), [OLD_BYTES]),
        (OLD + TWIN, [OLD_BYTES, TWIN_BYTES]),
        (OLD.replace("1.10", "3.20").replace("100mA", "896mA"), [OF_8_MA]),  # of SuperSpeed
    ],
    ids=["line ends", "byte order mark", "quoted", "two devices", "power in units of 8 mA"],
)
def test_the_text_of_an_older_lsusb_is_read(text, raws):
    assert parse_dump(text.encode()) == tuple(raws)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_raw_file_is_taken_as_it_is(shape):
    raw = SHAPES[shape]
    assert (parse_dump(raw), parse_dump(usb.device() + raw)) == ((raw,), (usb.device() + raw,))


def test_a_description_is_read_by_its_bytes_and_names_of_fields_in_comments_are_none():
    raws = (usb.device() + SHAPES["composite"], SHAPES["async_dac"])
    text = "".join(
        "\n".join(["device 1", "bytes:", *descriptors.hex_lines(raw), "", ""]) for raw in raws
    )
    assert parse_dump(text.encode()) == raws
    raw = usb.device()
    text = f"{{ 0x12, // bLength\n 0x01, /* bDescriptorType 1 */\n {raw[2:].hex(' ')} }}"
    assert parse_dump(text.encode()) == (raw,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Device Status: 0x0000\n  bLength 9\n", "it has no descriptors"),
        ("bLength 9\nbDescriptorType 2\n", "line 1: 2 of 9 bytes are shown"),
        ("bLength 9\nbDescriptorType 2\n** UNRECOGNIZED: 07 24\n", "line 1: 2 of 9 bytes"),
        (OLD.replace("      bInterfaceProtocol      0\n", ""), "line 30: 8 of 9 bytes are shown"),
    ],
)
def test_a_text_that_lacks_what_counts_is_refused(text, words):
    with pytest.raises(DescriptorError, match=words):
        parse_dump(text.encode())


@given(st.lists(changes, min_size=1, max_size=12))
def test_no_text_whatever_raises_anything_else(changes):
    content = OLD_TEXT
    for at, removed, put in changes:
        content = content[:at] + put + content[at + removed :]
    with suppress(DescriptorError):
        for raw in parse_dump(content):
            parse_whole(raw)


BYTES = bytes.fromhex("09026d000301 00a0320904 000000 0101 00 7c23 2f2a 3b")

DUMPS = {path.stem: path.read_text() for path in sorted((DATA / "hex-dumps").iterdir())}


@pytest.mark.parametrize("dump", DUMPS)
def test_a_dump_gives_the_bytes_that_it_shows(dump):
    assert parse_hex(DUMPS[dump]) == BYTES


@pytest.mark.parametrize(
    ("text", "reason"),
    table("hex-mistakes.toml")["mistakes"],
)
def test_what_is_no_dump_is_refused_with_its_line(text, reason):
    with pytest.raises(DescriptorError) as caught:
        parse_hex(text)
    assert reason in str(caught.value)


def rows(raw):
    for at in range(0, len(raw), 16):
        row = raw[at : at + 16]
        yield at, row, "".join(chr(byte) if 32 <= byte < 127 else "." for byte in row)


def xxd(raw):
    return "\n".join(f"{at:08x}: {row.hex(' ', -2):<39}  {shown}" for at, row, shown in rows(raw))


def hexdump(raw):
    halves = ((at, row[:8].hex(" "), row[8:].hex(" "), shown) for at, row, shown in rows(raw))
    lines = (f"{at:08x}  {left:<23}  {right:<23}  |{shown}|\n" for at, left, right, shown in halves)
    return "".join(lines) + f"{len(raw):08x}"


@given(st.binary(min_size=1, max_size=80))
def test_any_bytes_come_back_from_any_dump(raw):
    for dump in (xxd(raw), hexdump(raw), raw.hex(), ", ".join(f"0x{byte:02x}" for byte in raw)):
        assert parse_hex(dump) == raw


def said_of(text):
    """The error, "" where there are bytes."""
    try:
        assert parse_hex(text)
    except DescriptorError as error:
        return str(error)
    return ""


@given(st.text(st.sampled_from("09aAfF gx:;#/*|{},\\\n\t0") | st.characters(), max_size=60))
def test_no_text_gives_anything_but_bytes_or_an_error_of_ours(text):
    assert said_of(text)[:8] in ("", "hex dump")


@pytest.mark.sweep
@pytest.mark.parametrize("part", ["z", "/*", "0", "# ", "*/", "0x", "a:", " ", "\\x"])
def test_a_line_of_a_million_signs_takes_no_longer_than_a_line(part):
    assert len(said_of(part * (1_000_000 // len(part)))) < 300


WHOLE = tuple(SHAPES.values())
PLACES = {raw: [raw.index(part) for part in usb.split(raw)] for raw in WHOLE}

INPUTS_EACH = 100  # of one seed; 10 000 together
SOAK_INPUTS = 1_000_000


def exercise(raw: bytes) -> bool:
    """Read and play bytes; return whether they begin with a configuration."""
    try:
        configuration = parse_configuration(raw)
    except DescriptorError:
        return False
    assert configuration.raw == raw
    descriptors.playback_formats(configuration)
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
