"""The daemon's way to a card: found, opened as it allows, given up and opened again.

The cards are files: of /proc/asound, and of what ALSA would have handed to the card.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon.outputs.card import CardOutput
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.mixer.pcm import PcmFormat, encode
from audioflinger_hook.service.state import Cause, DaemonState, StateKeeper
from audioflinger_hook.sources import TapAddress
from device.address import DeviceAddress
from device.drive import ActuatorSettings
from device.errors import LostError, NotFoundError, UsageError
from device.stream.pcms import CardDevice, PcmConfig, Target
from device.units import Float32Array
from tests.support.alsa_files import BLOCK_S, ToFile, portaudio_with, until
from tests.support.sound_cards import ADAPTIVE, ASYNC, HW_PARAMS, Cards

RATE = 48_000
TONE = (0.1 * np.sin(np.arange(256) * 0.1)).astype(np.float32)


@pytest.fixture(scope="module")
def pcms() -> Iterator[PcmConfig]:
    with portaudio_with("cushion_output") as config:
        yield config


class Rig:
    """An output, its cards, and where its bytes go: one file a card's number."""

    def __init__(self, folder: Path, pcms: PcmConfig, name: str = "DAC", **options) -> None:
        self.folder = folder
        self.cards = Cards(folder / "asound")
        self.states = StateKeeper(0.0)
        self.blocks = 0
        self.output = CardOutput(
            DeviceAddress("hw", name),
            pcms.pcms["cushion_output"],
            self.states,
            root=self.cards.root,
            **({"target": self.target} | options),
        )

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
        """What the supervisor does."""
        now_s = time.monotonic() + later_s
        self.output.locate(None)
        self.output.maintain(None, self.fill, now_s)
        if self.output.name:
            self.states.enter(DaemonState.RUNNING, now_s)

    def play(self) -> None:
        """Some blocks more."""
        before = self.blocks
        until(lambda: self.blocks > before + 8)


@pytest.fixture
def rig(tmp_path: Path, pcms: PcmConfig) -> Iterator[Rig]:
    rig = Rig(tmp_path, pcms)
    yield rig
    rig.output.end(keep=True)


def test_a_card_gets_the_vibration_in_its_own_format(rig: Rig) -> None:
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
    rig.output.close()
    assert not rig.output.is_open
    block = encode(np.column_stack([TONE, TONE]), PcmFormat.I32)
    assert block * 3 in rig.path(30).read_bytes()


def test_actuators_reach_the_channels_that_they_are_wired_to(
    tmp_path: Path, pcms: PcmConfig
) -> None:
    rig = Rig(tmp_path, pcms, "30,0", actuators=[ActuatorSettings((5,)), ActuatorSettings((0, 1))])
    rig.cards.plug(30, "DAC", stream=ADAPTIVE)
    rig.output.set_format(RATE, 2)
    rig.tick()
    rig.play()
    rig.output.close()
    block = np.zeros((256, 8), np.float32)
    block[:, 5], block[:, 0], block[:, 1] = TONE, TONE / 2, TONE / 2
    assert encode(block, PcmFormat.I24) in rig.path(30).read_bytes()


PAD = ADAPTIVE.replace("Channels: 8", "Channels: 4")


def test_a_pad_whose_coils_are_known_vibrates_on_their_channels_alone(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=PAD, usb_id="054c:0ce6")
    rig.output.set_format(RATE, 1)
    rig.tick()
    rig.play()
    rig.output.close()
    block = np.zeros((256, 4), np.float32)
    block[:, 2] = block[:, 3] = TONE
    assert encode(block, PcmFormat.I24) in rig.path(30).read_bytes()


def test_a_pad_without_the_channels_of_its_coils_is_not_played_to(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=ASYNC, usb_id="054c:0ce6")
    rig.output.set_format(RATE, 1)
    with pytest.raises(NotFoundError, match="cannot be opened with 4 to 32 channels"):
        rig.output.locate(None)


def test_a_card_whose_volume_cannot_be_set_is_not_played_to(rig: Rig) -> None:
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


