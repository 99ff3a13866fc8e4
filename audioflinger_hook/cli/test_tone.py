"""Plays the tone of `cushion test-tone` and of `cushion setup` on exactly one device."""

import argparse
import math
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager

import numpy as np

from audioflinger_hook.cli.terminal import choose, warn
from audioflinger_hook.daemon.outputs.sink import muted
from device.address import DeviceAddress, parse_device
from device.alsa import choose_setup, find_playback
from device.alsa.cards import AlsaDevice, why_blocked
from device.alsa.offers import CardSetup, list_offers
from device.drive import ActuatorSettings, ChannelMap, channels_needed, wiring_of
from device.drive.channel_positions import sink_channel_map
from device.errors import LostError, NotFoundError, UsageError
from device.server import FallbackSink, PulseConnection, ServerSnapshot, StreamGuard
from device.server.guard import Hold
from device.server.snapshot import Sink
from device.stream import PcmConfig, PlaybackStream, filter_stderr
from device.stream.pcms import CardDevice, Pcm, ServerDevice
from device.stream.sample_format import SampleFormat
from device.units import Float32Array, db_to_amplitude
from device.usb.identity import coil_channels

PCM = "cushion_output"  # the caller must create this PCM before the connection to the server
FADE_S = 0.1  # duration of a fade-out, and of a fade-in by default
SETTLE_S = 5.0  # longest time until a new stream runs


class Tone:
    """A sine on some channels of an output, silent until `play`.

    name: of the output. channels: numbers of the channels that play it, from 0. stream: the open
    output. guard: None for a sound card without a server. ended: set when the tone has ended.
    """

    stream: PlaybackStream
    guard: StreamGuard | None = None

    def __init__(self, name: str, hz: float, samplerate: int, channels: Sequence[int]) -> None:
        self.name = name
        self._turn = 2.0 * math.pi * hz / samplerate  # radians per frame
        self._samplerate, self._channels = samplerate, list(channels)
        self._phase = self._amplitude = self._aim = 0.0
        self._rise = self._fall = 1.0  # change of the amplitude per frame
        self._frames_left = 0
        self.ended = threading.Event()

    def play(self, level: float, duration_s: float, fade_s: float = FADE_S) -> None:
        """Fade in to the amplitude `level`, hold and fade out. duration_s: includes the fades."""
        self._frames_left = round((duration_s - FADE_S) * self._samplerate)
        self._rise = level / (fade_s * self._samplerate)
        self._fall = level / (FADE_S * self._samplerate)
        self._aim = level
        self.ended.clear()

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next frames. Only the output's thread calls it."""
        aim, change = (self._aim, self._rise) if self._frames_left > 0 else (0.0, self._fall)
        self._frames_left -= len(out)
        frames = np.arange(1, len(out) + 1)
        before = self._amplitude
        if before <= aim:
            amplitudes = np.minimum(before + change * frames, aim)
        else:
            amplitudes = np.maximum(before - max(change, self._fall) * frames, aim)
        phases = self._phase + self._turn * frames
        out[:, self._channels] = (amplitudes * np.sin(phases))[:, None]
        self._phase = float(phases[-1]) % (2.0 * math.pi)
        self._amplitude = float(amplitudes[-1])
        if aim == before == 0.0:
            self.ended.set()

    def wait_audible(self) -> None:
        """Wait until the stream plays. LostError: the stream does not play within SETTLE_S."""
        deadline_s = time.monotonic() + SETTLE_S
        while not (self.stream.audible and self.stream.callbacks > 1):
            if time.monotonic() > deadline_s:
                raise LostError(f"{self.name} does not play after {SETTLE_S:g} s; check the device")
            self.check()
            time.sleep(0.01)

    def wait_ended(self) -> None:
        """Wait for the tone's end. LostError: the device was lost."""
        while not self.ended.wait(0.1):
            self.check()
        if self.guard is not None:  # a stream without a device may consume all frames at once
            self.guard.look()
        self.check()

    def check(self) -> None:
        """Raise LostError if the device or the stream is lost."""
        gone = self.guard is not None and self.guard.hold is Hold.NO_DEVICE
        if gone or self.stream.is_lost(time.monotonic()):
            raise LostError("the device was lost while the tone played; plug it in again")

    def fade_out(self) -> None:
        """Fade out the tone and wait for its end. Raises nothing."""
        self._frames_left = 0
        if self.stream.audible and not self.stream.is_lost():
            self.ended.wait(3.0 * FADE_S)


@contextmanager
def open_tone(
    device: DeviceAddress,
    pcm: Pcm,
    connection: PulseConnection,
    hz: float,
    actuators: Sequence[ActuatorSettings] = (),
) -> Iterator[Tone]:
    """Open a device for a tone of `hz`; close the device at exit.

    actuators: their channels play the tone; if empty, the known coil channels, else all channels.
    NotFoundError: there is no such device, or it is in use. UsageError: the device lacks a channel
    of `actuators`. LostError: the device or the server does not answer.
    """
    with ExitStack() as stack:
        sink = None if device.kind == "hw" else device.sink(connection.latest)
        if sink is None:
            name, setup, channel_map = _on_card(device, pcm, actuators)
        else:
            stack.callback(FallbackSink(connection).close)
            pcm.target = ServerDevice(sink.name)
            name = f"{sink.name} ({sink.description})"
            setup = CardSetup(SampleFormat.FLOAT32, sink.samplerate, sink.channels)
            channel_map = sink_channel_map(sink, actuators)
        playing = [n for n, source in enumerate(channel_map.sources) if source is not None]
        tone = Tone(name, hz, setup.samplerate, playing)
        stream = tone.stream = PlaybackStream(
            pcm, setup.samplerate, setup.channels, tone.fill, sample_format=setup.sample_format
        )
        stack.callback(stream.close)
        if sink:
            tone.guard = StreamGuard(connection, stream, sink.name)
            stack.callback(tone.guard.release)
        stack.callback(tone.fade_out)
        if sink is None:
            stream.audible = True
        yield tone


