"""The vibration's way to one sound card itself, without a sound server."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from audioflinger_hook.daemon.device_volume import DeviceVolume, SetVolume
from audioflinger_hook.daemon.reconnecting_stream import ReconnectingStream
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.sides import Actuated, Fill
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from device.address import DeviceAddress
from device.alsa import choose_setup, find_playback, set_card_volume
from device.alsa.cards import PROC, PlaybackDevice
from device.alsa.negotiation import CardSetup, list_offers
from device.alsa.usb_stream import read_usb_stream
from device.alsa.use import read_hw_params, why_blocked
from device.drive import ChannelMap, ChannelRouter, channels_needed, wiring_of
from device.errors import CushionError, LostError, NotFoundError, UsageError
from device.server import PulseConnection, ServerSnapshot
from device.stream import AudioPriority, PlaybackStream
from device.stream.pcms import CardDevice, Pcm, Target
from device.stream.portaudio import BLOCK_FRAMES
from device.stream.sample_format import SampleFormat
from device.units import Float32Array
from device.usb import UsbIdentity, find_one
from device.usb.presence import PresenceWatch
from device.usb.sysfs import ROOT


class CardOutput:
    """A sound card that is the haptic device. For the supervisor alone.

    It is opened as the card's own formats allow, and nobody else can play there meanwhile. No
    other card is ever taken instead, so that the stream needs no guard.

    address: of kind hw or usb. recording: takes what is sent. actuators: what hangs at its
    channels; none to leave no channel silent. block_frames: of a callback; priority: what its
    thread asks for; both of streams that are opened from now on; volume: the device's own. root,
    usb_root: what tells of cards and of USB devices; target: what leads to a card.
    """

    needs_server = False
    may_rest = True
    summary = ""

    def __init__(
        self,
        address: DeviceAddress,
        pcm: Pcm,
        states: StateKeeper,
        recording: RunRecording | None = None,
        *,
        actuators: Actuated = (),
        block_frames: int = BLOCK_FRAMES,
        priority: AudioPriority | None = None,
        volume: DeviceVolume | None = None,
        root: Path = PROC,
        usb_root: Path = ROOT,
        target: Callable[[int, int], Target] = CardDevice,
    ) -> None:
        self.block_frames = block_frames
        self._priority = priority
        self.volume = volume or DeviceVolume()
        self._address = address
        self._pcm = pcm
        self._states = states
        self._recording = recording
        self._router = ChannelRouter(actuators)
        self._root = root
        self._usb_root = usb_root
        self._presence: PresenceWatch | None = None
        self._target = target
        self._kept: ReconnectingStream[PlaybackStream] = ReconnectingStream(
            "the output", states, Cause.DEVICE_LOST, Cause.DEVICE_MOVED
        )
        self._mix: tuple[int, int] | None = None
        self._found: _Place | None = None
        self._playing: _Place | None = None
        self._delay_s = 0.0
        self._lacking: set[SampleFormat] = set()

    def __str__(self) -> str:
        return str(self._address)

    @property
    def name(self) -> str | None:
        """What is there."""
        return self._playing.name if self._playing and self._kept.stream else None

    @property
    def xruns(self) -> int:
        """How often PortAudio told of lateness."""
        return self._kept.xruns

    @property
    def is_open(self) -> bool:
        """Whether a stream plays, or did until a moment ago."""
        return self._kept.stream is not None

    @property
    def warnings(self) -> list[str]:
        """Why the volume is not what was asked for."""
        return [self.volume.warning] if self.volume.warning else []

    def lead(self, address: DeviceAddress) -> None:
        """Fall silent, and go on at another card."""
        self.close()
        self._address = address
        self._lacking.clear()

    def refuse(self, actuators: Actuated) -> None:
        """Raise UsageError if the card has no channels for these actuators."""
        if self._found is None or not actuators:
            return
        try:
            self._choice(self._found.playback, actuators)
        except NotFoundError as error:
            raise UsageError(str(error)) from None

    def wire(self, actuators: Actuated) -> None:
        """Take these actuators, without a gap where as many go on, on channels that are open."""
        channel_map = None
        choice = self._playing.choice if self._playing else None
        if choice is not None and actuators:
            with suppress(UsageError):  # more channels are to be opened
                channel_map = ChannelMap.of(wiring_of(actuators), choice.channels)
        if not self._router.change(actuators, channel_map):
            self.close()

    def suit(self, samplerate: int, channels: int) -> None:
        """Be told the mix's rate, Hz, and the vibration's channels, before the first `keep`."""
        self._mix = samplerate, channels

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Return for how long a frame waits in the card's buffer, 0 while it is closed."""
        return self._delay_s if self.is_open else 0.0

    def locate(self, snapshot: ServerSnapshot | None) -> _Place:
        """Find the card, and how it is to be opened.

        Raises NotFoundError where it is not there, where something else plays there, or where it
        offers nothing that suits.
        """
        playback = self._sought()
        playing = self._playing
        if self.is_open and playing is not None and playing.playback == playback:
            self._found = playing
        else:
            self._found = self._place(playback)
        return self._found

    def keep(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Bring the playback nearer to what was located.

        Raises LostError or NotFoundError where it cannot be opened; another try follows.
        """
        kept, place = self._kept, self._found
        assert place is not None
        if kept.stream is not None:
            if place != self._playing:  # plugged in again: another number
                self.close()
            else:
                kept.check(now_s)
        if kept.stream is not None:
            self.volume.follow(_set_volume_of(place.playback))
        choice = place.choice
        if kept.stream is not None or choice is None:
            return  # what was located before the mix was known will be located again
        self._pcm.target = self._target(place.playback.card.number, place.playback.device)
        try:
            if kept.open(lambda: self._stream(place, choice, fill), None, place.name, now_s):
                self._playing = place
                self._look_at(place.playback, choice)
        except CushionError as error:
            self._states.enter(DaemonState.WAITING_FOR_DEVICE, now_s, str(error))
            raise

    def close(self) -> None:
        """Fall silent. Again too; it raises nothing."""
        self._kept.close()
        self._playing = None

    def end(self, *, keep: bool) -> None:
        """Fall silent."""
        self.close()
        if self._presence is not None:
            self._presence.close()

    def _sought(self) -> PlaybackDevice:
        if self._address.kind != "usb":
            return find_playback(self._address.name, self._root)
        if self._presence is None:
            self._presence = PresenceWatch(self._usb_root)
        self._presence.poll(0.0)
        device = find_one(UsbIdentity.parse(str(self._address)), self._presence.found)
        for card in device.cards:
            for number in card.playback:
                return find_playback(f"{card.number},{number}", self._root)
        raise NotFoundError(
            f"{device.label!r} has no sound card that plays; `cushion usb describe` shows what it "
            "says that it is"
        )

    def _place(self, playback: PlaybackDevice) -> _Place:
        refused = why_blocked(playback)
        if refused is not None:
            raise NotFoundError(refused)
        choice = self._choice(playback, self._router.actuators)
        return _Place(playback, choice if self._mix else None)

    def _choice(self, playback: PlaybackDevice, actuators: Actuated) -> CardSetup:
        """Return how the card suits, or NotFoundError; before the mix is known, for any mix."""
        samplerate, channels = self._mix or (48_000, 1)
        if actuators:
            wiring = wiring_of(actuators)
            channels = max(len(actuators), channels_needed(wiring))
        try:
            offers = list_offers(read_usb_stream(playback))
            choice = choose_setup(offers, samplerate, channels, without=self._lacking)
            if actuators:
                ChannelMap.of(wiring, choice.channels, device=str(playback))
        except (NotFoundError, UsageError) as error:
            advice = (
                f"; the actuators need {channels} channels: name others in [[actuator]], or "
                "another card"
            )
            raise NotFoundError(f"{playback}: {error}{advice if actuators else ''}") from None
        return choice

    def _stream(self, place: _Place, choice: CardSetup, fill: Fill) -> PlaybackStream:
        self.volume.set(_set_volume_of(place.playback))
        recording = self._recording
        assert self._mix is not None
        actuators = self._router.actuators
        if actuators:
            channel_map = ChannelMap.of(wiring_of(actuators), choice.channels)
        else:
            channel_map = ChannelMap.repeated(self._mix[1], choice.channels)
        sent = None
        if recording is not None:
            recording.reopened()

            def sent(frames: Float32Array, now_s: float) -> None:
                recording.sent(frames, choice.samplerate, now_s)

        return PlaybackStream(
            self._pcm,
            choice.samplerate,
            choice.channels,
            self._router.connect(fill, channel_map, self.block_frames),
            sent,
            block_frames=self.block_frames,
            priority=self._priority,
            sample_format=choice.sample_format,
        )

    def _look_at(self, playback: PlaybackDevice, choice: CardSetup) -> None:
        """See how the card was opened in truth: PortAudio would convert without a word."""
        opened = read_hw_params(playback)
        wanted = choice.sample_format.value
        if opened and all(one.format != wanted for one in opened):
            self._lacking.add(choice.sample_format)
            self.close()
            raise LostError(
                f"{playback} plays {opened[0].format}, not {wanted} as it was opened; another "
                "format is tried"
            )
        self._delay_s = opened[0].delay_s if opened else 0.0


@dataclass(frozen=True)
class _Place:
    """A card, and how it is to be opened; choice: None until the mix is known."""

    playback: PlaybackDevice
    choice: CardSetup | None

    @property
    def name(self) -> str:
        return str(self.playback)

    @property
    def samplerate(self) -> int:
        return self.choice.samplerate if self.choice else 0

    @property
    def channels(self) -> int:
        return self.choice.channels if self.choice else 0


def _set_volume_of(playback: PlaybackDevice) -> SetVolume:
    def set_volume(wanted_db: float) -> None:
        set_card_volume(playback.card.number, wanted_db)

    return set_volume
