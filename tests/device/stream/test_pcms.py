import ctypes
import os
import re
import resource
import subprocess
from pathlib import Path

import pytest

from device.errors import LostError
from device.stream import pcms
from device.stream.pcms import TAG, PcmConfig, ServerDevice
from tests.support.commands import open_files
from tests.support.programs import printed


def configuration() -> str:
    return Path(os.environ["ALSA_CONFIG_PATH"]).read_text()


def test_opening_leads_a_pcm_to_its_target_and_the_environment_is_restored(monkeypatch):
    monkeypatch.setenv("PULSE_LATENCY_MSEC", "5")
    monkeypatch.setenv("PULSE_PROP", "a=b")
    before, config = dict(os.environ), PcmConfig("one", "two")
    first = os.environ["ALSA_CONFIG_PATH"]
    assert "PULSE_LATENCY_MSEC" not in os.environ
    assert "pcm.one { type null }" in configuration()
    config.pcms["one"].target = ServerDevice("haptic", "unix:/run/x")
    with config.opening(config.pcms["one"], "tag-1", output=True):
        assert os.environ["ALSA_CONFIG_PATH"] != first  # ALSA reads only a new path again
        text = configuration().splitlines()
        assert text[0] == 'pcm.one { type pulse device "haptic" server "unix:/run/x" }'
        assert text[1:] == ["pcm.two { type null }", "pcm.default { type null }"]
        assert os.environ["PULSE_PROP"].startswith("a=b application.id=")
        assert f"{TAG}=tag-1" in os.environ["PULSE_PROP"]
    assert os.environ["PULSE_PROP"] == "a=b"
    config.close()
    config.close()
    assert dict(os.environ) == before


def test_a_stream_with_another_role_is_not_taken_for_one_of_the_vibration(monkeypatch):
    monkeypatch.setenv("PULSE_PROP", "")
    config = PcmConfig("one", role="test")
    with config.opening(config.pcms["one"], "tag-1", output=True):
        properties = dict(one.split("=") for one in os.environ["PULSE_PROP"].split())
    config.close()
    assert (properties.pop("media.role"), properties) == ("test", {"node.dont-reconnect": "true"})


def test_children_read_the_same_configuration_and_no_file_stays_open():
    before, config = open_files(), PcmConfig("one")
    for _ in range(3):
        with config.opening(config.pcms["one"], "tag", output=False):
            path = os.environ["ALSA_CONFIG_PATH"]
            assert subprocess.check_output(["cat", path], text=True) == configuration()
    config.close()
    assert open_files() == before


def test_without_memory_for_the_file_the_error_is_one_line(monkeypatch):
    def refuse(name: str) -> int:
        raise OSError(24, "Too many open files")

    monkeypatch.setattr(os, "environ", dict(os.environ))
    monkeypatch.setattr(pcms, "memory_file", refuse)
    with pytest.raises(LostError, match="Too many open files"):
        PcmConfig("one")


def test_quietening_libraries_leaves_python_its_voice():
    out, err = printed(
        "import ctypes, os, sys\n"
        "from device.stream.portaudio import filter_stderr\n"
        "print(filter_stderr(), filter_stderr())\n"
        "ctypes.CDLL(None).perror(b'library')\n"
        "os.write(2, b'ours\\n'); print('also ours', file=sys.stderr, flush=True)\n"
    )
    if out == "False False":
        pytest.skip("needs the GNU C library")
    assert (out, err) == ("True True", ["ours", "also ours"])


def test_what_plays_or_asks_is_not_loaded_by_importing_the_packages_or_finding_devices():
    out, err = printed(
        "import sys, device.server, device.stream, device.usb; device.usb.find_devices()\n"
        "print([n for n in ('pulsectl', 'pyaudio', 'usb') if n in sys.modules])"
    )
    assert out == "[]", err


def test_without_the_plugin_the_advice_names_the_package(monkeypatch):
    try:
        ctypes.CDLL("libasound.so.2")
    except OSError:
        pytest.skip("ALSA's library is not installed")
    monkeypatch.setattr(pcms, "PLUGIN", "libasound_module_pcm_nobodys.so")
    assert "install the package libasound2-plugins" in pcms.missing_plugin()
    assert pcms.missing_plugin("libnobodys.so.2") == ""  # ALSA cannot be asked


NICE = os.getpriority(os.PRIO_PROCESS, 0)
UNPRIVILEGED = ("setpriv", "--bounding-set=-sys_nice", "--inh-caps=-sys_nice")
WARNING = ".*rtprio 20.*/etc/security/limits.d/cushion.conf.*realtime = false.*"


