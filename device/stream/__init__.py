"""Audio streams through PortAudio, on a sound server or directly on a card.

| module | contents |
| --- | --- |
| `streams` | `CaptureStream`, `PlaybackStream`: one block per callback |
| `portaudio` | the single PyAudio instance; opens and closes streams within a time limit |
| `pcms` | `PcmConfig`: named ALSA devices, and the sinks, monitors and cards they open |
| `sample_format` | `SampleFormat`, and the encoder from float frames to integers |
| `callback_thread` | priority, Python thread state and CPU time of the callbacks' threads |

PyAudio is loaded when the first stream is opened.
"""

from device.stream.callback_thread import AudioPriority
from device.stream.pcms import PcmConfig
from device.stream.portaudio import filter_stderr
from device.stream.sample_format import SampleFormat
from device.stream.streams import CaptureStream, PlaybackStream

__all__ = [
    "AudioPriority",
    "CaptureStream",
    "PcmConfig",
    "PlaybackStream",
    "SampleFormat",
    "filter_stderr",
]
