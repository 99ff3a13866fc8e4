"""The daemon: live sound through the effect into a device, until it is told to stop.

engine         what the audio threads run: captured frames -> effect -> delay line -> device
capture_queue  captured frames on their way to the engine
supervisor     the main thread: opens streams, watches them and opens them again
run_config     what a run was asked for; endpoints: the input and output that this takes
inputs         a sink's monitor, applications, a file; outputs: a sink, a card, a file
recording      what ran, kept as a capture; live_capture: a tap alone, kept
"""
