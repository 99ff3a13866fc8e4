"""The functions of libpulse that record a stream.

pulsectl declares the structures, but its record functions take sizes of 32 bits where libpulse
writes 64.

Functions that may wait release Python's lock; for the others that would cost more than the call.
One thread at a time uses libpulse, except for `mainloop_wakeup`. Callbacks run within
`mainloop_dispatch` and must not raise.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from ctypes import c_char_p, c_int, c_uint32, c_void_p
from functools import cache
from types import SimpleNamespace
from typing import Any

from device.errors import NotFoundError, not_installed

FLOAT32_LE, FLOAT32_BE = 5, 6
CONTEXT_NOAUTOSPAWN = 0x1
CONTEXT_READY, CONTEXT_FAILED = 4, 5
STREAM_READY = 2
STREAM_DONT_MOVE = 0x0200
STREAM_ADJUST_LATENCY = 0x2000
STREAM_DONT_INHIBIT_AUTO_SUSPEND = 0x8000
SUBSCRIBE_SINK_INPUTS = 0x0004
EVENT_MASK, EVENT_SINK_INPUT_REMOVED = 0x003F, 0x0022
DEFAULT_MAP = 0

_FUNCTIONS: dict[str, tuple[Any, ...]] = {  # name: result, arguments
    "strerror": (c_char_p, c_int),
    "mainloop_new": (c_void_p,),
    "mainloop_free": (None, c_void_p),
    "mainloop_get_api": (c_void_p, c_void_p),
    "mainloop_prepare": (c_int, c_void_p, c_int),
    "mainloop_dispatch": (c_int, c_void_p),
    "mainloop_wakeup": (None, c_void_p),
    "proplist_new": (c_void_p,),
    "proplist_free": (None, c_void_p),
    "proplist_sets": (c_int, c_void_p, c_char_p, c_char_p),
    "context_new_with_proplist": (c_void_p, c_void_p, c_char_p, c_void_p),
    "context_get_state": (c_int, c_void_p),
    "context_errno": (c_int, c_void_p),
    "context_disconnect": (None, c_void_p),
    "context_unref": (None, c_void_p),
    "context_subscribe": (c_void_p, c_void_p, c_int, c_void_p, c_void_p),
    "context_set_subscribe_callback": (None, c_void_p, c_void_p, c_void_p),
    "context_get_sink_input_info": (c_void_p, c_void_p, c_uint32, c_void_p, c_void_p),
    "operation_unref": (None, c_void_p),
    "channel_map_init_extend": (c_void_p, c_void_p, c_uint32, c_int),
    "stream_new_with_proplist": (c_void_p, c_void_p, c_char_p, c_void_p, c_void_p, c_void_p),
    "stream_set_monitor_stream": (c_int, c_void_p, c_uint32),
    "stream_connect_record": (c_int, c_void_p, c_char_p, c_void_p, c_int),
    "stream_get_state": (c_int, c_void_p),
    "stream_get_device_name": (c_char_p, c_void_p),
    "stream_peek": (c_int, c_void_p, c_void_p, c_void_p),
    "stream_drop": (c_int, c_void_p),
    "stream_disconnect": (c_int, c_void_p),
    "stream_unref": (None, c_void_p),
    "mainloop_poll": (c_int, c_void_p),
    "context_connect": (c_int, c_void_p, c_char_p, c_int, c_void_p),
}
_WAITING = ("mainloop_poll", "context_connect")


class LibPulse(SimpleNamespace):
    """The library's functions, without their prefix `pa_`. types: pulsectl's. Use `load`."""

    def __init__(self) -> None:
        self.types = load_pulsectl()._pulsectl
        at_once, waiting = ctypes.PyDLL("libpulse.so.0"), ctypes.CDLL("libpulse.so.0")
        for name, (result, *arguments) in _FUNCTIONS.items():
            function = getattr(waiting if name in _WAITING else at_once, f"pa_{name}")
            function.restype, function.argtypes = result, arguments
            setattr(self, name, function)

    @contextmanager
    def properties(self, values: Mapping[str, str]) -> Iterator[Any]:
        """Provide a property list inside this context."""
        properties = self.proplist_new()
        for name, value in values.items():
            self.proplist_sets(properties, name.encode(), value.encode())
        try:
            yield properties
        finally:
            self.proplist_free(properties)


@cache
def load() -> LibPulse:
    """Load the library once. Any thread may call it; NotFoundError: it is not installed."""
    return LibPulse()


def load_pulsectl() -> Any:
    """Return the module pulsectl; NotFoundError: the library libpulse is not installed."""
    try:
        import pulsectl
    except ModuleNotFoundError:
        raise NotFoundError(not_installed("pulsectl", "live")) from None
    except (ImportError, OSError) as error:
        raise NotFoundError(
            f"the library libpulse cannot be loaded ({error}); install it (libpulse0)"
        ) from None
    return pulsectl
