"""Outputs of vibration: a sink of the sound server, a sound card, a file, or a simulated rig."""
