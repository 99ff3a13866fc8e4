"""The functions of libpulse that record a stream, called from Python without a detour.

pulsectl binds what controls a server. Its few record functions are meant for reading one peak
value, and declare sizes with 32 bits where libpulse writes 64, so they are not used here.

Calls that return at once keep Python's lock: to give it away and wait for it again would cost more
than the call. Only those that may wait give it away. libpulse belongs to one thread at a time; the
exception is `mainloop_wakeup`. Callbacks run within `mainloop_dispatch` and must not raise.
"""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_char_p, c_int, c_size_t, c_uint8, c_uint32, c_uint64, c_void_p
from functools import cache
from typing import Any

from device.errors import NotFoundError

CHANNELS_MAX = 32
FLOAT32_LE, FLOAT32_BE = 5, 6
CONTEXT_NOAUTOSPAWN = 0x1
CONTEXT_READY, CONTEXT_FAILED = 4, 5
STREAM_READY = 2
STREAM_DONT_MOVE = 0x0200
STREAM_ADJUST_LATENCY = 0x2000
STREAM_DONT_INHIBIT_AUTO_SUSPEND = 0x8000
SUBSCRIBE_SINK_INPUTS = 0x0004
EVENT_MASK, EVENT_SINK_INPUT_REMOVED = 0x003F, 0x0022
ERROR_NO_ENTITY = 5
DEFAULT_MAP = 0


class SampleSpec(ctypes.Structure):
    """Format, rate in Hz and channels of a stream."""

    _fields_ = (("format", c_int), ("rate", c_uint32), ("channels", c_uint8))


class ChannelMap(ctypes.Structure):
    """The positions of a stream's channels, such as front-left."""

    _fields_ = (("channels", c_uint8), ("positions", c_int * CHANNELS_MAX))


class BufferAttributes(ctypes.Structure):
    """Sizes in bytes; a stream that records only has maxlength and fragsize."""

    _fields_ = (
        ("maxlength", c_uint32),
        ("tlength", c_uint32),
        ("prebuf", c_uint32),
        ("minreq", c_uint32),
        ("fragsize", c_uint32),
    )


class Volumes(ctypes.Structure):
    """The volume of each channel."""

    _fields_ = (("channels", c_uint8), ("values", c_uint32 * CHANNELS_MAX))


class SinkInputInfo(ctypes.Structure):
    """What a server says of a stream that plays; there is more behind these fields."""

    _fields_ = (
        ("index", c_uint32),
        ("name", c_char_p),
        ("owner_module", c_uint32),
        ("client", c_uint32),
        ("sink", c_uint32),
        ("sample_spec", SampleSpec),
        ("channel_map", ChannelMap),
        ("volumes", Volumes),
        ("buffer_us", c_uint64),
        ("sink_us", c_uint64),
        ("resample_method", c_char_p),
        ("driver", c_char_p),
        ("mute", c_int),
        ("properties", c_void_p),
        ("corked", c_int),
    )


SinkInputCallback = ctypes.CFUNCTYPE(None, c_void_p, POINTER(SinkInputInfo), c_int, c_void_p)
"""Of context, info, end (0: info is one; 1: no more; under 0: there is none), number."""

EventCallback = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_uint32, c_void_p)
"""Of context, what happened, index, nothing."""

_AT_ONCE: dict[str, tuple[Any, ...]] = {  # name: result, arguments
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
    "context_set_subscribe_callback": (None, c_void_p, EventCallback, c_void_p),
    "context_get_sink_input_info": (c_void_p, c_void_p, c_uint32, SinkInputCallback, c_void_p),
    "operation_unref": (None, c_void_p),
    "channel_map_init_extend": (c_void_p, POINTER(ChannelMap), c_uint32, c_int),
    "stream_new_with_proplist": (
        c_void_p,
        *(c_void_p, c_char_p, POINTER(SampleSpec), POINTER(ChannelMap), c_void_p),
    ),
    "stream_set_monitor_stream": (c_int, c_void_p, c_uint32),
    "stream_connect_record": (c_int, c_void_p, c_char_p, POINTER(BufferAttributes), c_int),
    "stream_get_state": (c_int, c_void_p),
    "stream_get_device_name": (c_char_p, c_void_p),
    "stream_peek": (c_int, c_void_p, POINTER(c_void_p), POINTER(c_size_t)),
    "stream_drop": (c_int, c_void_p),
    "stream_disconnect": (c_int, c_void_p),
    "stream_unref": (None, c_void_p),
}
_WAITING: dict[str, tuple[Any, ...]] = {
    "mainloop_poll": (c_int, c_void_p),
    "context_connect": (c_int, c_void_p, c_char_p, c_int, c_void_p),
}


class LibPulse:
    """The library; its functions without their prefix `pa_`. Use `load`."""

    def __init__(self) -> None:
        for library, functions in (
            (ctypes.PyDLL("libpulse.so.0"), _AT_ONCE),
            (ctypes.CDLL("libpulse.so.0"), _WAITING),
        ):
            for name, (result, *arguments) in functions.items():
                function = getattr(library, f"pa_{name}")
                function.restype, function.argtypes = result, arguments
                setattr(self, name, function)

    def __getattr__(self, name: str) -> Any:
        # only for what is not there: type checkers learn from it that the others are
        raise AttributeError(name)


@cache
def load() -> LibPulse:
    """The library, loaded once; any thread may call this.

    Raises
    ------
    NotFoundError
        It is not installed.
    """
    try:
        return LibPulse()
    except OSError as error:
        raise NotFoundError(
            f"the library libpulse cannot be loaded ({error}); install it (libpulse0)"
        ) from None
