"""Audio streams through PortAudio, on a sound server or directly on a card.

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
