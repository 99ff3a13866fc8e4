"""Effects as on Android: chains of effects on the mixer's output, including the haptic effect.

audio_effects.xml -> xml -> registry -> chain (one per session) -> module, control -> an engine, as
`interface` says: `haptic`
"""