def _on_card(
    device: DeviceAddress, pcm: Pcm, actuators: Sequence[ActuatorSettings]
) -> tuple[str, CardSetup, ChannelMap]:
    playback = find_playback(device.name)
    coils = coil_channels(*playback.card.usb_id)
    wiring = wiring_of(actuators)
    needed = max(1, channels_needed(wiring), *(1 + coil for coil in coils))
    pcm.target, setup = free_card(playback, 48_000, needed)
    channel_map = (
        ChannelMap.of(wiring, setup.channels, device=str(playback))
        if actuators
        else ChannelMap.on_coils(1, setup.channels, coils, str(playback))
    )
    return f"{playback} ({playback.name})", setup, channel_map


def free_card(
    device: AlsaDevice, rate_hz: int, needed: int, least: int | None = None
) -> tuple[CardDevice, CardSetup]:
    """Return the card as a stream's target, and its best format.

    rate_hz, needed, least: see `choose_setup`. NotFoundError: card in use, or no fitting format.
    """
    if refused := why_blocked(device):
        raise NotFoundError(refused)
    setup = choose_setup(list_offers(device), rate_hz, needed, least)
    return CardDevice(device.card.number, device.device), setup


TONE_HZ = 60.0
FIRST_DB, STEP_DB = -24.0, 6.0  # first level in dB of full scale; "louder" adds STEP_DB
FADE_IN_S = 2.0
LONGEST_S = 30.0  # a tone without an answer ends after this time, because the coil heats up
UNASKED_S = 4.0  # duration of a tone without a question

ANSWERS = {
    "yes": "the vibration is strong enough",
    "louder": "6 dB more",
    "no": "there is no vibration",
    "stop": "stop the tone and end",
}


def try_output(
    device: DeviceAddress,
    pcm: Pcm,
    connection: PulseConnection,
    actuators: Sequence[ActuatorSettings],
    *,
    ask: bool,
) -> tuple[str, float | None]:
    """Play a tone, and ask whether it is felt. Return the answer and the amplitude in dBFS.

    The answer is yes, no or stop; only yes has an amplitude. actuators: see `open_tone`.
    ask: if False, play a short tone, ask nothing, and return yes without an amplitude.
    KeyboardInterrupt: as for `choose`; the tone is stopped.
    LostError: the device does not play, or was lost. Other errors are those of `open_tone`.
    """
    with open_tone(device, pcm, connection, TONE_HZ, actuators) as tone:
        tone.wait_audible()
        print(f"\n{tone.name} vibrates softly at {TONE_HZ:g} Hz. Ctrl+C stops it.", flush=True)
        if not ask:
            tone.play(db_to_amplitude(FIRST_DB), UNASKED_S, FADE_IN_S)
            tone.wait_ended()
            return "yes", None
        print("The strongest moments will be as strong as the tone.")
        level_db = FIRST_DB
        while True:
            tone.play(db_to_amplitude(level_db), LONGEST_S, FADE_IN_S)
            question = f"{level_db:g} dB. Felt it? yes, louder, no, stop:"
            answer = choose(question, ANSWERS, meanwhile=tone.check)
            if answer != "stop":
                tone.check()
            if answer != "louder":
                return answer, level_db if answer == "yes" else None
            if math.isclose(level_db, 0.0):
                print("This is full scale: turn the amplifier up, or check the cables.")
            level_db = min(level_db + STEP_DB, 0.0)


def run(options: argparse.Namespace) -> int:
    """Play the tone on the device of `--device`."""
    if not 20.0 <= options.hz <= 220.0:
        raise UsageError(f"hz={options.hz:.12g} is out of range; allowed: 20 to 220 Hz")
    if not 0.0 < options.level <= 1.0:
        raise UsageError(f"level={options.level:.12g} is out of range; allowed: above 0, up to 1")
    if not FADE_S * 2 <= options.seconds <= 60.0:
        raise UsageError(f"seconds={options.seconds:.12g} is out of range; allowed: 0.2 to 60 s")
    device = parse_device(options.device)
    if device.kind not in ("sink", "usb"):
        allowed = "sink:NAME, usb:VID:PID"
        raise UsageError(f"device {str(device)!r} cannot play a test tone; allowed: {allowed}")
    filter_stderr()
    with ExitStack() as stack:
        pcms = stack.enter_context(closing(PcmConfig(PCM)))
        connection = stack.enter_context(closing(PulseConnection()))
        tone = stack.enter_context(open_tone(device, pcms.pcms[PCM], connection, options.hz))
        tone.play(options.level, options.seconds)
        how = f"{options.hz:g} Hz for {options.seconds:g} s, at {options.level:.0%} of full scale"
        print(f"{tone.name}: {how}", flush=True)
        warn(*_warnings(device.sink(connection.latest), connection.latest))
        tone.wait_ended()
    return 0


def _warnings(sink: Sink, snapshot: ServerSnapshot) -> Iterator[str]:
    if sink.mute:
        yield muted(sink.name)
    elif sink.weakened:
        yield f"{sink.name} has {sink.weakened}, which makes the vibration weaker"
    if sink.name == snapshot.default_sink:
        yield (
            f"{sink.name} is the default output, where the computer's sound plays; vibration needs "
            "another one, see `cushion devices`"
        )
