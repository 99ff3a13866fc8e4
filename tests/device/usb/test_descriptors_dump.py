"""Files that people send, raw or as text of lsusb -v, give the bytes that they were made from."""

import textwrap
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.usb.descriptors import DescriptorError, hex_lines, parse_dump, parse_whole
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
