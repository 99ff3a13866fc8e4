"""Vibration as files of other haptic tools.

| module | what it does |
| --- | --- |
| `export` | `export`, which chooses what writes the format |
| `options` | formats, options, report |
| `decimation`, `sound_output`, `ogg_haptic` | waveforms: WAV, FLAC, Ogg |
| `parametric` | plays a sound and gives its glides to a writer |
| `glides`, `tracks`, `envelope`, `simplify`, `band` | glides to curves, tracks and envelopes |
| `ahap`, `haptic_clip`, `vibration_xml`, `hjif`, `partial_lines` | the parametric formats |
"""
