"""The mixer: tracks of any format and rate, one mix, effect chains, sinks.

`Mixer` makes tracks and steps; `dump` shows it as text.

    pcm, ring, states, track               what a client writes into
    track_mixer                            one track on the mixer's side
    channels, kaiser, resampler, volume    the three steps from a track into the mix
    buffer_size, session, mixer            the cycle
    effects_port, sinks                    effects and outputs behind the mix
"""

from audioflinger_hook.mixer.dump import dump
from audioflinger_hook.mixer.effects_port import EffectsPort, NoEffects
from audioflinger_hook.mixer.mixer import CycleReport, Mixer, MixerState
from audioflinger_hook.mixer.pcm import PcmFormat
from audioflinger_hook.mixer.sinks import AudioSink, HapticSink, Sink
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
    "Sink",
    "Track",
    "TrackState",
    "dump",
]
