"""Audio streams through PortAudio, on a server or a card. The first stream loads PyAudio."""

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
