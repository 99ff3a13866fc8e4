"""What an audio function is made of: terminals, units and clocks, of USB Audio 1.0 and 2.0 alike.

Sound flows from an entity to those that name it in `source_ids`; clocks flow the same way between
clock entities. An id, 1 to 255, is unique within one audio function. String indices: 0 is none.
channel_config: wChannelConfig or bmChannelConfig, a bit a loudspeaker position; the channels with
positions come first. Source: USB Audio 1.0, 4.3.2; 2.0, 4.7.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar

from device.usb.descriptors.blocks import Descriptor

USB_STREAMING = 0x0101
"""The terminal type of streams from or to the host."""

VOLUME_UNITS_PER_DB = 256
"""Volume controls count in 1/256 dB, signed 16 bit; -32768 is silence (1.0: 5.2.2.4.3.2)."""


class FeatureControl(IntEnum):
    """A control of a feature unit; its place in the bit maps (1.0: 4.3.2.5; 2.0: 4.7.2.8)."""

    MUTE = 0
    VOLUME = 1
    BASS = 2
    MID = 3
    TREBLE = 4
    GRAPHIC_EQUALIZER = 5
    AUTOMATIC_GAIN = 6
    DELAY = 7
    BASS_BOOST = 8
    LOUDNESS = 9
    INPUT_GAIN = 10
    INPUT_GAIN_PAD = 11
    PHASE_INVERTER = 12
    UNDERFLOW = 13
    OVERFLOW = 14


class Access(IntEnum):
    """What the host may do with a control. USB Audio 1.0 knows only ABSENT and READ_WRITE."""

    ABSENT = 0
    READ_ONLY = 1
    INVALID = 2
    READ_WRITE = 3


class ClockKind(IntEnum):
    """Where a clock source takes its frequency from."""

    EXTERNAL = 0
    FIXED = 1
    VARIABLE = 2
    PROGRAMMABLE = 3


@dataclass(frozen=True, slots=True)
class ControlHeader(Descriptor):
    """The head of an audio function.

    release: bcdADC; total_bytes: wTotalLength, of all that belongs to it. interfaces: the
    streaming interfaces (1.0; () in 2.0, where an association has them); category: of 2.0.
    """

    release: int
    total_bytes: int
    interfaces: tuple[int, ...]
    category: int | None

    kind: ClassVar[str] = "audio control header"


@dataclass(frozen=True, slots=True)
class Entity(Descriptor):
    """A terminal, unit or clock. source_ids: the entities that it takes its input from."""

    id: int
    source_ids: tuple[int, ...]

    @property
    def title(self) -> str:
        """What a person calls it."""
        return f"{self.kind} {self.id}"


@dataclass(frozen=True, slots=True)
class InputTerminal(Entity):
    """Where sound enters the function. clock_id: None in 1.0. controls: bmControls of 2.0, else 0.

    associated: the id of the output terminal that belongs to it (a headset's), 0 for none.
    """

    terminal_type: int
    associated: int
    clock_id: int | None
    channels: int
    channel_config: int
    channel_names_string: int
    controls: int
    string_index: int


@dataclass(frozen=True, slots=True)
class OutputTerminal(Entity):
    """The place where sound leaves the function; fields as in `InputTerminal`."""

    terminal_type: int
    associated: int
    clock_id: int | None
    controls: int
    string_index: int


@dataclass(frozen=True, slots=True)
class FeatureUnit(Entity):
    """Volume, mute and the like.

    uac: 1 or 2, how to read `controls`: one bit map a channel, the first is the master's (channel
    0), whose map may be empty. In 1.0 a bit is a control, in 2.0 two bits are (`Access`).
    """

    uac: int
    controls: tuple[int, ...]
    string_index: int

    def access(self, channel: int, control: FeatureControl) -> Access:
        """What the host may do with a channel's control; ABSENT for a missing channel."""
        if not 0 <= channel < len(self.controls):
            return Access.ABSENT
        if self.uac == 1:
            return Access.READ_WRITE if self.controls[channel] >> control & 1 else Access.ABSENT
        return Access(self.controls[channel] >> 2 * control & 3)

    def settable(self, control: FeatureControl) -> tuple[int, ...]:
        """The channels whose control the host may set; 0 is the master."""
        channels = range(len(self.controls))
        return tuple(c for c in channels if self.access(c, control) is Access.READ_WRITE)


@dataclass(frozen=True, slots=True)
class MixerUnit(Entity):
    """Every output channel is a sum of input channels.

    controls: a bit a crosspoint that can be set, row by row (bmControls of 1.0, bmMixerControls
    of 2.0), as it stands.
    """

    channels: int
    channel_config: int
    channel_names_string: int
    controls: bytes
    string_index: int


@dataclass(frozen=True, slots=True)
class SelectorUnit(Entity):
    """One of several inputs. controls: bmControls of 2.0, else 0."""

    controls: int
    string_index: int


@dataclass(frozen=True, slots=True)
class ProcessingUnit(Entity):
    """Up-mix, reverberation and the like: process_type. controls: as they stand."""

    process_type: int
    channels: int
    channel_config: int
    channel_names_string: int
    controls: bytes
    string_index: int


@dataclass(frozen=True, slots=True)
class ExtensionUnit(ProcessingUnit):
    """The maker's own processing; process_type is its wExtensionCode."""


@dataclass(frozen=True, slots=True)
class EffectUnit(Entity):
    """An effect of 2.0. controls: one bit map per channel, the master's first, undecoded."""

    effect_type: int
    controls: tuple[int, ...]
    string_index: int


@dataclass(frozen=True, slots=True)
class SampleRateConverter(Entity):
    """Converts sound between two clock domains of 2.0: the input's clock and the output's."""

    clock_in_id: int
    clock_out_id: int
    string_index: int


@dataclass(frozen=True, slots=True)
class ClockEntity(Entity):
    """A clock of 2.0. controls: bmControls."""

    controls: int
    string_index: int

    kind: ClassVar[str] = "clock"


@dataclass(frozen=True, slots=True)
class ClockSource(ClockEntity):
    """What samplerates are asked of. terminal_id: whose clock it recovers, 0 for none."""

    clock_kind: ClockKind
    follows_usb_frames: bool
    terminal_id: int

    @property
    def frequency(self) -> Access:
        """What the host may do with the samplerate."""
        return Access(self.controls & 3)


@dataclass(frozen=True, slots=True)
class ClockSelector(ClockEntity):
    """One of several clocks; the device knows which."""


@dataclass(frozen=True, slots=True)
class ClockMultiplier(ClockEntity):
    """A clock times a ratio; the device knows which."""
