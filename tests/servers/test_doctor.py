"""`cushion doctor` names the cause of each broken set-up, and finds nothing in a healthy one."""

import json
import re
import shutil
import signal
import subprocess
import time
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

from audioflinger_hook.service.runtime_folder import LOCK_NAME
from device.server.pulse import PulseConnection
from tests.servers.daemons import CUSHION, ROOT, environment, running, tone
from tests.servers.listening import need, playing, wait_for
from tools.sound_server import SoundServer

pytestmark = pytest.mark.servers

ANSWERS_WITHIN_S = 30.0  # also if nothing answers, on a busy machine
NO_BUS = {"DBUS_SYSTEM_BUS_ADDRESS": "unix:path=/nonexistent"}
WITHOUT_REALTIME = ("prlimit", "--rtprio=0:0", "setpriv", "--bounding-set", "-sys_nice")


class Visit:
    """One run of the doctor. names: of the findings, without those of every machine here."""

    def __init__(self, code: int, document: dict[str, Any]) -> None:
        self.code, self.document = code, document
        found = document["findings"]
        self.names = [one["name"] for one in found if one["name"] != "no-realtime"]
        self.wrong = {one["name"]: one["wrong"] for one in found}
        self.commands = {one["name"]: one["command"] for one in found}

    def facts(self, label: str) -> str:
        return "\n".join(one["text"] for one in self.document["facts"] if one["label"] == label)


def visit(server, *arguments, variables=None, within=(), root=ROOT) -> Visit:
    done = subprocess.run(
        [*within, *CUSHION, "doctor", "--json", *arguments],
        env={**environment(server), "PYTHONPATH": str(root), **(variables or {})},
        cwd=root,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=ANSWERS_WITHIN_S,
    )
    assert done.returncode in (0, 1), done
    assert "Traceback" not in done.stderr, done.stderr
    return Visit(done.returncode, json.loads(done.stdout))


def configure(server: SoundServer, text: str = 'device = "sink:haptic"\n') -> Path:
    path = Path(server.environment["XDG_CONFIG_HOME"]) / "cushion" / "config.toml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)
    return path


@pytest.fixture
def configured(pipewire):
    configure(pipewire)
    return pipewire


def test_a_healthy_set_up_has_no_finding(configured) -> None:
    with running(configured, device=None, engine=None, ready=False) as daemon:
        daemon.wait(lambda status: status.engine == "native", "native engine")
        found = visit(configured, "--measure")
    assert found.names == []
    assert found.code == len(found.document["findings"])  # only a machine without real-time has any
    delay = found.document["delay"]
    assert delay["bursts"] >= 3
    assert 2.0 <= delay["delay_ms"] <= 30.0
    assert ".vibration -> haptic (" in found.facts("link")


def finds(server: SoundServer, name: str, *words: str, **options: Any) -> str:
    """What the doctor advises without a daemon; it finds this, and says so in these words."""
    found = visit(server, **options)
    assert (found.code, found.names) == (1, [name, "no-daemon"])
    assert [word for word in words if word not in found.wrong[name]] == []
    return str(found.commands[name])


def test_no_server_is_named(configured) -> None:
    configured.stop()
    finds(configured, "no-server", configured.address)


def test_a_server_that_hangs_is_told_from_none(server) -> None:
    configure(server)
    server.pause()
    try:
        began_s, found = time.monotonic(), visit(server)
    finally:
        server.resume()
    assert found.names == ["server-hangs", "no-daemon"]
    assert time.monotonic() - began_s < ANSWERS_WITHIN_S


def test_pipewire_without_pipewire_pulse_is_named(configured) -> None:
    command = finds(configured, "no-pulse", variables={"PULSE_SERVER": "unix:/nonexistent"})
    assert command == "systemctl --user start pipewire-pulse"


def test_the_haptic_sink_as_default_is_named_with_the_command(server) -> None:
    configure(server)
    server.choose_default("haptic")
    found = visit(server)
    assert "wrong-default-sink" in found.names
    assert "'haptic'" in found.wrong["wrong-default-sink"]
    assert found.commands["wrong-default-sink"] == "pactl set-default-sink desktop"
    server.pactl(*found.commands["wrong-default-sink"].split()[1:])
    assert "wrong-default-sink" not in visit(server).names


