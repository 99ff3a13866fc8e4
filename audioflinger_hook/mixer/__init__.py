"""The mixer: tracks of any format and rate, one mix, effect chains, sinks.

`Mixer` makes tracks and steps; `dump` shows it as text.

    pcm, track                     the formats and tracks that a client writes to
    layouts, resampler             steps from a track into the mix
    track_mixer                    one track on the mixer's side, with its volume
    mixer                          the cycle
    mix_buffer                     the buffer, the sinks and effects that it passes
"""

from audioflinger_hook.mixer.dump import dump
from audioflinger_hook.mixer.mix_buffer import EffectsPort, Sink
from audioflinger_hook.mixer.mixer import CycleReport, Mixer, MixerState
from audioflinger_hook.mixer.pcm import PcmFormat
from audioflinger_hook.mixer.track import Track, TrackState

__all__ = [
    "CycleReport",
    "EffectsPort",
    "Mixer",
    "MixerState",
    "PcmFormat",
    "Sink",
    "Track",
    "TrackState",
    "dump",
]
