"""The functions of libpulse that are needed to record a stream.

The library pulsectl declares the C structures. Its own functions for recording are unusable: they
declare sizes as 32 bits where libpulse writes 64 bits.

Functions that may wait release the GIL; the other functions return at once and keep it. Only one
thread at a time may call libpulse, but any thread may call `mainloop_wakeup`. Callbacks run within
`mainloop_dispatch` and must raise no exceptions.
"""

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from ctypes import c_char_p, c_int, c_uint32, c_void_p
from functools import cache
from types import SimpleNamespace
from typing import Any

from device.errors import NotFoundError, not_installed

FLOAT32_LE, FLOAT32_BE = 5, 6
CONTEXT_NOAUTOSPAWN, CONTEXT_READY, CONTEXT_FAILED = 0x1, 4, 5
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
    """libpulse's functions without the prefix `pa_`; made by `load`. types: pulsectl's C types."""

    def __init__(self) -> None:
        self.types = load_pulsectl()._pulsectl
        at_once, waiting = ctypes.PyDLL("libpulse.so.0"), ctypes.CDLL("libpulse.so.0")
        for name, (result, *arguments) in _FUNCTIONS.items():
            function = getattr(waiting if name in _WAITING else at_once, f"pa_{name}")
            function.restype, function.argtypes = result, arguments
            setattr(self, name, function)

    @contextmanager
    def properties(self, values: Mapping[str, str]) -> Iterator[Any]:
        """Provide a libpulse property list with these values inside this context."""
        properties = self.proplist_new()
        for name, value in values.items():
            self.proplist_sets(properties, name.encode(), value.encode())
        try:
            yield properties
        finally:
            self.proplist_free(properties)


load = cache(LibPulse)  # returns the loaded library; NotFoundError: see `load_pulsectl`


def load_pulsectl() -> Any:
    """Return the module pulsectl. NotFoundError: pulsectl or libpulse is not installed."""
    try:
        import pulsectl
    except ModuleNotFoundError:
        raise NotFoundError(not_installed("pulsectl", "live")) from None
    except (ImportError, OSError) as error:
        raise NotFoundError(
            f"the library libpulse cannot be loaded ({error}); install it (libpulse0)"
        ) from None
    return pulsectl
