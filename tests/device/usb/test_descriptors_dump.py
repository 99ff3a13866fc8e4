"""Files that people send, raw, as text of lsusb -v or as hex dumps, give their bytes."""

import textwrap
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.usb.descriptors import DescriptorError, hex_lines, parse_dump, parse_whole
from device.usb.descriptors.dump import parse_hex
from tests.support import usb_builder as usb
from tests.support.usb_shapes import SHAPES

OLD = """\
Couldn't open device, some information will be missing

Bus 002 Device 003: ID 08bb:2902 Texas Instruments PCM2902 Audio Codec
Device Descriptor:
  bLength                18
  bDescriptorType         1
  bcdUSB               1.10
  bDeviceClass            0 (Defined at Interface level)
  bDeviceSubClass         0
  bDeviceProtocol         0
  bMaxPacketSize0         8
  idVendor           0x08bb Texas Instruments
  idProduct          0x2902 PCM2902 Audio Codec
  bcdDevice            1.00
  iManufacturer           1 Burr-Brown from TI
  iProduct                2
  iSerial                 0
  bNumConfigurations      1
  Configuration Descriptor:
    bLength                 9
    bDescriptorType         2
    wTotalLength           58
    bNumInterfaces          1
    bConfigurationValue     1
    iConfiguration          0
    bmAttributes         0x80
      (Bus Powered)
    MaxPower              100mA
    Interface Descriptor:
      bLength                 9
      bDescriptorType         4
      bInterfaceNumber        0
      bAlternateSetting       0
      bNumEndpoints           0
      bInterfaceClass         1 Audio
      bInterfaceSubClass      1 Control Device
      bInterfaceProtocol      0
      iInterface              0
      AudioControl Interface Descriptor:
        bLength                10
        bDescriptorType        36
        bDescriptorSubtype      6 (FEATURE_UNIT)
        bUnitID                 2
        bSourceID               1
        bControlSize            1
        bmaControls( 0)      0x01
          Mute
        bmaControls( 1)      0x02
          Volume
        bmaControls( 2)      0x02
          Volume
        iFeature                0
      AudioStreaming Interface Descriptor:
        bLength                14
        bDescriptorType        36
        bDescriptorSubtype      2 (FORMAT_TYPE)
        bFormatType             1 (FORMAT_TYPE_I)
        bNrChannels             2
        bSubframeSize           2
        bBitResolution         16
        bSamFreqType            2 Discrete
        tSamFreq[ 0]        32000
        tSamFreq[ 1]        48000
      ** UNRECOGNIZED:  07 24 ff aa bb cc dd
Device Status:     0x0000
  (Bus Powered)
"""

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
    text = "".join("\n".join(["device 1", "bytes:", *hex_lines(raw), "", ""]) for raw in raws)
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

DUMPS = {
    "pairs": "09 02 6D 00 03 01 00 A0 32\n09 04 00 00 00 01 01 00\n\n7c 23 2f 2a 3b\n",
    "xxd of a part": (
        "00000012: 0902 6d00 0301 00a0 3209 0400 0000 0101  ..m.....2.......\n"
        "00000022: 007c 232f 2a3b                           .|#/*;\n"
    ),
    "od -t x1": (
        "0000000 09 02 6d 00 03 01 00 a0 32 09 04 00 00 00 01 01\n"
        "0000020 00 7c 23 2f 2a 3b\n"
        "0000026\n"
    ),
    "od -A x -t x1": (
        "000000 09 02 6d 00 03 01 00 a0 32 09 04 00 00 00 01 01\n000010 00 7c 23 2f 2a 3b\n000016\n"
    ),
    "lsusb": (
        "  ** UNRECOGNIZED:  09 02 6d 00 03 01 00 a0 32\n"
        "  ** UNRECOGNIZED:  09 04 00 00 00 01 01 00\n"
        "  Junk at descriptor end: 7c 23 2f 2a 3b\n"
    ),
    "a C array": (
        "{ 0x09, 0x02, 0x6d, 0x00, 0x03, 0x01, 0x00, 0xa0, 0x32, // configuration: 2 interfaces\n"
        "  /* interface 0: control\n     on */ 0x09, 0x04, 0x00, 0x00, 0x00, 0x01, 0x01,\n"
        "  0x00, 0x7C, 0x23, 0x2F, 0x2A, 0x3B }\n"
    ),
    "a Python string": r"\x09\x02\x6d\x00\x03\x01\x00\xa0\x32\x09\x04" + r"\x00" * 3 + "\n"
    r"\x01\x01\x00\x7c\x23\x2f\x2a\x3b",
    "with comments": (
        "# the configuration of my DAC\n09 02 6d 00 03 01 00 a0 32 ; self powered\n"
        "09 04 00 00 00 01 01 00 # control\n7c 23 2f 2a 3b /* what is this? */\n"
        "/* the | end */\n/* the end"
    ),
}


@pytest.mark.parametrize("dump", DUMPS)
def test_a_dump_gives_the_bytes_that_it_shows(dump):
    assert parse_hex(DUMPS[dump]) == BYTES


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "hex dump: it has no bytes; needed: two hexadecimal digits a byte"),
        ("# nothing\n", "it has no bytes"),
        ("09 02\n09 0", "hex dump, line 2: '0' is no byte; needed: two hexadecimal digits a byte"),
        ("09 0g", "line 1: '0g' is no byte"),
        ("/* 1\n2 */\nzz", "line 3: 'zz' is no byte"),
        ("00000000: 0902\n00000010: 0904", "0x10 instead of 0x2; bytes before it are missing"),
        ("00000000: 0902\n00000001: 0904", "bytes before it are too many"),
        ("00000000  09 02\n*\n00000010", "line 2: '*' marks omitted lines"),
        ("00000000  09 02\n00000010", "line 2: the address is 0x10 instead of 0x2"),
        ("0000000 0209 006d", "shows swapped bytes; use od -t x1"),
        ("0000009 02 03", "line 1: '0000009' is not an octal address"),
    ],
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
    """As `hexdump -C` shows it."""
    halves = ((at, row[:8].hex(" "), row[8:].hex(" "), shown) for at, row, shown in rows(raw))
    lines = (f"{at:08x}  {left:<23}  {right:<23}  |{shown}|\n" for at, left, right, shown in halves)
    return "".join(lines) + f"{len(raw):08x}"


@given(st.binary(min_size=1, max_size=80))
def test_any_bytes_come_back_from_any_dump(raw):
    for text in (xxd(raw), hexdump(raw), raw.hex(), ", ".join(f"0x{byte:02x}" for byte in raw)):
        assert parse_hex(text) == raw


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
