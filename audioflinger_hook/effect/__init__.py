"""Effects as on Android: chains of the mixer's output, the haptic effect among them.

audio_effects.xml -> xml -> registry -> chain (one a session) -> module
interface                   what an engine is
commands                    checks every command before the engine sees it
control                     lifecycle and commands of one effect
module                      calls an engine so that it cannot harm the sound
haptic, haptic_parameters   the haptic effect, its output stage, what it declares
"""
