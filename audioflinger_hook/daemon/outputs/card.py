"""Plays vibration on a sound card, without a sound server."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from audioflinger_hook.daemon.inputs.base import FixedNode
from audioflinger_hook.daemon.outputs.base import SetVolume, StreamOutput
from audioflinger_hook.daemon.run_config import RunConfig
from device.alsa import choose_setup, find_playback, set_card_volume
from device.alsa.cards import PROC, AlsaDevice, read_hw_params, why_blocked
from device.alsa.offers import CardSetup, MeasuredRate, list_offers, measure_rate
from device.drive import ActuatorSettings, ChannelMap, channels_needed, wiring_of
from device.errors import LostError, NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.stream.pcms import CardDevice, Target
from device.stream.sample_format import SampleFormat
from device.usb import UsbIdentity, find_devices, find_one
from device.usb.identity import coil_channels
from device.usb.sysfs import ROOT


@dataclass(frozen=True)
class CardNode(FixedNode):
    """A sound card. setup: settings for opening; None until the format of the mix is known."""

    playback: AlsaDevice
    setup: CardSetup | None


class CardOutput(StreamOutput[CardNode]):
    """A sound card as the haptic device, opened exclusively.

    root, usb_root: the system's folders of sound cards and of USB devices. target: returns the PCM
    target for the numbers of a card and a device.
    """

    is_card = True
    _identity = attrgetter("playback")  # the card may have another number

    def __init__(
        self,
        *arguments: Any,
        root: Path = PROC,
        usb_root: Path = ROOT,
        target: Callable[[int, int], Target] = CardDevice,
        **options: Any,
    ) -> None:
        super().__init__(*arguments, **options)
        self._root, self._usb_root, self._target = root, usb_root, target
        self._mix: tuple[int, int] | None = None
        self._delay_s = 0.0
        self._failed_formats: set[SampleFormat] = set()

    def retarget(self, config: RunConfig) -> bool:
        """Change to another card; return False for a sink."""
        self._failed_formats.clear()
        return super().retarget(config)

    def check_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Raise UsageError if the card lacks channels for these actuators."""
        if self._found is None or not actuators:
            return
        try:
            self._setup(self._found.playback, actuators)
        except NotFoundError as error:
            raise UsageError(str(error)) from None

    def set_format(self, samplerate: int, channels: int) -> None:
        """See `Output`."""
        super().set_format(samplerate, channels)
        self._mix = samplerate, channels

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return the seconds that a frame waits in the card's buffer, 0 while closed."""
        return self._delay_s if self.is_open else 0.0

    def measure_rate(self) -> MeasuredRate | None:
        """See `Output`."""
        playing = self._playing
        return measure_rate(playing.playback) if playing else None

    def locate(self, snapshot: ServerSnapshot | None) -> CardNode:
        """Return the card. NotFoundError: it is missing or in use, or has no suitable setup."""
        playback = self._find()
        playing = self._playing
        if self.is_open and playing is not None and playing.playback == playback:
            self._found = playing
            return playing
        if reason := why_blocked(playback):
            raise NotFoundError(reason)
        setup = self._setup(playback, self._router.actuators)
        name, known = str(playback), setup if self._mix else None
        rate, channels = (known.samplerate, known.channels) if known else (0, 0)
        self._found = CardNode(name, rate, channels, playback, known)
        return self._found

    def _place(self, node: CardNode) -> tuple[Target, SampleFormat] | None:
        if node.setup is None:
            return None  # the next `locate` finds a setup
        target = self._target(node.playback.card.number, node.playback.device)
        return target, node.setup.sample_format

    def close(self) -> None:
        """Close the stream. Repeated calls do nothing."""
        super().close()
        self._playing = None

    def _volume_setter(self, node: CardNode, connection: PulseConnection | None) -> SetVolume:
        return partial(set_card_volume, node.playback.card.number)

    def _find(self) -> AlsaDevice:
        if self.address.kind != "usb":
            return find_playback(self.address.name, self._root)
        device = find_one(UsbIdentity.parse(str(self.address)), find_devices(self._usb_root))
        for card in device.cards:
            for number in card.playback:
                return find_playback(f"{card.number},{number}", self._root)
        raise NotFoundError(
            f"{device.label!r} has no sound card that plays; `cushion usb describe` lists its "
            "interfaces"
        )

    def _setup(self, playback: AlsaDevice, actuators: Sequence[ActuatorSettings]) -> CardSetup:
        """Return the card's setup for the mix's format, or for 48 kHz if this format is unknown."""
        samplerate, channels = self._mix or (48_000, 1)
        channels = max(channels, *(1 + coil for coil in _coils(playback)), 1)
        if actuators:
            wiring = wiring_of(actuators)
            channels = max(len(actuators), channels_needed(wiring))
        try:
            offers = list_offers(playback)
            setup = choose_setup(offers, samplerate, channels, without=self._failed_formats)
            if actuators:
                ChannelMap.of(wiring, setup.channels, device=str(playback))
        except (NotFoundError, UsageError) as error:
            advice = (
                f"; the actuators need {channels} channels: name others in [[actuator]], or "
                "another card"
            )
            raise NotFoundError(f"{playback}: {error}{advice if actuators else ''}") from None
        return setup

    def _channel_map(self, node: CardNode, actuators: Sequence[ActuatorSettings]) -> ChannelMap:
        if actuators:
            return ChannelMap.of(wiring_of(actuators), node.channels)
        coils = _coils(node.playback)
        return ChannelMap.on_coils(self._haptic_channels, node.channels, coils, node.name)

    def _verify(self, node: CardNode) -> None:
        """Raise LostError unless ALSA uses the wanted format; PortAudio does not report this."""
        opened = read_hw_params(node.playback)
        assert node.setup is not None
        wanted = node.setup.sample_format
        if opened and all(one.format != wanted.value for one in opened):
            self._failed_formats.add(wanted)
            words = f"{node.name} plays {opened[0].format} instead of {wanted.value}"
            raise LostError(f"{words}; trying another format")
        self._delay_s = opened[0].delay_s if opened else 0.0


def _coils(playback: AlsaDevice) -> tuple[int, ...]:
    return coil_channels(*playback.card.usb_id)
