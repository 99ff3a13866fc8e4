"""Inputs of sound: the monitor of a sink, single applications, or a file in real time."""
