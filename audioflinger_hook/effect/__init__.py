"""Chains of audio effects, as on Android, and the haptic effect. The modules in order of use:

audio_effects.xml -> xml -> registry -> chain (one per session) -> module, control -> haptic
"""
