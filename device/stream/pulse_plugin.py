"""Whether ALSA has its plugin for sound servers, through which PortAudio reaches them."""

from __future__ import annotations

import ctypes
import os

PLUGIN = "libasound_module_pcm_pulse.so"

ADVICE = (
    f"ALSA's plugin for sound servers, {PLUGIN}, is missing; install the package "
    "libasound2-plugins (Debian, Ubuntu), alsa-plugins-pulseaudio (Fedora) or alsa-plugins (Arch), "
    "and start again"
)


def missing_plugin(library: str = "libasound.so.2") -> str:
    """Return that the plugin is missing and how to get it; "" if ALSA loads it.

    library: ALSA's; "" as well where that library itself cannot be asked. Any thread may call it.
    """
    try:
        alsa = ctypes.CDLL(library)
        load, unload = alsa.snd_dlopen, alsa.snd_dlclose
    except (OSError, AttributeError):
        return ""
    load.argtypes = (ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t)
    load.restype = ctypes.c_void_p
    unload.argtypes = (ctypes.c_void_p,)
    why = ctypes.create_string_buffer(256)
    loaded = load(PLUGIN.encode(), os.RTLD_LAZY, why, len(why))
    if not loaded:
        return ADVICE
    unload(loaded)
    return ""
