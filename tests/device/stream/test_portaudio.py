"""PortAudio is loaded late, and C libraries can be kept from printing."""

from __future__ import annotations

import pytest

from tests.support.programs import printed


def test_quietening_libraries_leaves_python_its_voice() -> None:
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


def test_neither_pulsectl_nor_pyaudio_is_loaded_by_importing_the_packages() -> None:
    out, err = printed(
        "import sys, device.server, device.stream\n"
        "print([n for n in ('pulsectl', 'pyaudio') if n in sys.modules])"
    )
    assert out == "[]", err
