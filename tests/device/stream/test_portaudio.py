"""Libraries are loaded late, and those in C can be kept from printing."""

import pytest

from tests.support.programs import printed


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
