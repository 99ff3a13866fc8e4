"""Real libusb and the whole command in front of USB devices that answer as the kernel's would."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from device.usb.descriptors import parse_dump
from tests.support import usb_builder
from tests.support.usb_shapes import SHAPES as ALL_SHAPES
from tests.support.usb_shapes import controls_of, headset_adapter, hid, plain_dac

ROOT = Path(__file__).parents[3]
SYSTEM_PYTHON = "/usr/bin/python3"
CUSHION = (sys.executable, "-m", "audioflinger_hook")
SHAPES = {1: headset_adapter, 2: plain_dac}
versions = pytest.mark.parametrize("uac", [pytest.param(1, marks=pytest.mark.exhaustive), 2])
NO_SUPERUSER = ("setpriv", "--bounding-set=-dac_override,-dac_read_search", "--inh-caps=-all", "--")
"""Root may open everything, unless it is told not to."""


def why_not() -> str:
    if not shutil.which("umockdev-wrapper"):
        return "umockdev is missing; run tools/fetch_usb_mock.sh"
    if not shutil.which("lsusb"):
        return "lsusb is missing; run tools/fetch_usb_mock.sh"
    check = "import gi; gi.require_version('UMockdev', '1.0'); gi.require_version('GLib', '2.0')"
    done = subprocess.run([SYSTEM_PYTHON, "-c", check], capture_output=True)
    return "" if done.returncode == 0 else "umockdev has no bindings; run tools/fetch_usb_mock.sh"


pytestmark = pytest.mark.skipif(bool(why_not()), reason=why_not() or "-")


def plugged(uac: int, port: str = "1-1", address: int = 5, **options: Any) -> dict[str, Any]:
    """A device for the testbed. options: of it, those of its dac under "dac"."""
    configuration = SHAPES[uac]()
    device = usb_builder.device(**{"product": 0xDAC0 + uac, **options.pop("ids", {})})
    dac: dict[str, Any] = {"descriptors": (device + configuration).hex(), "uac": uac}
    dac |= {"strings": ["Soft", f"DAC {uac}", "SN1"], **controls_of(configuration)}
    dac |= options.pop("dac", {})
    return {"port": port, "address": address, "card": 1, "dac": dac, **options}


def within(scene: list[dict[str, Any]], *command: str, log: Path | None = None) -> Any:
    """What a command gives that sees these devices and no others."""
    logs = {} if log is None else {"CUSHION_USBMOCK_LOG": str(log)}
    serve = ("umockdev-wrapper", SYSTEM_PYTHON, "-m", "tests.support.usbmock.serve")
    env = {**os.environ, "PYTHONPATH": str(ROOT), **logs}
    options: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "timeout": 60}
    whole = [*serve, json.dumps(scene), "--", *command]
    return subprocess.run(whole, cwd=ROOT, env=env, text=True, **options)


def cushion(scene: list[dict[str, Any]], *arguments: str, log: Path | None = None) -> Any:
    return within(scene, *CUSHION, *arguments, log=log)


def document(scene: list[dict[str, Any]], *arguments: str, log: Path | None = None) -> Any:
    done = cushion(scene, *arguments, "--json", log=log)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def program(device: dict[str, Any], text: str, *arguments: str) -> Any:
    done = within([device], sys.executable, "-c", text, *arguments)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_two_alike_are_told_apart_by_their_ports_however_narrow_the_terminal():
    ids = {"vendor": 0x152A, "product": 0x8750}
    strings = ["Topping", "D50s USB Audio 2.0 of a very long name", "00"]
    twins = [
        plugged(2, port, address, card=card, ids=ids, dac={"strings": strings})
        for port, address, card in (("1-1.4.3", 5, 1), ("1-2", 6, 2))
    ]
    done = within(twins, "env", "COLUMNS=80", *CUSHION, "devices")
    assert done.returncode == 0, done.stderr
    lines = [line.strip() for line in done.stdout.splitlines()]
    names = [line for line in lines if line.startswith("usb:")]
    assert names == ["usb:152a:8750:00@1-1.4.3", "usb:152a:8750:00@1-2"]
    assert "is also hw:2,0" in lines
    for name in names:
        assert cushion(twins, "usb", "describe", name).returncode == 0
    refused = cushion(twins, "usb", "describe", "usb:152a:8750")
    assert refused.returncode == 3
    assert "is not one device but 2" in refused.stderr
    assert names[1] in refused.stderr


def test_the_active_configuration_is_listed_and_not_the_first_one():
    hid_only = usb_builder.configuration(hid(0, 0x81))
    plays = usb_builder.numbered(headset_adapter(), 2)
    ids = {"vendor": 0x05AC, "product": 0x110A}
    raw = (usb_builder.device(**ids, configurations=2) + hid_only + plays).hex()
    adapter = plugged(1, dac={"descriptors": raw}, configuration=2)
    (device,) = document([adapter], "devices")["usb"]
    assert (device["audio_class"], device["volume"], device["mute"]) == (1, True, True)
    assert [each["samplerates"] for each in device["formats"]] == [[48_000, 44_100]]
    assert "configuration 2 is the active one" in cushion([adapter], "usb", "describe").stdout
    configurations = document([adapter], "usb", "describe")[0]["configurations"]
    assert [each["active"] for each in configurations] == [False, True]
    # It is also the one that is asked and set.
    free = plugged(1, dac={"descriptors": raw}, configuration=2, bound=False)
    assert document([free], "usb", "describe")[0]["settings"]["samplerate"] == 44_100


def test_the_rates_that_a_clock_was_asked_for_are_told():
    done = cushion([plugged(2, bound=False)], "usb", "describe")
    assert "samplerates of its clock: 44100, 48000 Hz" in done.stdout
    assert "PCM of 24 bits in 4 bytes, 2 channels, 44100, 48000 Hz, asynchronous" in done.stdout


@pytest.mark.parametrize("shape", ALL_SHAPES)
def test_the_text_of_lsusb_gives_the_bytes_that_it_was_made_from(shape):
    raw = usb_builder.device() + ALL_SHAPES[shape]
    text = within([plugged(2, bound=False, dac={"descriptors": raw.hex()})], "lsusb", "-v").stdout
    (found,) = parse_dump(text.encode())
    assert len(found) == len(raw)
    different = [at for at in range(len(raw)) if found[at] != raw[at]]
    # It does not show what is behind the fields of an interface or endpoint that it knows.
    assert {found[at] for at in different} <= {0}
    assert not different or shape == "longer_than_the_standard"


SETS = """
import json, sys
from contextlib import closing
from device.alsa import set_card_volume
from device.alsa.mixer import CardMixer
from device.errors import CushionError

