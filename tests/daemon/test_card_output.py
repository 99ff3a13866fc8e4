"""A daemon's way to a card, a file of /proc/asound here: found, opened, lost and found again."""

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon import endpoints
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.outputs.base import Fill
from audioflinger_hook.daemon.outputs.card import CardOutput
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.timing import Wake
from audioflinger_hook.mixer.pcm import PcmFormat, decode, encode
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from device.address import DeviceAddress, parse_device
from device.drive import ActuatorSettings
from device.drive.safety import SafetyState
from device.errors import LostError, NotFoundError, UsageError
from device.stream import portaudio, streams
from device.stream.pcms import CardDevice, Target
from device.units import Float32Array
from tests.support.alsa_files import BLOCK_S, ToFile, portaudio_with, until
from tests.support.commands import call, noise, refused, sound
from tests.support.run_configs import config
from tests.support.sound_cards import ADAPTIVE, ASYNC, HW_PARAMS, Cards

RATE = 48_000
TONE = (0.1 * np.sin(np.arange(256) * 0.1)).astype(np.float32)


@pytest.fixture(scope="module")
def pcms():
    with portaudio_with("cushion_output") as found:
        yield found


class Rig:
    """An output, its cards, and where its bytes go: one file a card's number."""

    def __init__(self, folder: Path, pcms, name="DAC", actuators=(), **options) -> None:
        self.folder, self.cards = folder, Cards(folder / "asound")
        self.states, self.blocks = StateKeeper(0.0), 0
        wanted = config(f"hw:{name}", Settings(actuators=actuators), block_frames=256)
        known: Any = {"root": self.cards.root, "target": self.target} | options
        self.output = CardOutput(wanted, pcms.pcms["cushion_output"], self.states, None, **known)

    def target(self, card: int, device: int) -> Target:
        return ToFile(self.path(card, device))

    def path(self, card: int, device: int = 0) -> Path:
        return self.folder / f"{card}-{device}.raw"

    def fill(self, out: Float32Array, now_s: float) -> None:
        """The tone on the first actuator, half of it on others."""
        time.sleep(BLOCK_S)
        for actuator in range(out.shape[1]):
            out[:, actuator] = TONE / (1 + actuator)
        self.blocks += 1

    def tick(self, later_s: float = 0.0) -> None:
        now_s = time.monotonic() + later_s
        self.output.locate(None)
        self.output.maintain(None, self.fill, now_s)
        if self.output.name:
            self.states.enter(DaemonState.RUNNING, now_s)

    def start(self, channels: int = 1, *, stream: str = ASYNC, usb_id: str = "") -> None:
        self.cards.plug(30, "DAC", stream=stream, usb_id=usb_id)
        self.output.set_format(RATE, channels)
        self.tick()
        self.play()

    def got(self, blocks: dict[int, Float32Array], channels: int, form: PcmFormat) -> bool:
        """Whether the card got a block with these channels, and silence on the others."""
        block = np.zeros((256, channels), np.float32)
        for channel, samples in blocks.items():
            block[:, channel] = samples
        self.output.close()
        return encode(block, form) in self.path(30).read_bytes()

    def play(self) -> None:
        before = self.blocks
        until(lambda: self.blocks > before + 8)


@pytest.fixture
def rig(tmp_path, pcms):
    rig = Rig(tmp_path, pcms)
    yield rig
    rig.output.end(keep=True)


def test_a_card_gets_the_vibration_in_its_own_format_and_is_opened_again_if_callbacks_stop(rig):
    rig.cards.plug(30, "DAC", stream=ASYNC)
    place = rig.output.locate(None)
    assert (place.name, place.samplerate, place.channels) == ("hw:DAC,0", 0, 0)
    rig.tick()
    assert rig.output.name is None  # the mix is not known yet
    rig.output.set_format(RATE, 1)
    place = rig.output.locate(None)
    assert (place.name, place.samplerate, place.channels) == ("hw:DAC,0", RATE, 2)
    rig.tick()
    assert rig.output.name == "hw:DAC,0"
    rig.play()
    assert rig.output.is_open
    rig.tick(later_s=1.0)
    assert rig.states.report(time.monotonic()).recoveries[Cause.DEVICE_LOST] == 1
    assert rig.output.name == "hw:DAC,0"
    rig.play()
    rig.output.close()
    assert not rig.output.is_open
    assert encode(np.column_stack([TONE, TONE]), PcmFormat.I32) * 3 in rig.path(30).read_bytes()