def test_a_card_with_too_few_channels_for_the_actuators_is_none(
    tmp_path: Path, pcms: PcmConfig
) -> None:
    rig = Rig(tmp_path, pcms, "30,0", actuators=[ActuatorSettings((0,)), ActuatorSettings((2,))])
    rig.cards.plug(30, "DAC", stream=ASYNC)
    for known in (False, True):  # the mix
        if known:
            rig.output.set_format(RATE, 2)
        with pytest.raises(NotFoundError, match="need 3 channels: name others in"):
            rig.output.locate(None)
    wrong = [ActuatorSettings((0,)), ActuatorSettings((5,))]
    rig.output.set_actuators([ActuatorSettings((0,)), ActuatorSettings((1,))])
    rig.output.locate(None)
    with pytest.raises(UsageError, match="need 6 channels"):
        rig.output.check_actuators(wrong)


def test_other_channels_are_gone_over_to_while_the_stream_stays_open(
    tmp_path: Path, pcms: PcmConfig
) -> None:
    rig = Rig(tmp_path, pcms, "30,0", actuators=[ActuatorSettings((5,)), ActuatorSettings((0,))])
    rig.cards.plug(30, "DAC", stream=ADAPTIVE)
    rig.output.set_format(RATE, 2)
    rig.tick()
    rig.play()
    rig.output.set_actuators([ActuatorSettings((1,)), ActuatorSettings((7, 2))])
    assert rig.output.is_open
    rig.play()
    rig.output.close()
    block = np.zeros((256, 8), np.float32)
    block[:, 1], block[:, 2], block[:, 7] = TONE, TONE / 2, TONE / 2
    assert encode(block, PcmFormat.I24) in rig.path(30).read_bytes()


def test_without_the_card_there_is_nothing_and_no_other_card_is_taken(rig: Rig) -> None:
    rig.cards.plug(30, "DAC_1", stream=ASYNC)
    with pytest.raises(NotFoundError, match="no sound card 'DAC'; did you mean 'DAC_1'"):
        rig.output.locate(None)


def test_a_card_that_is_plugged_in_again_plays_again_whatever_its_number(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.output.set_format(RATE, 2)
    rig.tick()
    rig.play()
    rig.cards.unplug(30)
    with pytest.raises(NotFoundError):
        rig.output.locate(None)
    assert rig.output.is_open  # the supervisor says what was lost, and closes
    rig.output.close()
    rig.cards.plug(31, "DAC", stream=ASYNC)
    rig.tick()
    rig.play()
    rig.output.close()
    assert any(rig.path(31).read_bytes())


def test_a_card_that_has_another_number_at_once_is_opened_anew(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.output.set_format(RATE, 2)
    rig.tick()
    rig.play()
    rig.cards.unplug(30)
    rig.cards.plug(31, "DAC", stream=ASYNC)
    rig.tick()
    rig.play()
    assert rig.path(31).exists()


def test_a_card_whose_callbacks_stop_is_lost_and_opened_again(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.output.set_format(RATE, 2)
    rig.tick()
    rig.play()
    rig.tick(later_s=1.0)
    report = rig.states.report(time.monotonic())
    assert report.recoveries[Cause.DEVICE_LOST] == 1
    assert rig.output.name == "hw:DAC,0"
    rig.play()


def test_a_card_that_another_program_plays_on_is_waited_for(rig: Rig) -> None:
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


def test_a_card_that_plays_another_format_than_asked_for_is_opened_in_that_one(rig: Rig) -> None:
    folder = rig.cards.plug(30, "PCH")
    other_card = DeviceAddress("hw", "PCH")
    config = RunConfig(TapAddress("default"), other_card, Settings(), LiveSettings())
    assert rig.output.retarget(config)
    rig.output.set_format(RATE, 1)
    (folder / "pcm0p/sub0/hw_params").write_text(HW_PARAMS.format("S16_LE", 2, RATE))
    with pytest.raises(LostError, match="hw:PCH,0 plays S16_LE instead of S32_LE"):
        rig.tick()
    assert rig.states.state is DaemonState.WAITING_FOR_DEVICE
    rig.tick()
    assert rig.output.name == "hw:PCH,0"
    assert rig.output.delay_s(None) == pytest.approx(0.016)
    rig.play()
    rig.output.close()
    assert rig.output.delay_s(None) == 0.0
    block = encode(np.column_stack([TONE, TONE]), PcmFormat.I16)
    assert block in rig.path(30).read_bytes()


def test_a_card_that_cannot_be_opened_is_awaited_with_a_reason_and_ever_less_often(
    tmp_path: Path, pcms: PcmConfig
) -> None:
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


def test_a_card_that_offers_nothing_that_suits_says_what_it_offers(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.output.set_format(RATE, 3)
    with pytest.raises(NotFoundError, match="hw:DAC,0: the card cannot be opened with 3 to 32"):
        rig.output.locate(None)
