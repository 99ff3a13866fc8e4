"""The daemon: live sound through the effect into a device, until it is told to stop.

`supervisor` is the main thread. `inputs` pass sound through `capture_queue` to `engine`, whose
delay line `outputs` read. `native` is the engine in PipeWire; `engines` chooses one of the two.
"""