def test_a_pad_whose_coils_are_known_vibrates_on_their_channels_alone(rig):
    rig.start(stream=ADAPTIVE.replace("Channels: 8", "Channels: 4"), usb_id="054c:0ce6")
    assert rig.got({2: TONE, 3: TONE}, 4, PcmFormat.I24)


@pytest.mark.parametrize(("usb_id", "channels", "least"), [("054c:0ce6", 1, 4), ("", 3, 3)])
def test_a_card_without_the_channels_that_are_needed_is_not_played_to(rig, usb_id, channels, least):
    rig.cards.plug(30, "DAC", stream=ASYNC, usb_id=usb_id)
    rig.output.set_format(RATE, channels)
    message = f"hw:DAC,0: the card cannot be opened with {least} to 32 channels"
    with pytest.raises(NotFoundError, match=message):
        rig.output.locate(None)


def test_a_card_whose_volume_cannot_be_set_is_not_played_to(rig):
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.output.set_format(RATE, 1)
    rig.output.volume.wanted_db = -30.0  # there is no control file of such a card
    rig.output.locate(None)
    for attempt in (lambda: rig.output.set_volume(None), rig.tick):
        with pytest.raises(NotFoundError, match="device_volume_db = -30 cannot be set"):
            attempt()
    assert rig.states.state is DaemonState.WAITING_FOR_DEVICE
    assert not rig.output.is_open
    rig.output.volume.wanted_db = None
    rig.tick(later_s=1.0)
    rig.play()
    rig.output.volume.wanted_db = -30.0  # the config was read again
    with pytest.raises(NotFoundError):
        rig.tick()
    assert not rig.output.is_open


def test_a_card_with_too_few_channels_for_the_actuators_is_none(tmp_path, pcms):
    rig = Rig(tmp_path, pcms, "30,0", actuators=(ActuatorSettings((0,)), ActuatorSettings((2,))))
    rig.cards.plug(30, "DAC", stream=ASYNC)
    for known in (False, True):  # the mix
        if known:
            rig.output.set_format(RATE, 2)
        with pytest.raises(NotFoundError, match="need 3 channels: name others in"):
            rig.output.locate(None)
    rig.output.set_actuators([ActuatorSettings((0,)), ActuatorSettings((1,))])
    rig.output.locate(None)
    with pytest.raises(UsageError, match="need 6 channels"):
        rig.output.check_actuators([ActuatorSettings((0,)), ActuatorSettings((5,))])


def test_actuators_reach_their_channels_and_go_over_to_others_in_an_open_stream(tmp_path, pcms):
    rig = Rig(tmp_path, pcms, "30,0", actuators=(ActuatorSettings((5,)), ActuatorSettings((0, 1))))
    rig.start(2, stream=ADAPTIVE)
    rig.output.set_actuators([ActuatorSettings((1,)), ActuatorSettings((7, 2))])
    assert rig.output.is_open
    rig.play()
    half = TONE / 2
    assert rig.got({5: TONE, 0: half, 1: half}, 8, PcmFormat.I24)
    assert rig.got({1: TONE, 7: half, 2: half}, 8, PcmFormat.I24)


@pytest.mark.parametrize("missed", [True, False])
def test_a_card_that_is_plugged_in_again_plays_again_whatever_its_number_and_no_other(rig, missed):
    rig.cards.plug(29, "DAC_1", stream=ASYNC)
    with pytest.raises(NotFoundError, match="no sound card 'DAC'; did you mean 'DAC_1'"):
        rig.output.locate(None)
    rig.start(2)
    rig.cards.unplug(30)
    if missed:
        with pytest.raises(NotFoundError):
            rig.output.locate(None)
        assert rig.output.is_open  # the supervisor says what was lost, and closes
        rig.output.close()
    rig.cards.plug(31, "DAC", stream=ASYNC)
    rig.tick()
    rig.play()
    rig.output.close()
    assert any(rig.path(31).read_bytes())


def test_a_card_that_another_program_plays_on_is_waited_for(rig):
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.cards.use(30, os.getpid())
    with pytest.raises(NotFoundError, match=rf"hw:DAC,0 is in use by .* \(process {os.getpid()}\)"):
        rig.output.locate(None)
    rig.cards.use(30, 0)
    rig.output.set_format(RATE, 2)
    rig.tick()
    rig.cards.use(30, os.getpid())  # ourselves
    rig.tick()
    assert rig.output.name


