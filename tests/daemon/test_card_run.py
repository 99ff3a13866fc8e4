"""`cushion run --device hw:CARD` as a whole, without a sound server; the card is a file."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from audioflinger_hook.config.settings import LiveSettings, Settings
from audioflinger_hook.daemon import endpoints
from audioflinger_hook.daemon.engine import Clocks
from audioflinger_hook.daemon.outputs.base import Fill
from audioflinger_hook.daemon.outputs.card import CardOutput
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.daemon.supervisor import Supervisor
from audioflinger_hook.daemon.wake import Wake
from audioflinger_hook.mixer.pcm import PcmFormat, decode
from audioflinger_hook.service.state import Cause, DaemonState
from audioflinger_hook.sources import TapAddress
from device.address import DeviceAddress, parse_device
from device.errors import LostError, NotFoundError, UsageError
from device.stream import portaudio
from device.units import Float32Array
from tests.support.alsa_files import ToFile
from tests.support.commands import call, noise, refused, sound
from tests.support.sound_cards import ASYNC, Cards

RATE = 44_100
ONLY_96K = ASYNC.replace("44100, 48000, 88200, 96000, 176400, 192000", "96000")


class Paced:
    """A block when a card of that rate, Hz, would ask for it: ALSA's file takes it at once."""

    def __init__(self, fill: Fill, samplerate: int) -> None:
        self._fill = fill
        self._samplerate = samplerate
        self._due_s = 0.0

    def fill(self, out: Float32Array, now_s: float) -> None:
        self._due_s = (self._due_s or now_s) + len(out) / self._samplerate
        time.sleep(max(0.001, self._due_s - time.monotonic()))
        self._fill(out, time.monotonic())


class Rig:
    """A daemon that plays a file to a card; each card's bytes go to a file of its number."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        pytest.importorskip("pyaudio")
        self.folder = folder
        self.cards = cards = Cards(folder / "asound")

        class FileCard(CardOutput):
            """A card that is a file."""

            def __init__(self, *arguments: Any, **options: Any) -> None:
                options |= {"root": cards.root, "target": self.file}
                super().__init__(*arguments, **options)

            def file(self, card: int, device: int) -> ToFile:
                return ToFile(folder / f"{card}.raw")

            def maintain(self, connection: Any, fill: Fill, now_s: float) -> None:
                assert self._found
                paced = Paced(fill, self._found.samplerate or RATE)
                super().maintain(connection, paced.fill, now_s)

        monkeypatch.setattr(endpoints, "CardOutput", FileCard)
        source = sound(folder / "in.wav", noise(20 * RATE, 2), RATE)
        # without real-time priority: a file that takes all at once must not keep others waiting
        live = LiveSettings(realtime=False)
        self.order = RunConfig(
            TapAddress("file", str(source)), DeviceAddress("hw", "DAC"), Settings(), live
        )
        self.wake = Wake()
        clocks = Clocks(time.monotonic, time.thread_time)
        self.supervisor = Supervisor(self.order, clocks, self.wake)

    def until(self, state: DaemonState, limit_s: float = 10.0) -> str:
        """Tick until it is in that state; return the reason."""
        end_s = time.monotonic() + limit_s
        while True:
            self.run(0.02)
            report = self.supervisor.states.report(time.monotonic())
            if report.state is state:
                return report.reason
            assert time.monotonic() < end_s, report

    def run(self, seconds: float) -> None:
        """Tick for so long."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.supervisor.tick(time.monotonic())
            time.sleep(0.02)

    def heard(self, card: int) -> Float32Array:
        """What went to that card, as frames."""
        return decode((self.folder / f"{card}.raw").read_bytes(), PcmFormat.I32, 2)

    def close(self) -> None:
        self.supervisor.close(time.monotonic())
        self.wake.__exit__(None, None, None)
        assert len(portaudio.open_tags) == 0


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Rig]:
    rig = Rig(tmp_path, monkeypatch)
    yield rig
    rig.close()


def test_a_daemon_that_cannot_open_a_stream_says_why(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def hangs(*_: object) -> None:
        raise LostError("the server hangs")

    monkeypatch.setattr(rig.supervisor.output, "maintain", hangs)
    rig.cards.plug(30, "DAC", stream=ONLY_96K)
    rig.run(0.2)
    report = rig.supervisor.states.report(time.monotonic())
    assert (report.state, report.reason) == (DaemonState.STARTING, "the server hangs")


@pytest.mark.exhaustive
def test_a_card_is_awaited_played_to_pulled_out_and_played_to_again(rig: Rig) -> None:
    with pytest.raises(NotFoundError, match="no sound card 'DAC'"):
        rig.supervisor.look()
    assert "connect one" in rig.until(DaemonState.WAITING_FOR_DEVICE)
    rig.cards.plug(30, "DAC", stream=ONLY_96K)
    rig.until(DaemonState.RUNNING)
    rig.run(1.5)
    engine = rig.supervisor.engines.python
    assert engine is not None
    assert engine.samplerate == RATE
    assert engine.delay_line.samplerate_out == 96_000
    assert rig.supervisor.endpoints[1] == ("hw:DAC", "hw:DAC,0")
    rig.cards.unplug(30)
    assert "no sound card" in rig.until(DaemonState.WAITING_FOR_DEVICE)
    report = rig.supervisor.states.report(time.monotonic())
    assert report.recoveries[Cause.DEVICE_LOST] == 1
    rig.cards.plug(31, "DAC", stream=ASYNC)
    rig.until(DaemonState.RUNNING)
    rig.run(1.0)
    assert engine.delay_line.samplerate_out == RATE
    for card in (30, 31):
        vibration = rig.heard(card)
        assert np.abs(vibration).max() > 0.005
        np.testing.assert_array_equal(vibration[:, 0], vibration[:, 1])


def test_another_card_is_gone_over_to_while_it_runs_and_a_sink_is_not(rig: Rig) -> None:
    rig.cards.plug(30, "DAC", stream=ASYNC)
    rig.cards.plug(31, "Other", stream=ASYNC)
    rig.until(DaemonState.RUNNING)
    other = replace(rig.order, device=DeviceAddress("hw", "Other"))
    rig.supervisor.follow(other, time.monotonic())
    rig.run(0.5)
    assert rig.supervisor.endpoints[1] == ("hw:Other", "hw:Other,0")
    assert (rig.folder / "31.raw").stat().st_size
    for device in (DeviceAddress("sink", "a"), DeviceAddress("twin")):
        with pytest.raises(UsageError, match=f"'hw:Other' cannot become '{device}'"):
            rig.supervisor.follow(replace(other, device=device), time.monotonic())
    assert rig.supervisor.endpoints[1] == ("hw:Other", "hw:Other,0")


def test_a_card_keeps_its_own_time_and_needs_no_server(rig: Rig) -> None:
    assert rig.order.device_is_live
    assert rig.order.device_is_a_card
    assert not rig.order.needs_server
    assert replace(rig.order, tap=TapAddress("default")).needs_server
    sink = replace(rig.order, device=DeviceAddress("sink", "a"))
    assert sink.needs_server
    assert not sink.device_is_a_card
    assert not replace(rig.order, device=DeviceAddress("twin")).device_is_live


@pytest.mark.parametrize("text", ["hw:0", "hw:DAC,1", "hw:CARD=DAC,DEV=0"])
def test_cards_are_written_as_alsa_writes_them(text: str) -> None:
    assert str(parse_device(text)) == text


def test_a_card_that_is_written_otherwise_is_refused() -> None:
    error = refused(call("run", "--device", "hw:a,b"))
    assert "is not hw:CARD or hw:CARD,DEVICE" in error