def told(ask):
    try:
        with closing(CardMixer(1)) as mixer:
            return ask(mixer)
    except CushionError as error:
        return [error.exit_code, str(error)]

asks = (
    lambda _: set_card_volume(1, *map(float, sys.argv[1:])),
    lambda mixer: [mixer.volume_db(volume) for volume in mixer.volumes],
    lambda mixer: [mixer.muted(switch) for switch in mixer.switches],
)
print(json.dumps([told(ask) for ask in asks]))
"""


@pytest.mark.parametrize(("wanted", "set_db"), [("-9.9 0", -10.0), ("12 0", 0.0), ("0 -20", -20.0)])
def test_a_whole_card_is_set_to_a_level_never_above_it_and_its_mute_is_lifted(wanted, set_db):
    told = program(plugged(1, mixer={"on": False}), SETS, *wanted.split())
    assert told == [[set_db], [[set_db] * 2], [[False]]]


SWITCH, VOLUME = 1, 2

WHY_NOT: dict[str, tuple[Any, ...]] = {
    "is asked for no level": ({}, "volume nan dB is not a number; choose one up to 0", "nan"),
    "keeps the mute": ({"drops": [SWITCH]}, "'PCM Playback Switch' stays muted"),
    "has no volume": ({"controls": [SWITCH]}, "has a mute and no volume"),
    "has a volume of one value": ({"lowest": 128}, "does not say what the steps"),
    "is never as quiet": ({"lowest": 100}, "the lowest level of 'PCM Playback Volume' is -14 dB"),
    "drops the volume": ({"drops": [VOLUME]}, "'PCM Playback Volume' was set to -30 dB and is -8"),
    "stalls": ({"stalls": [VOLUME]}, "does not answer"),
    "vanishes": ({"vanishes": True}, "is missing"),
}


@pytest.mark.parametrize("which", WHY_NOT)
def test_a_muted_card_that_cannot_be_set_so_low_stays_muted_and_says_why(which):
    mixer, why, *wanted = WHY_NOT[which]
    device = plugged(1, mixer={"on": False, **mixer})
    (exit_code, message), _, mutes = program(device, SETS, *(wanted or ["-30"]))
    assert why in message
    assert exit_code in (2, 3)
    assert (mutes == [[True]]) is (which != "vanishes")


@versions
def test_while_its_driver_holds_it_it_is_listed_and_its_card_is_asked_alone(uac, tmp_path):
    log, scene = tmp_path / "log", [plugged(uac)]
    described = document(scene, "usb", "describe", f"usb:1209:dac{uac}", log=log)
    assert described["settings"] is None
    assert described["configurations"][0]["problems"] == []
    (asked,) = json.loads(log.read_text()).values()
    assert not [request for request in asked if request[0] & 0x60]
    volume = {"name": "PCM Playback Volume", "db": [-8.0, -8.0], "highest_db": 0.0}
    mixer = {
        "volumes": [{**volume, "lowest_db": None}],  # its lowest step is silence
        "mutes": [{"name": "PCM Playback Switch", "muted": [False]}],
        "problem": None,
    }
    (listed,) = document(scene, "devices")["usb"]
    assert described["mixer"] == listed["mixer"] == mixer
    names = {"manufacturer": "Soft", "product": f"DAC {uac}", "audio_class": uac}
    names |= {"device": f"usb:1209:dac{uac}:SN1", "hw": ["hw:1,0"], "drivers": ["snd-usb-audio"]}
    assert names.items() <= listed.items()
    assert listed["formats"][0]["channels"] == 2
    assert "-8.0 dB" in cushion(scene, "devices").stdout
    told = cushion(scene, "usb", "describe").stdout
    assert "PCM Playback Volume of the sound card: -8.00 dB, silence to +0.00 dB" in told
    assert "PCM Playback Switch of the sound card: not muted" in told


@pytest.mark.sweep
@versions
@pytest.mark.parametrize("bound", [True, False])
def test_volumes_are_told_without_a_driver_or_when_taken_over(uac, bound):
    take = ["--take-over"] if bound else []
    scene = [plugged(uac, bound=bound)]
    settings = document(scene, "usb", "describe", f"usb:1209:dac{uac}", *take)["settings"]
    assert [volume["channel"] for volume in settings["volumes"]] == [1, 2]
    for volume in settings["volumes"]:
        assert (volume["db"], volume["lowest_db"], volume["highest_db"]) == (-8.0, -64.0, 0.0)
    assert (settings["mutes"], settings["samplerate"]) == ([{"channel": 0, "muted": False}], 44_100)


@pytest.mark.exhaustive
@versions
def test_a_device_that_stalls_everything_is_described_all_the_same(uac):
    scene = [plugged(uac, bound=False, dac={"stalls": True})]
    done = cushion(scene, "usb", "describe", f"usb:1209:dac{uac}")
    assert (done.returncode, "plays: interface 1.1" in done.stdout) == (0, True)
    assert "refuses the request" in done.stderr
    assert "Traceback" not in done.stderr


@versions
def test_volume_rate_and_mute_of_a_device_without_a_driver_are_set_and_read_back(uac, tmp_path):
    log, scene = tmp_path / "log", [plugged(uac, bound=False)]
    wanted = ("--volume-db", "-20.2", "--samplerate", "48000", "--mute", "on")
    done = cushion(scene, "usb", "set", f"usb:1209:dac{uac}", *wanted, log=log)
    assert (done.returncode, done.stderr) == (0, "")
    volumes = [f"volume of channel {channel}: -20.50 dB" for channel in (1, 2)]
    lines = ["mute of channel 0: on", "samplerate: 48000 Hz", *volumes]
    assert done.stdout.splitlines() == lines
    (asked,) = json.loads(log.read_text()).values()
    sets = [data for request_type, *_, data in asked if request_type in (0x21, 0x22)]
    assert sets == ["01", *(["80bb00"] if uac == 1 else ["80bb0000"]), "80eb", "80eb"]


@pytest.mark.parametrize(
    ("options", "dac", "code", "words"),
    [
        (["--volume-db", "-30"], {"ignores": True}, 3, "takes -30 dB for channel 1"),
        (["--volume-db", "-30"], {"keeps_volume": True}, 3, "refuses the request"),
        (["--volume-db", "-30"], {"volume_range": (-0x1400, 0, 1)}, 3, "lowest volume of channel"),
        (["--volume-db", "-30"], {"volume_range": (0, -0x1400, 1)}, 3, "not a valid range"),
        (["--volume-db", "nan"], {}, 2, "not a number"),
        (["--samplerate", "12345"], {}, 3, "refuses the request"),
        (["--samplerate", "0"], {}, 2, "not possible"),
        ([], {}, 2, "needs --volume-db, --samplerate or --mute"),
        (["--mute", "off", "--take-over"], {}, 2, "leave out --hex, --take-over"),
        (["--mute", "perhaps"], {}, 2, "'perhaps' is not known; allowed: on, off"),
    ],
)
def test_what_cannot_be_set_is_told_and_no_mute_is_lifted(options, dac, code, words, tmp_path):
    scene = [plugged(2, bound=False, dac={**dac, "mutes": {0: 1}})]
    done = cushion(scene, "usb", "set", "usb:1209:dac2", *options, log=tmp_path / "log")
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    (asked,) = json.loads((tmp_path / "log").read_text()).values()
    mutes = (0x21, 1, scene[0]["dac"]["unit"])
    assert mutes not in [(kind, value >> 8, index >> 8) for kind, _, value, index, _ in asked]


def test_a_device_of_a_driver_is_not_set_past_it():
    done = cushion([plugged(2)], "usb", "set", "usb:1209:dac2", "--volume-db", "-30")
    assert done.returncode == 3
    assert "belongs to the driver snd-usb-audio" in done.stderr


TAKES_OVER = """
import os, signal, sys
from device.usb import find_devices
from device.usb.take_over import take_over
(device,) = find_devices().devices
with take_over(device) as control:
    for channel in control.volume_channels:
        control.set_volume_db(channel, -30.0)
    if sys.argv[1] == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
