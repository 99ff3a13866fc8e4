"""The daemon: live sound through the chain into a device, for as long as one likes.

engine      what the audio threads run: captured frames -> chain -> delay line -> device
supervisor  the main thread: opens, watches, moves and opens again
sides       what it knows of inputs and outputs: live_* by the server, paced_* by pacing
recording   what ran, kept as a capture; live_capture: a tap alone, kept
"""
