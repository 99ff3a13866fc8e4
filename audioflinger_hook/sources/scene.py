"""A client that plays a scene with one track per sound."""

import math

import numpy as np

from audioflinger_hook.mixer import Mixer
from audioflinger_hook.mixer.pcm import encode
from audioflinger_hook.mixer.track import period_frames
from audioflinger_hook.scenes import Scene, SceneTrack
from device.units import Float32Array

CYCLE_FRAMES = 256  # frames of a cycle, a typical number for a sound server


class SceneClient:
    """Plays a scene with one track per sound.

    A sound may start at any frame of a cycle. A pause begins and ends with a fade over one cycle.
    scene: the played scene. cycle_frames: frames of a cycle, at most those of a mixer cycle.
    """

    def __init__(self, scene: Scene, cycle_frames: int = CYCLE_FRAMES) -> None:
        self.samplerate = scene.samplerate
        self.channels = scene.channels
        self.frames_expected = scene.frame_count
        self._scene = scene
        self._cycle_frames = cycle_frames
        self._position = 0

    def connect(self, mixer: Mixer) -> None:
        """Create a track for every sound."""
        self._cycle_frames = min(self._cycle_frames, mixer.frames)
        self._voices = [_Voice(mixer, track) for track in self._scene.tracks]

    def play(self) -> int | None:
        """Write all sounds for the next cycle. Return its length in frames, or None at the end."""
        first = self._position
        frames = min(self._cycle_frames, self._scene.frame_count - first)
        if frames <= 0:
            return None
        self._position = first + frames
        for voice in self._voices:
            voice.play(first, self._position)
        return frames

    def close(self) -> None:
        """Do nothing: the client has no resources to release."""


class _Voice:
    def __init__(self, mixer: Mixer, sound: SceneTrack) -> None:
        rate, channels = sound.samplerate, sound.frames.shape[1]
        period = period_frames(rate, mixer.samplerate, mixer.frames)
        self.start = round(sound.start_s * mixer.samplerate)
        self.pause = self.resume = -1  # no frame has this number, so there is no pause
        if sound.pause_s:
            self.pause, self.resume = (round(at_s * mixer.samplerate) for at_s in sound.pause_s)
        self.track = mixer.create_track(
            sound.name, sound.pcm_format, rate, channels, ring_frames=4 * period, start_threshold=1
        )
        self.stored = encode(sound.frames, sound.pcm_format)
        self.frame_bytes = channels * sound.pcm_format.bytes_per_sample

    def play(self, first: int, last: int) -> None:
        if first <= self.start < last:
            track = self.track
            lead = round((self.start - first) * track.samplerate / track.mix_samplerate)
            silence = encode(np.zeros((lead, track.channels), np.float32), track.format)
            self.stored = silence + self.stored
            track.start()
        if first <= self.pause < last:
            self.track.pause()
        if first <= self.resume < last:
            self.track.start()
        if self.start < last:
            most = self.track.ring.room * self.frame_bytes
            taken = self.track.write(self.stored[:most]) * self.frame_bytes
            self.stored = self.stored[taken:]
            # A stopped track ignores a pause, so stop only after the last pause.
            if not self.stored and self.resume < last:
                self.track.stop()


def mixdown(scene: Scene) -> Float32Array:
    """Return the mix, (frames, channels). scene: its sounds are mixed."""
    mixer = Mixer(scene.samplerate, scene.channels, standby_delay_s=math.inf)
    client = SceneClient(scene)
    client.connect(mixer)
    parts = [np.zeros((0, scene.channels), np.float32)]
    while frames := client.play():
        parts.append(mixer.cycle(0.0, frames).buffer.audio.copy())
    return np.concatenate(parts)
