"""A sound card's own volumes and mutes, which its driver offers to every program.

The controls can be changed while another program plays. The structures and request numbers for
ioctl on the card's control file are those of <sound/asound.h>.
"""

import ctypes
import errno
import math
import os
from contextlib import closing
from ctypes import c_char, c_int, c_long, c_longlong, c_ubyte, c_uint, c_uint32, c_ulong, c_void_p
from dataclasses import dataclass, field
from pathlib import Path

from device.alsa.cards import DEVICES
from device.alsa.decibels import Decibels, parse_decibels
from device.errors import NotFoundError, UsageError
from device.volume_limit import MAX_VOLUME_DB, limit_volume_db

_VOLUME, _SWITCH = "Playback Volume", "Playback Switch"
_MIXER = 2
_BOOLEAN, _INTEGER = 1, 2
_READABLE, _WRITABLE, _HAS_TABLE = 1 << 0, 1 << 1, 1 << 4
_READ_BACK_DB = 1.0  # a level that is read back may be lower by this: drivers round down

_MOST_ELEMENTS, _TABLE_WORDS = 4_096, 1_024

# fcntl.ioctl keeps the GIL for large structures: audio threads would wait until a device answers.
_ioctl = ctypes.CDLL(None, use_errno=True).ioctl
_ioctl.argtypes = (c_int, c_ulong, c_void_p)


class _Id(ctypes.Structure):
    _fields_ = (
        ("number", c_uint),
        ("interface", c_int),
        ("device", c_uint),
        ("subdevice", c_uint),
        ("name", c_char * 44),
        ("index", c_uint),
    )


class _List(ctypes.Structure):
    _fields_ = (
        ("offset", c_uint),
        ("space", c_uint),
        ("used", c_uint),
        ("count", c_uint),
        ("ids", c_void_p),
        ("reserved", c_ubyte * 50),
    )


class _Info(ctypes.Structure):
    _fields_ = (
        ("id", _Id),
        ("type", c_int),
        ("access", c_uint),
        ("count", c_uint),
        ("owner", c_int),
        ("lowest", c_long),
        ("highest", c_long),
        ("reserved", c_ubyte * (128 + 64 - 2 * ctypes.sizeof(c_long))),
    )


class _ValueOf(ctypes.Union):
    _fields_ = (("steps", c_long * 128), ("wide", c_longlong * 64))
    # the member `wide` determines the alignment of the union on 32-bit processors


class _Value(ctypes.Structure):
    _anonymous_ = ("of",)
    _fields_ = (("id", _Id), ("indirect", c_uint), ("of", _ValueOf), ("reserved", c_ubyte * 128))


class _Table(ctypes.Structure):
    _fields_ = (("number", c_uint), ("length", c_uint), ("words", c_uint32 * _TABLE_WORDS))


_GET_LIST, _GET_INFO, _READ, _WRITE, _READ_TABLE = 0x10, 0x11, 0x12, 0x13, 0x1A


@dataclass(frozen=True)
class MixerControl:
    """One playback volume control or mute switch of a card."""

    name: str  # from the driver
    channels: int
    number: int = field(repr=False)
    decibels: Decibels | None = field(default=None, repr=False)  # levels of the steps, if known


