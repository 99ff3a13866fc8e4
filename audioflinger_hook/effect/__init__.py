"""Effects as on Android: chains of effects on the mixer's output, including the haptic effect.

audio_effects.xml -> xml -> registry -> chain (one per session) -> module

interface                   what an engine is
commands                    checks every command before the engine sees it
control                     lifecycle and commands of one effect
module                      calls an engine, and protects the sound from the engine
haptic, haptic_parameters   the haptic effect, its output stage, what it declares
"""
