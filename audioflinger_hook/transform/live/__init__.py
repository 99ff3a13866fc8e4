"""The live form in NumPy: overlapped, phase-continuous and early.

| module | what it does |
| --- | --- |
| `transform` | one channel, continued from block to block |
| `analysis` | principal frequencies of long windows |
| `onsets`, `onset_partials` | short windows, and partials born of what begins in them |
| `partials` | partials followed from hop to hop |
| `loudness`, `speech` | strength by loudness; speech lowered |
| `synthesis` | oscillators, low-pass, limiter |
"""

from audioflinger_hook.transform.live.transform import LiveTransform

__all__ = ["LiveTransform"]