class CardMixer:
    """The volumes and mutes of one card, until `close`. Only one thread at a time may use it.

    card: number in ALSA. devices: directory of the device files. volumes, switches: the card's
    volume controls and mute switches. Constructor and methods raise NotFoundError if the card is
    missing or refuses a request, or if this user may not open the card.
    """

    def __init__(self, card: int, devices: Path = DEVICES) -> None:
        self._card, self._node = card, devices / f"controlC{card}"
        try:
            self._file = os.open(self._node, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise self._refusal(error) from None
        self.volumes: list[MixerControl] = []
        self.switches: list[MixerControl] = []
        try:
            self._read_controls()
        except BaseException:
            self.close()
            raise

    def volume_db(self, volume: MixerControl) -> tuple[float, ...] | None:
        """Return the level of each channel in dB, -inf for silence; None if levels are unknown."""
        if volume.decibels is None:
            return None
        return tuple(map(volume.decibels.level, self._steps(volume)))

    def set_volume_db(
        self, volume: MixerControl, wanted_db: float, limit_db: float = MAX_VOLUME_DB
    ) -> float:
        """Set all channels to the highest level that exceeds none of wanted_db, limit_db and 0 dB.

        If all levels exceed wanted_db, the lowest level is set. The return value is the highest
        channel level in dB, read back from the card. UsageError: wanted_db is NaN, the levels are
        unknown, or the lowest exceeds limit_db or 0 dB. NotFoundError: the card refuses the level.
        """
        if (decibels := volume.decibels) is None:
            raise UsageError(
                f"the driver of sound card {self._card} does not say what the steps of "
                f"{volume.name!r} are in dB; set it by ear, with alsamixer"
            )
        most_db = limit_volume_db(wanted_db, decibels.lowest_db, repr(volume.name), limit_db)
        step = decibels.step_at_most(most_db)
        step = decibels.lowest if step is None else step
        self._set(volume, step)
        level_db, found_db = decibels.level(step), list(map(decibels.level, self._steps(volume)))
        # Some kernels report success although the device refused the value.
        if not all(level_db - _READ_BACK_DB <= found <= level_db for found in found_db):
            raise NotFoundError(
                f"sound card {self._card}: {volume.name!r} was set to {_shown(level_db)} and is "
                f"{_shown(max(found_db))}: the device does not take it"
            )
        return max(found_db)

    def muted(self, switch: MixerControl) -> tuple[bool, ...]:
        """Return whether each channel is muted."""
        return tuple(not on for on in self._steps(switch))

    def set_muted(self, switch: MixerControl, muted: bool) -> None:
        """Mute or unmute all channels. NotFoundError: a channel keeps its former state."""
        self._set(switch, int(not muted))
        if set(self.muted(switch)) != {muted}:
            stays = "open" if muted else "muted"
            raise NotFoundError(f"sound card {self._card}: {switch.name!r} stays {stays}")

    def close(self) -> None:
        """Close the control file. May be repeated."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _read_controls(self) -> None:
        listing = _List()
        self._ask(_GET_LIST, listing)
        ids = (_Id * min(listing.count, _MOST_ELEMENTS))()
        listing = _List(space=len(ids), ids=ctypes.addressof(ids))
        self._ask(_GET_LIST, listing)
        for control in ids[: listing.used]:
            ends = (_VOLUME.encode(), _SWITCH.encode())
            if control.interface != _MIXER or not control.name.endswith(ends):
                continue
            number = control.number
            info = _Info(_Id(number))
            self._ask(_GET_INFO, info)
            allowed = _READABLE | _WRITABLE
            if info.access & allowed != allowed or not 0 < info.count <= 128:
                continue
            name = info.id.name.decode(errors="replace")
            if info.type == _BOOLEAN and name.endswith(_SWITCH):
                self.switches.append(MixerControl(name, info.count, number))
            if info.type == _INTEGER and name.endswith(_VOLUME):
                words = self._table(number) if info.access & _HAS_TABLE else []
                decibels = parse_decibels(words, info.lowest, info.highest)
                self.volumes.append(MixerControl(name, info.count, number, decibels))

    def _table(self, number: int) -> list[int]:
        table = _Table(number=number, length=4 * _TABLE_WORDS)
        try:
            self._ask(_READ_TABLE, table)
        except NotFoundError:  # some drivers announce a table that does not exist
            return []
        words = list(table.words)
        return words[: 2 + words[1] // 4]

    def _steps(self, control: MixerControl) -> list[int]:
        held = _Value(_Id(control.number))
        self._ask(_READ, held)
        return list(held.steps[: control.channels])

    def _set(self, control: MixerControl, step: int) -> None:
        held = _Value(_Id(control.number))
        held.steps[: control.channels] = [step] * control.channels
        self._ask(_WRITE, held)

    def _ask(self, number: int, what: ctypes.Structure) -> None:
        size = ctypes.sizeof(what) if number != _READ_TABLE else 8  # excludes the table's words
        request = 3 << 30 | size << 16 | ord("U") << 8 | number  # _IOWR('U', number, size)
        if _ioctl(self._file, request, ctypes.byref(what)) < 0:
            code = ctypes.get_errno()
            raise self._refusal(OSError(code, os.strerror(code)))

    def _refusal(self, error: OSError) -> NotFoundError:
        what = f"the mixer of sound card {self._card} ({self._node})"
        if error.errno in (errno.EACCES, errno.EPERM):
            return NotFoundError(
                f"this user may not open {what}; log in at the machine itself, or join the group "
                "audio"
            )
        if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO, errno.EBADF):
            return NotFoundError(f"{what} is missing; plug the card in, see `cushion devices`")
        return NotFoundError(
            f"{what} refuses the value or does not answer ({error.strerror}); plug the card in "
            "again"
        )


def set_card_volume(
    card: int, wanted_db: float, limit_db: float = MAX_VOLUME_DB
) -> tuple[float, ...]:
    """Set all playback volumes of a card, unmute it, and return the level of each volume in dB.

    No returned level exceeds wanted_db, limit_db or 0 dB. So that the card is never too
    loud, it is unmuted only after all volumes were set and read back successfully.
    card: number in ALSA. wanted_db: level of each volume. limit_db: upper limit.
    NotFoundError: the card is missing, has no volume, or refuses a request. UsageError: wanted_db
    is NaN, or a volume's levels are unknown or all exceed wanted_db, limit_db or 0 dB.
    """
    with closing(CardMixer(card)) as mixer:
        if not mixer.volumes:
            has = "a mute and no volume" if mixer.switches else "neither volume nor mute"
            raise NotFoundError(f"sound card {card} has {has} that can be set")
        levels_db, failures = [], []
        for volume in mixer.volumes:
            try:
                level_db = mixer.set_volume_db(volume, wanted_db, limit_db)
            except UsageError as error:
                failures.append(str(error))
                continue
            levels_db.append(level_db)
            if level_db > wanted_db + 1e-6:
                failures.append(f"the lowest level of {volume.name!r} is {_shown(level_db)}")
        if failures:
            raise UsageError(f"sound card {card}: {'; '.join(failures)}")
        for switch in mixer.switches:
            mixer.set_muted(switch, False)
    return tuple(levels_db)


def _shown(level_db: float) -> str:
    return f"{level_db:g} dB" if math.isfinite(level_db) else "silence"