def test_a_card_that_plays_another_format_than_asked_for_is_opened_in_that_one(rig):
    folder = rig.cards.plug(30, "PCH")
    assert rig.output.retarget(config("hw:PCH"))
    rig.output.set_format(RATE, 1)
    (folder / "pcm0p/sub0/hw_params").write_text(HW_PARAMS.format("S16_LE", 2, RATE))
    with pytest.raises(LostError, match="hw:PCH,0 plays S16_LE instead of S32_LE"):
        rig.tick()
    assert rig.states.state is DaemonState.WAITING_FOR_DEVICE
    rig.tick()
    assert (rig.output.name, rig.output.delay_s(None)) == ("hw:PCH,0", pytest.approx(0.016))
    rig.play()
    rig.output.close()
    assert rig.output.delay_s(None) == 0.0
    assert encode(np.column_stack([TONE, TONE]), PcmFormat.I16) in rig.path(30).read_bytes()


def test_a_card_that_cannot_be_opened_is_awaited_with_a_reason_and_ever_less_often(tmp_path, pcms):
    rig = Rig(tmp_path, pcms, target=CardDevice)
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.output.set_format(RATE, 2)
    with pytest.raises(LostError, match="cannot open hw:30,0 for playback"):
        rig.tick()
    report = rig.states.report(time.monotonic())
    assert report.state is DaemonState.WAITING_FOR_DEVICE
    assert "the card was unplugged" in report.reason
    rig.tick()  # too soon: nothing is tried
    with pytest.raises(LostError):
        rig.tick(later_s=0.1)
    assert rig.output.name is None


FILE_RATE = 44_100
HOUR_S, AHEAD_S = 3_600.0, 0.5  # AHEAD_S: sound that the buffers of file and card may hold
ONLY_96K = ASYNC.replace("44100, 48000, 88200, 96000, 176400, 192000", "96000")


class Paced:
    """A block when a card of that rate, Hz, would ask for it: ALSA's file takes it at once."""

    def __init__(self, fill: Fill, samplerate: int, clock: Callable[[], float]) -> None:
        self._fill, self._clock, self._samplerate = fill, clock, samplerate
        self._due_s = 0.0

    def fill(self, out: Float32Array, now_s: float) -> None:
        self._due_s = (self._due_s or self._clock()) + len(out) / self._samplerate
        time.sleep(max(0.001, self._due_s - self._clock()))
        self._fill(out, self._clock())


