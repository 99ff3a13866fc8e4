"""Where vibration goes: a sink of the sound server, a sound card, or a file in real time."""
