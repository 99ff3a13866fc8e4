"""The daemon, which turns sound into vibration in real time.

A tap is the source of the sound. A rig is an actuator with its DAC, amplifier and seat. The main
thread is also called the supervising thread. It runs `supervisor`. A class whose docstrings name no
thread is for the main thread only. `inputs` pass sound through `capture_queue` to `engine`, which
writes vibration to a delay line. `outputs` read the delay line. `native` runs another engine in
PipeWire's graph. `engines` chooses between `engine` and `native`.
"""