def told(program: str, *within: str) -> str:
    out, errors = printed(program, *within)
    assert errors == []
    return out


CLAIM = """
import os, resource, threading
from device.stream.callback_thread import AudioPriority

priority = AudioPriority({wanted})
def audio():
    priority.claim()
    priority.claim()
    policy = os.sched_getscheduler(0)
    print("real-time" if policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR else "usual",
          bool(policy & os.SCHED_RESET_ON_FORK), os.sched_getparam(0).sched_priority,
          os.getpriority(os.PRIO_PROCESS, 0), end="; ")
thread = threading.Thread(target=audio)
thread.start()
thread.join()
print(os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0), end="; ")
print(resource.getrlimit(resource.RLIMIT_RTTIME), priority.warning)
"""


def can_be_real_time() -> bool:
    try:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(10))
    except OSError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


needs_real_time = pytest.mark.skipif(not can_be_real_time(), reason="no real-time priority here")


@needs_real_time
def test_where_it_is_granted_only_the_thread_that_asks_has_it_and_may_not_spin():
    granted = f"real-time True 10 {NICE}; 0 {NICE}; (200000, 2000000)"
    assert told(CLAIM.format(wanted=True)) == granted


@pytest.mark.parametrize(
    ("limits", "says"),
    [
        (("--rtprio=0:5",), f"real-time True 5 {NICE}; 0 {NICE};.*"),  # it has to be raised
        (("--rtprio=0:0", "--nice=0:31"), rf"usual False 0 -11; 0 {NICE}; \(200000, 2000000\)"),
        (("--rtprio=0:0", "--nice=0:0"), f"usual False 0 {NICE}; 0 {NICE};{WARNING}"),
    ],
    ids=["the user's limit is used", "a nice level does", "nothing is granted"],
)
def test_what_is_granted_is_taken_and_only_where_nothing_is_somebody_is_warned(limits, says):
    within = ("prlimit", *limits, *UNPRIVILEGED)
    # env: what is missing is an exit code, too
    if subprocess.call(["env", *within, "true"], stderr=subprocess.DEVNULL):
        pytest.skip(f"{' '.join(within)} does not work here")
    assert re.fullmatch(says, told(CLAIM.format(wanted=True), *within), re.DOTALL)


def test_what_is_switched_off_asks_for_nothing():
    inherited = resource.getrlimit(resource.RLIMIT_RTTIME)
    assert told(CLAIM.format(wanted=False)) == (f"usual False 0 {NICE}; 0 {NICE}; {inherited}")


SPIN = """
import hashlib, os, sys, threading, time
from audioflinger_hook.cli.process import Signals
from audioflinger_hook.daemon.timing import Wake
from device.stream.callback_thread import AudioPriority

spinning, over = threading.Event(), False
def audio():
    priority.claim()
    spinning.set()
    while not over:  # without Python's lock: waiting for that is a break
        hashlib.pbkdf2_hmac("sha256", b"a", b"b", 200_000)
with Wake() as wake, Signals(wake) as signals:
    priority = AudioPriority()
    signals.on_spinning = priority.revoke
    thread = threading.Thread(target=audio)
    thread.start()
    spinning.wait()
    deadline_s = time.monotonic() + 20.0
    while not priority.warning and time.monotonic() < deadline_s:
        time.sleep(0.01)
    print(os.sched_getscheduler(thread.native_id), priority.wanted, priority.warning)
    priority.set_wanted(True)
    print(priority.warning == "")
    over = True
    thread.join()
"""


@needs_real_time
def test_a_thread_that_spins_loses_it_and_the_process_goes_on():
    lines = told(SPIN).splitlines()
    assert lines[0].startswith("0 False an audio thread ran for 0.2 s without a break")


RESTORE = """
import os, threading
from concurrent.futures import ThreadPoolExecutor
from device.stream.callback_thread import AudioPriority

priority, audio, claimed = AudioPriority(), ThreadPoolExecutor(1), -1
def block():
    global claimed
    if claimed != priority.round:
        claimed = priority.round
        priority.claim()
    return threading.get_native_id()
def seen():
    return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR
thread = audio.submit(block).result()
told = [seen()]
priority.revoke()
told += [seen(), bool(priority.warning)]
priority.restore()
audio.submit(block).result()
told += [seen(), bool(priority.warning), priority.round]
priority.restore()
told += [priority.round]
priority.set_wanted(False)
priority.revoke()
priority.restore()
print(*told, priority.wanted, priority.round)
"""


@needs_real_time
def test_what_a_vanished_device_cost_all_threads_is_given_back_once_and_only_then():
    assert told(RESTORE) == "True False True True False 1 1 False 1"
