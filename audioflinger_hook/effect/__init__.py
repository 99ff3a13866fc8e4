"""Effects as on Android: chains of the mixer's output, the haptic effect among them.

audio_effects.xml -> xml -> registry -> chain (one a session) -> module (lifecycle)
interface, parameters       what an engine is
commands                    checks every command before the engine sees it
guard                       calls an engine so that it cannot harm the sound
haptic, vibration           the haptic effect and its output stage
"""