def mute(server: SoundServer, volume: str) -> None:
    """Mute the device at a volume; on PipeWire 1.4, a sink has none before it has played."""
    with playing(server, "haptic", tone(60.0, 60.0)):
        wait_for(lambda: "RUNNING" in server.pactl("list", "short", "sinks"), "sound")
        server.pactl("set-sink-volume", "haptic", volume)
        server.pactl("set-sink-mute", "haptic", "1")


def test_a_muted_device_is_named_and_unmuted_at_its_volume_while_nothing_plays(configured) -> None:
    mute(configured, "60%")
    finds(configured, "device-muted", "volume 60 %")
    with playing(configured, "haptic", tone(60.0, 60.0)):
        wait_for(lambda: "RUNNING" in configured.pactl("list", "short", "sinks"), "sound")
        fixed = visit(configured, "--fix")
    assert "device-muted" in fixed.names
    assert "because a stream plays" in fixed.document["repaired"][0]
    fixed = visit(configured, "--fix")
    assert (fixed.names, configured.pactl("get-sink-mute", "haptic")) == (["no-daemon"], "Mute: no")
    assert "60%" in configured.pactl("get-sink-volume", "haptic")


def test_a_device_above_full_volume_stays_muted(configured) -> None:
    mute(configured, "130%")
    assert "device-muted" in visit(configured, "--fix").names
    assert configured.pactl("get-sink-mute", "haptic") == "Mute: yes"


def test_an_output_at_another_rate_than_the_graph_is_named(configured) -> None:
    configured.add_sink("cd", rate_hz=44_100)
    configured.choose_default("cd")
    finds(configured, "rate-clash", "'cd' runs at 44100 Hz", "48000 Hz")


def test_a_forced_rate_is_named_and_its_command_ends_it(configured) -> None:
    configured.set_clock("force-rate", 44_100)
    found = visit(configured)
    assert set(found.names) == {"rate-clash", "no-daemon"}
    assert "forced to 44100 Hz" in found.wrong["rate-clash"]
    subprocess.run(found.commands["rate-clash"].split(), env=configured.environment, check=True)
    assert visit(configured).names == ["no-daemon"]


def test_missing_real_time_permission_is_named(configured) -> None:
    found = visit(configured, within=WITHOUT_REALTIME, variables=NO_BUS)
    assert "RLIMIT_RTPRIO is 0" in found.wrong["no-realtime"]
    assert "rtkit is missing" in found.wrong["no-realtime"]
    assert "rtprio 20" in found.commands["no-realtime"]


def test_rtkit_on_the_bus_is_a_permission(configured, tmp_path) -> None:
    need([program for program in ("dbus-daemon", "busctl") if shutil.which(program) is None])
    (tmp_path / "rtkit.service").write_text(
        "[D-BUS Service]\nName=org.freedesktop.RealtimeKit1\nExec=/bin/false\n"
    )
    address = f"unix:path={configured.folder}/bus"
    (tmp_path / "bus.conf").write_text(
        f"<busconfig><listen>{address}</listen><auth>EXTERNAL</auth>"
        f"<servicedir>{tmp_path}</servicedir>"
        '<policy context="default"><allow send_destination="*"/>'
        '<allow receive_sender="*"/></policy>'
        "</busconfig>"
    )
    command = ["dbus-daemon", f"--config-file={tmp_path}/bus.conf", "--nofork"]
    with subprocess.Popen(command) as bus:
        try:
            wait_for(lambda: Path(f"{configured.folder}/bus").exists(), "the bus")
            variables = {"DBUS_SYSTEM_BUS_ADDRESS": address}
            found = visit(configured, within=WITHOUT_REALTIME, variables=variables)
        finally:
            bus.kill()
    assert "no-realtime" not in found.wrong
    assert "rtkit present" in found.facts("real-time")


def test_two_daemons_that_play_are_named_with_their_processes(server, tmp_path) -> None:
    configure(server)
    other = {"XDG_RUNTIME_DIR": str(tmp_path)}
    with (
        running(server) as first,
        running(server, variables=other, ready=False) as second,
        closing(PulseConnection()) as connection,
    ):
        pids = {first.process.pid, second.process.pid}
        wait_for(lambda: pids <= connection.processes(), "both daemons", 20.0)
        found = visit(server)
    assert "second-daemon" in found.names
    assert all(f"process {pid}" in found.wrong["second-daemon"] for pid in pids)
    assert found.commands["second-daemon"] == f"kill {second.process.pid}"
    assert "no-daemon" not in found.names