"""

LOOKS = """
import subprocess, sys, time
from device.usb import find_devices
from device.usb.control import open_device
import usb.util
subprocess.run([sys.executable, "-c", sys.argv[1], sys.argv[2]])
(device,) = find_devices().devices
deadline_s = time.monotonic() + 10.0
while time.monotonic() < deadline_s:
    handle = open_device(device)
    attached = handle.is_kernel_driver_active(0)
    usb.util.dispose_resources(handle)
    if attached:
        break
print(attached)
"""


@pytest.mark.exhaustive
@versions
@pytest.mark.parametrize("ends", ["well", "killed"])
def test_what_was_taken_is_given_back_also_by_one_who_is_killed(uac, ends, tmp_path):
    log = tmp_path / "log"
    done = within([plugged(uac)], sys.executable, "-c", LOOKS, TAKES_OVER, ends, log=log)
    assert done.stdout.strip() == "True", done.stderr
    (asked,) = json.loads(log.read_text()).values()
    sets = [request for request in asked if request[0] == 0x21 and request[2] >> 8 == 2]
    for channel in (1, 2):
        values = [data for _, _, value, _, data in sets if value & 0xFF == channel]
        assert values == ["00e2", "00f8"]  # -30 dB, then -8 dB again


@pytest.mark.exhaustive
@versions
def test_without_permission_all_that_the_kernel_tells_is_shown_and_the_way_out(uac):
    without = () if os.geteuid() else NO_SUPERUSER
    # env: what is missing is an exit code, too
    if without and subprocess.run(["env", *NO_SUPERUSER, "true"], capture_output=True).returncode:
        pytest.skip("this root cannot give up its privileges")
    scene = [plugged(uac, bound=False, permission=False)]
    describe = (*without, *CUSHION, "usb", "describe", f"usb:1209:dac{uac}")
    done = within(scene, *describe)
    assert done.returncode == 0, done.stderr
    assert "plays: interface 1.1" in done.stdout
    assert "permission" in done.stderr
    assert "cushion install-service --udev" in done.stderr
    for bound in (False, True):
        scene = [plugged(uac, bound=bound, permission=False)]
        taken = within(scene, *describe, "--take-over")
        assert (taken.returncode, taken.stdout) == (3, "")
        assert "cushion install-service --udev" in taken.stderr
    listed = within(scene, *without, *CUSHION, "devices", "--json")
    assert json.loads(listed.stdout)["usb"][0]["device"] == f"usb:1209:dac{uac}:SN1"


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("scene", "name", "words"),
    [([], (), "no USB audio device is plugged in"), ([1], ("usb:1209:dac7",), "usb:1209:dac7")],
)
def test_what_is_not_plugged_in_is_told_on_one_line(scene, name, words):
    done = cushion([plugged(uac) for uac in scene], "usb", "describe", *name)
    assert done.returncode == 3
    assert words in done.stderr
    assert done.stderr.count("\n") == 1


PULLS = """
import os, time
from device.errors import CushionError
from device.usb import find_devices, identify
from device.usb.control import open_control

