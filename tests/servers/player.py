"""A program that plays a tone and pauses when told: python -m tests.servers.player HZ LEVEL SINK

Lines on its standard input: `pause`, `go on`; it says each one back when it is done. It plays
48 kHz stereo float32, and its first line is the index of its stream.
"""

import ctypes
import math
import sys
import threading
from array import array
from queue import SimpleQueue

from pulsectl._pulsectl import PA_BUFFER_ATTR as BufferAttributes
from pulsectl._pulsectl import PA_SAMPLE_SPEC as SampleSpec

RATE_HZ = 48_000
FLOAT32_LE = 5
UNCHOSEN = 0xFFFF_FFFF
ADJUST_LATENCY = 0x2000
QUEUED_FRAMES = 4_800


def main() -> None:
    hz, level, sink = float(sys.argv[1]), float(sys.argv[2]), sys.argv[3].encode()
    pulse = ctypes.CDLL("libpulse.so.0")
    for name in ("mainloop_new", "mainloop_get_api", "context_new", "stream_new"):
        getattr(pulse, f"pa_{name}").restype = ctypes.c_void_p
    pulse.pa_stream_get_index.restype = ctypes.c_uint32
    pulse.pa_stream_writable_size.restype = ctypes.c_size_t
    loop = ctypes.c_void_p(pulse.pa_mainloop_new())

    def step() -> None:
        pulse.pa_mainloop_prepare(loop, 10_000)
        pulse.pa_mainloop_poll(loop)
        pulse.pa_mainloop_dispatch(loop)

    context = ctypes.c_void_p(
        pulse.pa_context_new(ctypes.c_void_p(pulse.pa_mainloop_get_api(loop)), b"Player")
    )
    pulse.pa_context_connect(context, None, 1, None)
    while pulse.pa_context_get_state(context) != 4:
        step()
    spec = SampleSpec(FLOAT32_LE, RATE_HZ, 2)
    stream = ctypes.c_void_p(pulse.pa_stream_new(context, b"a tone", ctypes.byref(spec), None))
    sizes = BufferAttributes(UNCHOSEN, QUEUED_FRAMES * 8, UNCHOSEN, UNCHOSEN, UNCHOSEN)
    pulse.pa_stream_connect_playback(stream, sink, ctypes.byref(sizes), ADJUST_LATENCY, None, None)
    while pulse.pa_stream_get_state(stream) != 2:
        step()
    print(pulse.pa_stream_get_index(stream), flush=True)

    told: SimpleQueue[str] = SimpleQueue()

    def listen() -> None:
        for line in sys.stdin:
            told.put(line.strip())

    threading.Thread(target=listen, daemon=True).start()
    second = array("f")
    for n in range(RATE_HZ):  # whole frequencies: it can be repeated
        second.extend([level * math.sin(2.0 * math.pi * hz * n / RATE_HZ)] * 2)
    tone = (second + second).tobytes()
    place, whole = 0, len(tone) // 2
    while True:
        step()
        while not told.empty():
            line = told.get()
            pulse.pa_stream_cork(stream, int(line == "pause"), None, None)
            print(line, flush=True)
        writable = pulse.pa_stream_writable_size(stream)
        length = min(writable, whole) // 8 * 8 if writable < UNCHOSEN else 0
        if length:
            piece = tone[place : place + length]
            pulse.pa_stream_write(
                stream, piece, ctypes.c_size_t(length), None, ctypes.c_int64(0), 0
            )
            place = (place + length) % whole


if __name__ == "__main__":
    main()