class DaemonRig:
    """A daemon that plays a file to a card; each card's bytes go to a file of its number."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("pyaudio")
        self.folder = folder
        self.cards = cards = Cards(folder / "asound")
        clock = self.now_s

        class FileCard(CardOutput):
            def __init__(self, *arguments: Any, **options: Any) -> None:
                options |= {"root": cards.root, "target": self.file}
                super().__init__(*arguments, **options)

            def file(self, card: int, device: int) -> ToFile:
                return ToFile(folder / f"{card}.raw")

            def maintain(self, connection: Any, fill: Fill, now_s: float) -> None:
                assert self._found
                paced = Paced(fill, self._found.samplerate or FILE_RATE, clock)
                super().maintain(connection, paced.fill, now_s)

        monkeypatch.setattr(endpoints, "CardOutput", FileCard)
        source = sound(folder / "in.wav", noise(20 * FILE_RATE, 2), FILE_RATE)
        # without real-time priority: a file that takes all at once must not keep others waiting
        self.order = config("hw:DAC", tap=(f"file:{source}",), realtime=False)
        self.wake = Wake()
        self.jumped_s = self.slept_s = 0.0
        # a stream tells by the same clock when it was called
        monkeypatch.setattr(streams, "time", SimpleNamespace(monotonic=clock))
        self.clocks = Clocks(self.now_s, time.thread_time, lambda: self.slept_s)
        self.supervisor = Supervisor(self.order, self.clocks, self.wake)

    def now_s(self) -> float:
        return time.monotonic() + self.jumped_s

    def until(self, state: DaemonState, limit_s: float = 10.0) -> str:
        end_s = time.monotonic() + limit_s
        while True:
            self.run(0.02)
            report = self.supervisor.states.report(self.now_s())
            if report.state is state:
                return report.reason
            assert time.monotonic() < end_s, report

    def run(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.supervisor.tick(self.now_s())
            time.sleep(0.02)

    def heard(self, card: int) -> Float32Array:
        return decode((self.folder / f"{card}.raw").read_bytes(), PcmFormat.I32, 2)

    def close(self) -> None:
        self.supervisor.close(self.now_s())
        self.wake.__exit__(None, None, None)
        assert len(portaudio.open_tags) == 0


@pytest.fixture
def live(tmp_path, monkeypatch):
    live = DaemonRig(tmp_path, monkeypatch)
    yield live
    live.close()


def test_a_daemon_that_cannot_open_a_stream_says_why(live, monkeypatch):
    def hangs(*_: object) -> None:
        raise LostError("the server hangs")

    monkeypatch.setattr(live.supervisor.output, "maintain", hangs)
    live.cards.plug(30, "DAC", stream=ONLY_96K)
    live.run(0.2)
    report = live.supervisor.states.report(time.monotonic())
    assert (report.state, report.reason) == (DaemonState.STARTING, "the server hangs")


def test_another_card_is_gone_over_to_and_lost_while_it_runs_and_a_sink_is_not(live):
    live.cards.plug(30, "DAC", stream=ASYNC)
    live.cards.plug(31, "Other", stream=ASYNC)
    live.until(DaemonState.RUNNING)
    other = replace(live.order, device=DeviceAddress("hw", "Other"))
    live.supervisor.follow(other, time.monotonic())
    live.run(0.5)
    assert live.supervisor.endpoints[1] == ("hw:Other", "hw:Other,0")
    assert (live.folder / "31.raw").stat().st_size
    for device in (DeviceAddress("sink", "a"), DeviceAddress("twin")):
        with pytest.raises(UsageError, match=f"'hw:Other' cannot become '{device}'"):
            live.supervisor.follow(replace(other, device=device), time.monotonic())
    assert live.supervisor.endpoints[1] == ("hw:Other", "hw:Other,0")
    live.cards.unplug(31)
    assert "no sound card" in live.until(DaemonState.WAITING_FOR_DEVICE)
    assert live.supervisor.states.report(live.now_s()).recoveries[Cause.DEVICE_LOST] == 1


@pytest.mark.parametrize("is_suspend", [True, False], ids=["suspend", "jump"])
def test_a_card_is_awaited_and_away_for_hours_and_plays_on_cooler_and_no_other(live, is_suspend):
    def pass_an_hour() -> None:
        live.slept_s += HOUR_S * is_suspend  # the monotonic clock stands still
        live.jumped_s += HOUR_S * (not is_suspend)

    protected = replace(live.order, settings=Settings(protection="on"))
    live.supervisor = Supervisor(protected, live.clocks, live.wake)
    with pytest.raises(NotFoundError, match="no sound card 'DAC'"):
        live.supervisor.look()
    assert "connect one" in live.until(DaemonState.WAITING_FOR_DEVICE)
    live.cards.plug(29, "Speakers", stream=ASYNC)
    live.cards.plug(30, "DAC", stream=ONLY_96K)
    live.until(DaemonState.RUNNING)
    (rig,), engine = live.supervisor.engines.rigs, live.supervisor.engines.python
    live.run(1.5)
    assert rig.has_run
    assert (engine.samplerate, engine.delay_line.samplerate_out) == (FILE_RATE, 96_000)
    assert live.supervisor.endpoints[1] == ("hw:DAC", "hw:DAC,0")
    dose_s = rig.safety_states()[0].dose.time_s
    live.cards.unplug(30)
    pass_an_hour()
    assert "no sound card" in live.until(DaemonState.WAITING_FOR_DEVICE)
    live.run(0.1)
    rig.restore([SafetyState(100.0, 60.0)] * rig.channels, rig._core_readings.frames + 1)
    rig._kept_frames = rig._core_readings.frames
    live.run(0.1)
    assert max(state.coil_c for state in rig.safety_states()) == 100.0
    pass_an_hour()
    live.run(0.1)
    assert max(state.coil_c for state in rig.safety_states()) < 50.0
    live.cards.plug(31, "DAC", stream=ASYNC)
    before_s, plugged_s = live.supervisor.engines.heard_s, time.monotonic()
    live.until(DaemonState.RUNNING, 3.0)
    live.run(1.5)
    passed_s = time.monotonic() - plugged_s
    assert live.supervisor.engines.heard_s - before_s < passed_s + AHEAD_S  # nothing is made up for
    assert engine.delay_line.samplerate_out == FILE_RATE
    for card in (30, 31):
        vibration = live.heard(card)
        assert np.abs(vibration).max() > 0.005
        np.testing.assert_array_equal(vibration[:, 0], vibration[:, 1])
    assert not (live.folder / "29.raw").exists()
    assert live.supervisor.states.report(live.now_s()).recoveries[Cause.RESUMED] == 2 * is_suspend
    assert rig._readings[0].coil_c < 50.0
    assert rig.safety_states()[0].dose.time_s > dose_s


def test_cards_are_written_as_alsa_writes_them():
    for text in ("hw:0", "hw:DAC,1", "hw:CARD=DAC,DEV=0"):
        assert str(parse_device(text)) == text
    assert "is not hw:CARD or hw:CARD,DEVICE" in refused(call("run", "--device", "hw:a,b"))
