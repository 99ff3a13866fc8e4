"""Vibration as files of other haptic tools.

export.py  chooses the format
sound_output.py, decimation.py  WAV and FLAC at any rate
"""
