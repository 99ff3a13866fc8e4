"""Vibration as files of other haptic tools.

| module | what it does |
| --- | --- |
| `export` | `export`, which chooses what writes the format |
| `options` | formats, options, report |
| `decimation`, `sound_output`, `ogg_haptic` | waveforms: WAV, FLAC, Ogg |
| `parametric` | plays a sound and gives its glides to a writer; partial tracks as JSON lines |
| `glides`, `tracks`, `envelope`, `simplify` | glides to curves, tracks and envelopes |
| `ahap`, `haptic_clip`, `vibration_xml`, `hjif` | the other parametric formats |
"""
