"""The daemon: live sound through the chain into a device, for as long as one likes.

engine      what the audio threads run: captured frames -> chain -> delay line -> device
supervisor  the main thread: opens, watches, moves and opens again
"""
