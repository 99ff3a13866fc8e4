"""The mixer: tracks of any format and rate, one mix, effect chains, sinks.

`Mixer` makes tracks and steps; `dump` shows it as text. One module, one idea:

    pcm, ring, states, track    what a client writes into
    lane                        a track's frames, on the mixer's side, on their way through
    channels, kaiser, resampler, volume    ... the three steps of that way
    buffer_size, session, mixer            the cycle
    effects_port, sinks                    what stands behind it
"""

from audioflinger_hook.mixer.dump import dump
from audioflinger_hook.mixer.effects_port import EffectsPort, NoEffects
from audioflinger_hook.mixer.mixer import CycleReport, Mixer, MixerState
from audioflinger_hook.mixer.pcm import PcmFormat
from audioflinger_hook.mixer.sinks import AudioSink, HapticSink, PcmSink, Sink
from audioflinger_hook.mixer.track import Track, TrackState

__all__ = [
    "AudioSink",
    "CycleReport",
    "EffectsPort",
    "HapticSink",
    "Mixer",
    "MixerState",
    "NoEffects",
    "PcmFormat",
    "PcmSink",
    "Sink",
    "Track",
    "TrackState",
    "dump",
]
