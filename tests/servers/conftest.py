"""Each kind of sound server, in a folder of its own, and PortAudio led to it."""

import gc
from collections.abc import Iterator
from pathlib import Path

import pytest

from device.server.pulse import PulseConnection
from device.stream import portaudio
from device.stream.pcms import PcmConfig
from device.stream.streams import CaptureStream, PlaybackStream
from tests.servers.listening import Notes, count_stuck, need, own_server
from tools.live_latency.bursts import REFERENCE
from tools.sound_server import PROGRAMS, SoundServer, missing_programs

QUANTUM = 1_024


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    here = Path(__file__).parent
    for item in items:
        if here in item.path.parents and "server" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.servers)


def started(kind: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    need(missing_programs(kind))
    with own_server(kind) as server:
        for name, value in server.environment.items():
            if name.startswith(("PULSE_", "XDG_", "HOME", "DBUS_", "PIPEWIRE_")):
                monkeypatch.setenv(name, value)
        yield server


@pytest.fixture(params=sorted(PROGRAMS))
def server(request, monkeypatch):
    yield from started(request.param, monkeypatch)


@pytest.fixture
def pipewire(monkeypatch):
    yield from started("pipewire", monkeypatch)


@pytest.fixture
def pulse(monkeypatch):
    yield from started("pulse", monkeypatch)


@pytest.fixture(params=["python", "native"])
def engine(request, server):
    if request.param == "native" and server.kind != "pipewire":
        pytest.skip("the native engine needs PipeWire")
    return request.param


@pytest.fixture
def timed_pipewire(pipewire):
    """PipeWire in cycles of QUANTUM frames, for measurements of delays against a reference."""
    pipewire.add_reference(REFERENCE)
    pipewire.set_clock("force-quantum", QUANTUM)
    return pipewire


@pytest.fixture
def pcms(server):
    config = PcmConfig("cushion_tap", "cushion_output")
    yield config
    for item in gc.get_objects():  # what a failed test left open must not fail the next one
        if isinstance(item, (CaptureStream, PlaybackStream)):
            item.close()
    assert len(portaudio.open_tags) == count_stuck()
    config.close()


@pytest.fixture
def notes():
    return Notes()


@pytest.fixture
def connection(server, notes):
    connection = PulseConnection(notes)
    yield connection
    connection.close()
