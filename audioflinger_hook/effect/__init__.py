"""Effects as on Android: what the mixer's output passes through, leaving vibration beside it.

audio_effects.xml -> xml --.
entry points -> registry --+-> chain (one a session) -> module (lifecycle)
                                   commands (checks) <--'   '--> guard -> an engine
parameters, interface: what an engine is                          haptic: ours -> vibration
"""
