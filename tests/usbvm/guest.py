"""What is done inside the virtual machine: `python -m tests.usbvm.guest SCENE FOLDER`.

Each scene leaves in FOLDER what came of it, for the tests outside to judge. Seconds here pass by
instructions and leaps: limits are far away.
"""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from audioflinger_hook.service.json_codec import to_json
from audioflinger_hook.service.status_client import ask_status
from device.alsa.mixer import CardMixer
from device.errors import CushionError
from device.usb import UsbAudioDevice, find_devices, identify
from device.usb.mapping import hw_names
from tests.support import usb_builder
from tests.support.commands import call
from tests.support.usbmock.software_dac import SoftwareDac
from tests.usbvm.machine import order
from tests.usbvm.shapes import dac_1, dac_2, game_pad, headphones_3, two_configurations
from tests.usbvm.vhci import VirtualDac

CUSHION = (sys.executable, "-m", "audioflinger_hook")
RECORD = Path("/tmp/record")
SOUND = Path("/tmp/sound.wav")
RATE_HZ = 48_000
POLL_S = 0.05
LIMIT_S = 1_800.0
HOUR_S = 3_600.0


def devices(count: int) -> list[dict[str, Any]]:
    """The USB devices as the command lists them, once there are so many with a card."""
    await_cards(count)
    found: list[dict[str, Any]] = json.loads(call("devices", "--json").stdout)["usb"]
    assert len(found) == count, found
    return found


def await_cards(count: int) -> list[UsbAudioDevice]:
    """The USB devices, once there are so many with a card."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        found = [device for device in find_devices().devices if hw_names(device)]
        if len(found) == count:
            return found
        assert time.monotonic() < deadline_s, found
        time.sleep(POLL_S)


def sound(seconds: float, times: int = 1) -> str:
    """A tap of three tones that swell, and never fall silent. times: how often they come."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    tones = ((97.0, 0.31), (430.0, 0.73), (1_900.0, 1.17))
    waves = sum(
        0.2 * (1.3 + np.sin(2 * np.pi * pace_hz * time_s)) * np.sin(2 * np.pi * hz * time_s)
        for hz, pace_hz in tones
    )
    with soundfile.SoundFile(SOUND, "w", RATE_HZ, 1, subtype="FLOAT") as file:
        for _ in range(times):
            file.write(np.asarray(waves, np.float32))
    return f"file:{SOUND}"


def full_volume(hw: str) -> None:
    """Let a card pass samples as they are; QEMU's calls that +8 dB, and scales at 0 dB."""
    card = hw.removeprefix("hw:").partition(",")[0]
    listed = subprocess.run(["amixer", "-c", card, "controls"], capture_output=True, text=True)
    for line in listed.stdout.splitlines():
        number = line.partition(",")[0]
        for kind, value in (("Playback Volume", "100%"), ("Playback Switch", "on")):
            if kind in line:
                subprocess.run(["amixer", "-q", "-c", card, "cset", number, value], check=True)


def mixed(hw: str) -> list[dict[str, Any]]:
    """What our own mixer reads and sets, beside what ALSA's says of the same."""
    card = hw.removeprefix("hw:").partition(",")[0]
    told = []
    with closing(CardMixer(int(card))) as mixer:
        (switch,) = mixer.switches
        mutes = []
        for muted in (True, False):
            mixer.set_muted(switch, muted)
            mutes.append(list(mixer.muted(switch)))
        for volume in mixer.volumes:
            decibels: Any = volume.decibels
            set_db = mixer.set_volume_db(volume, 6.0)
            asks = ["amixer", "-c", card, "cget", f"name={volume.name}"]
            alsa = subprocess.check_output(asks, text=True)
            levels = re.search(r"min=(-?[\d.]+)dB,max=(-?[\d.]+)dB", alsa)
            steps = re.search(r": values=([\d,]+)", alsa)
            assert levels, alsa
            assert steps, alsa
            told.append(
                {
                    "range_db": [decibels.lowest_db, decibels.highest_db],
                    "alsa_range_db": [float(level) for level in levels.groups()],
                    "highest_db": decibels.highest_db,
                    "set_db": set_db,
                    "steps": [decibels.step_at_most(set_db)] * volume.channels,
                    "alsa_steps": [int(step) for step in steps[1].split(",")],
                    "muted": mutes,
                }
            )
    return told


