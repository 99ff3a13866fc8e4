"""Plays vibration on a sound card, without a sound server."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from audioflinger_hook.daemon.outputs.base import Fill, SetVolume, StreamOutput
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.service.state import DaemonState
from device.alsa import choose_setup, find_playback, set_card_volume
from device.alsa.cards import PROC, AlsaDevice, read_hw_params, why_blocked
from device.alsa.offers import CardSetup, MeasuredRate, list_offers, measure_rate
from device.drive import ActuatorSettings, ChannelMap, channels_needed, wiring_of
from device.errors import CushionError, LostError, NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.stream.pcms import CardDevice, Target
from device.stream.sample_format import SampleFormat
from device.usb import UsbIdentity, find_devices, find_one
from device.usb.identity import coil_channels
from device.usb.sysfs import ROOT


@dataclass(frozen=True)
class CardNode:
    """A sound card. setup: settings for opening; None until the format of the mix is known."""

    playback: AlsaDevice
    setup: CardSetup | None

    @property
    def name(self) -> str:
        """The card's name in messages."""
        return str(self.playback)

    @property
    def samplerate(self) -> int:
        """Sample rate in Hz; 0 until the setup is known."""
        return self.setup.samplerate if self.setup else 0

    @property
    def channels(self) -> int:
        """Number of channels; 0 until the setup is known."""
        return self.setup.channels if self.setup else 0


class CardOutput(StreamOutput[CardNode]):
    """A sound card as the haptic device, opened exclusively.

    root, usb_root: the system's folders of sound cards and of USB devices. target: returns the PCM
    target for the numbers of a card and a device.
    """

    is_card = True

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
        reason = why_blocked(playback)
        if reason is not None:
            raise NotFoundError(reason)
        setup = self._setup(playback, self._router.actuators)
        self._found = CardNode(playback, setup if self._mix else None)
        return self._found

    def maintain(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """See `Output`."""
        stream, node = self._stream, self._found
        assert node is not None
        if stream.stream is not None:
            if node != self._playing:  # plugged in again: the card has another number
                self.close()
            else:
                stream.check(now_s)
        set_volume = self._volume_setter(node, connection)
        if stream.stream is not None:
            with self._waiting(now_s):
                self.volume.update(set_volume)
            return
        setup = node.setup
        if setup is None:
            return  # the next `locate` finds a setup
        self._pcm.target = self._target(node.playback.card.number, node.playback.device)
        try:
            if stream.open(
                lambda: self._playback(node, fill, set_volume, setup.sample_format),
                None,
                node.name,
                now_s,
            ):
                self._playing = node
                self._verify(node.playback, setup)
        except CushionError as error:
            self._states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            raise

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

    def _verify(self, playback: AlsaDevice, setup: CardSetup) -> None:
        """Raise LostError unless ALSA uses the wanted format; PortAudio does not report this."""
        opened = read_hw_params(playback)
        wanted = setup.sample_format.value
        if opened and all(one.format != wanted for one in opened):
            self._failed_formats.add(setup.sample_format)
            self.close()
            raise LostError(
                f"{playback} plays {opened[0].format} instead of {wanted}; trying another format"
            )
        self._delay_s = opened[0].delay_s if opened else 0.0


def _coils(playback: AlsaDevice) -> tuple[int, ...]:
    return coil_channels(*playback.card.usb_id)
