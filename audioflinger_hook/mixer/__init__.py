"""The mixer: adds tracks of different sample formats and samplerates to one mix.

client -> track (pcm) -> track_mixer (layouts, resampler) -> mixer -> effects, sinks (mix_buffer)
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