def tell(line):
    with open(os.environ["CUSHION_USBMOCK"], "w") as pipe:
        pipe.write(line + "\\n")

def until(condition):
    began = time.monotonic()
    while time.monotonic() < began + 10.0:
        if condition(find_devices().devices):
            return time.monotonic() - began
        time.sleep(0.02)
    raise SystemExit("nothing changed")

(device,) = find_devices().devices
name = identify(device, [device])
control = open_control(device)
tell("unplug 1-1")
print(until(lambda devices: not devices))
print(find_devices().reason)
try:
    control.volume_db(1)
    print("it answered")
except CushionError as error:
    print(type(error).__name__, error)
tell("plug 1-1 9")
print(until(lambda devices: devices))
(again,) = find_devices().devices
print(again.address, identify(again, [again]) == name)
"""


@versions
def test_unplug_and_plug_are_noticed_and_the_device_is_known_again(uac):
    done = within([plugged(uac, bound=False)], sys.executable, "-c", PULLS)
    assert done.returncode == 0, done.stderr
    vanished_s, gone, asked, appeared_s, back = done.stdout.splitlines()
    assert (float(vanished_s) < 0.6, float(appeared_s) < 1.0) == (True, True), done.stdout
    assert gone.startswith("no USB audio device")
    assert asked.startswith(("NoUsbDeviceError", "UsbAccessError"))
    assert "plug it in again" in asked
    assert back == "9 True"
