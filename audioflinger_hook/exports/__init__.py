"""Vibration in file formats of other haptic tools.

| module | what it does |
| --- | --- |
| `export` | the function `export`, which writes a file of any format |
| `options` | the list of formats, the options and the report of an export |
| `sound_output`, `ogg_haptic` | waveforms: WAV, FLAC, Ogg |
| `parametric` | common parts of the formats without a waveform; partial tracks as JSON lines |
| `glides`, `tracks`, `envelope` | computation of curves, partial tracks and envelopes |
| `ahap`, `haptic_clip`, `vibration_xml`, `hjif` | the other formats without a waveform |
"""