class Run:
    """A running `cushion run`; states: what it was seen to be in, with the time."""

    def __init__(self, tap: str, *arguments: str) -> None:
        self.states: list[tuple[float, str]] = []
        self.statuses: list[dict[str, Any]] = []
        self.process = subprocess.Popen(
            [*CUSHION, "run", "--tap", tap, "--record", str(RECORD), *arguments],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    def look(self) -> dict[str, Any] | None:
        """What it tells of itself, None while it does not."""
        try:
            told = ask_status(LIMIT_S, time.monotonic)
        except CushionError:
            return None
        status: dict[str, Any] = json.loads(to_json(told))
        now_s = time.monotonic()
        if not self.states or self.states[-1][1] != status["state"]:
            self.states.append((now_s, status["state"]))
        self.statuses.append({"time_s": now_s, **status})
        return status

    def wait(self, condition: Callable[[dict[str, Any]], bool]) -> float:
        """Wait until it tells so; when that was."""
        deadline_s = time.monotonic() + LIMIT_S
        while True:
            assert self.process.poll() is None, self.process.communicate()
            status = self.look()
            if status is not None and condition(status):
                return time.monotonic()
            assert time.monotonic() < deadline_s, (self.states, status)
            time.sleep(POLL_S)

    def end(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=LIMIT_S)


def bits(folder: Path) -> dict[str, Any]:
    """Two cards alike: one is played to, by its name."""
    chosen, other = devices(2)
    settings = mixed(chosen["hw"][0])
    for device in (chosen, other):
        full_volume(device["hw"][0])
    run = Run(sound(20.0), "--device", chosen["device"], "--seconds", "4")
    _, told = run.process.communicate()
    assert run.process.returncode == 0, told
    return {"names": [chosen["device"], other["device"]], "mixed": settings}


def count_real_time(process: int) -> int:
    """How many of a process's threads have real-time priority."""
    policies = [
        os.sched_getscheduler(int(thread.name)) & ~os.SCHED_RESET_ON_FORK
        for thread in Path(f"/proc/{process}/task").iterdir()
    ]
    return policies.count(os.SCHED_RR)


def pulled(folder: Path) -> dict[str, Any]:
    """The card that plays is pulled out and plugged into another port an hour later."""
    (device,) = devices(1)
    full_volume(device["hw"][0])
    name = device["device"].partition("@")[0]
    run = Run(sound(30.0, 12), "--device", name)  # time may leap by minutes
    run.wait(lambda status: status["state"] == "running")
    time.sleep(3.0)
    first = count_real_time(run.process.pid)
    order(folder, "unplug", "dac")
    run.wait(lambda status: status["state"] != "running")
    time.sleep(1.0)
    run.process.send_signal(signal.SIGSTOP)  # or it would play before the volume is set
    time.clock_settime(time.CLOCK_REALTIME, time.time() + HOUR_S)
    order(folder, "plug", "dac", "3")
    (again,) = await_cards(1)
    full_volume(hw_names(again)[0])
    run.process.send_signal(signal.SIGCONT)
    went_on_s = time.monotonic()
    plays_s = run.wait(lambda status: status["state"] == "running")
    time.sleep(3.0)
    last, real_time = run.look(), count_real_time(run.process.pid)
    run.end()
    return {
        "ports": [device["port"], again.port],
        "real_time_threads": [first, real_time],
        "again_s": plays_s - went_on_s,
        "states": run.states,
        "last": last,
    }


def software(folder: Path, uac: int, ppm: float, seconds: float) -> dict[str, Any]:
    """A DAC in software, whose clock is off, or which asks for frames by its feedback."""
    configuration = {1: dac_1, 2: dac_2}[uac]()
    descriptors = usb_builder.device(product=0xDAC0 + uac) + configuration
    strings = ["Soft", f"DAC {uac}", "SN1"]
    dac = SoftwareDac(descriptors, uac, strings, volumes={1: 0, 2: 0}, mutes={0: 0})
    with (folder / "taken.raw").open("wb") as taken, closing(VirtualDac(dac, taken.write, ppm=ppm)):
        (device,) = devices(1)
        full_volume(device["hw"][0])
        run = Run(sound(seconds + 60.0), "--device", device["device"].partition("@")[0])
        began = run.wait(lambda status: status["state"] == "running")
        while time.monotonic() < began + seconds:
            run.look()
            time.sleep(0.5)
        run.end()
    return {"statuses": run.statuses, "formats": device["formats"]}


def run_briefly(device: str, *arguments: str) -> Any:
    """A run of 2 s that ended by itself; again where time leapt past them in a file's reading."""
    for _ in range(5):
        done = call("run", "--tap", sound(20.0), "--device", device, "--seconds", "2", *arguments)
        if "the process stalled" not in done.stderr:
            break
    return done


def only_name() -> tuple[str, str]:
    """Name and ALSA's name of the only device, once it has a card."""
    (device,) = await_cards(1)
    return str(identify(device, [device])), hw_names(device)[0]


def unsettable(folder: Path) -> dict[str, Any]:
    """Muted DACs whose volume cannot be set: a run that sets it, and one that leaves it."""
    told = {}
    for which, has_volume in (("none", False), ("kept", True)):
        descriptors = usb_builder.device(product=0xDAC1) + dac_1(volume=has_volume)
        more: dict[str, Any] = {"volumes": {1: -256, 2: -256} if has_volume else {}}
        more |= {"mutes": {0: 1}, "keeps_volume": True}
        dac, taken = SoftwareDac(descriptors, 1, ["Soft", which], **more), bytearray()
        with closing(VirtualDac(dac, taken.extend)):
            runs = []
            for level in ("-30", "off"):
                done = run_briefly(only_name()[0], "--device-volume-db", level)
                runs.append([done.code, done.stderr, dac.mutes[0], any(taken)])
            told[which] = runs
        await_cards(0)
    return told


def shapes(folder: Path) -> dict[str, Any]:
    """A game pad, a DAC of 8 bits and one of 32 kHz alone, each played to by its name."""
    told = {}
    for name, ids, configuration, rates in (
        ("pad", {"vendor": 0x054C, "product": 0x0CE6}, game_pad(), [48_000]),
        ("coarse", {"product": 0xDAC8}, dac_1(subslot=1), [44_100, 48_000]),
        ("slow", {"product": 0xDAC9}, dac_1(rates=[32_000]), [32_000]),
    ):
        descriptors = usb_builder.device(**ids) + configuration
        volumes = {0: 0, 1: 0, 2: 0}
        dac = SoftwareDac(descriptors, 1, ["Soft", name], samplerates=rates, volumes=volumes)
        with (folder / f"{name}.raw").open("wb") as taken, closing(VirtualDac(dac, taken.write)):
            device, hw = only_name()
            full_volume(hw)
            done = run_briefly(device)
            told[name] = [done.code, done.stderr, dac.samplerate]
        await_cards(0)
    return told


def configurations(folder: Path) -> dict[str, Any]:
    """A DAC in its second configuration, and one of class 3."""
    told = {}
    both = (("second", 1, two_configurations()), ("class 3", 3, headphones_3()))
    more: dict[str, Any] = {"samplerates": [48_000], "volumes": {0: 0, 1: 0, 2: 0}}
    for name, uac, configuration in both:
        device = usb_builder.device(product=0xDAC1, configurations=2 if uac == 1 else 1)
        # Requests of class 3 are those of class 2.
        dac = SoftwareDac(device + configuration, min(uac, 2), ["Soft", name], **more)
        taken = bytearray()
        with closing(VirtualDac(dac, taken.extend)):
            if uac == 1:
                choose_configuration(2)
            name_now, hw = only_name()
            (listed,) = json.loads(call("devices", "--json").stdout)["usb"]
            described = call("usb", "describe", name_now).stdout
            full_volume(hw)
            done = run_briefly(name_now)
            told[name] = [listed, described, done.code, done.stderr, any(taken)]
        await_cards(0)
    return told


def choose_configuration(value: int) -> None:
    """Have the only device of this vendor use another configuration, as udev's rules may."""
    deadline_s = time.monotonic() + LIMIT_S
    while True:
        for vendor in Path("/sys/bus/usb/devices").glob("*/idVendor"):
            if vendor.read_text().strip() == "1209":
                (vendor.parent / "bConfigurationValue").write_text(str(value))
                return
        assert time.monotonic() < deadline_s
        time.sleep(POLL_S)


SCENES: dict[str, Callable[[Path], dict[str, Any]]] = {
    "bits": bits,
    "pulled": pulled,
    "fast": lambda folder: software(folder, 1, 200.0, 26.0),
    "slow": lambda folder: software(folder, 1, -200.0, 40.0),
    "unsettable": unsettable,
    "shapes": shapes,
    "configurations": configurations,
    "feedback": lambda folder: software(folder, 2, 150.0, 20.0),
}


def main() -> int:
    scene, folder = sys.argv[1], Path(sys.argv[2])
    result = SCENES[scene](folder)
    if RECORD.exists():
        shutil.copytree(RECORD, folder / "record")
    (folder / "result.json").write_text(json.dumps(result))
    return 0


if __name__ == "__main__":
    sys.exit(main())