def test_the_lock_of_a_daemon_stays_and_one_that_hangs_is_named_with_its_process(configured):
    with running(configured) as daemon:
        visit(configured, "--fix")
        assert (configured.folder / "cushion" / LOCK_NAME).exists()
        daemon.process.send_signal(signal.SIGSTOP)
        found = visit(configured)
        daemon.process.send_signal(signal.SIGCONT)
        assert "daemon-hangs" in found.names
        assert found.commands["daemon-hangs"] == f"kill -9 {daemon.process.pid}"


def test_the_lock_of_a_killed_daemon_is_named_and_removed(configured) -> None:
    with running(configured) as daemon:
        daemon.process.kill()
        daemon.process.wait(10.0)
    found = visit(configured)
    assert {"stale-lock", "no-daemon"} <= set(found.names)
    assert f"process {daemon.process.pid}" in found.wrong["stale-lock"]
    assert "stale-lock" not in visit(configured, "--fix").names
    assert not (configured.folder / "cushion" / LOCK_NAME).exists()


def test_a_plugin_that_was_not_built_is_named(configured, tmp_path) -> None:
    for package in ("audioflinger_hook", "device"):
        left_out = shutil.ignore_patterns("haptic_cushion.so", "__pycache__", "*.c")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=left_out)
    assert finds(configured, "no-plugin", root=tmp_path) == "make run"


def test_a_plugin_that_a_configuration_needs_is_installed_again(configured) -> None:
    env = environment(configured)
    subprocess.run([*CUSHION, "plugin", "install", "--device", "haptic"], env=env, check=True)
    assert visit(configured).names == ["no-daemon"]
    plugin = configured.folder / "home/.local/share/haptic-cushion/haptic_cushion.so"
    plugin.unlink()
    finds(configured, "plugin-copy")
    assert visit(configured, "--fix").names == ["no-daemon"]
    assert plugin.is_file()


def test_a_full_disk_is_named_with_its_folder(configured, small_disk) -> None:
    with suppress(OSError), (small_disk / "full").open("wb", buffering=0) as file:
        while file.write(bytes(4_096)):
            pass
    state = {"XDG_STATE_HOME": str(small_disk)}
    finds(configured, "disk-full", "0 kB", str(small_disk), variables=state)


def test_a_missing_runtime_folder_is_made(configured, tmp_path) -> None:
    folder = tmp_path / "run"
    variables = {"XDG_RUNTIME_DIR": str(folder)}
    assert "folder" in visit(configured, variables=variables).names
    assert visit(configured, "--fix", variables=variables).names == ["no-daemon"]
    assert folder.stat().st_mode & 0o777 == 0o700


def test_each_mistake_of_the_config_is_named_with_its_line(configured) -> None:
    configure(configured, 'device = "sink:haptic"\ngain_db = 99\n[transform]\ndynamcs = 1\n')
    found = visit(configured)
    assert found.names == ["config", "config", "no-daemon"]
    first, second, *_ = (one["wrong"] for one in found.document["findings"])
    assert re.search("gain_db.*99", first)
    assert ("dynamcs" in second, "line 4" in second) == (True, True)


def test_pulseaudio_alone_is_named(pulse) -> None:
    configure(pulse)
    finds(pulse, "pulseaudio", "Python engine")


def test_the_report_has_no_name_of_a_file_a_stream_or_a_person(configured, tmp_path) -> None:
    private = "Private Diary"
    configure(configured, f'device = "sink:haptic"\nrig = "/home/{private}/seat.toml"\n')
    report, empty = tmp_path / "report.txt", tmp_path / "empty.toml"
    empty.touch()
    with (
        playing(configured, "desktop", tone(200.0, 60.0), name=private),
        running(configured, "--config", str(empty)),
    ):
        shown = visit(configured, "--report", str(report))
    assert private in shown.wrong["config"]
    text = report.read_text()
    assert not any(hidden in text for hidden in (private, "seat.toml", str(configured.folder)))
    assert "rig" in text  # the key of the mistake stays
    assert "haptic: 48000 Hz" in text
