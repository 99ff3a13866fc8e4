"""Writes vibration to a file or to the simulated rig, in real time."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.inputs.base import FixedNode
from audioflinger_hook.daemon.outputs.base import Fill, Output
from audioflinger_hook.daemon.pacing import FrameTime, Pacer
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.run_config import RunConfig
from audioflinger_hook.pipeline.framework import channel_map_of, simulated_rig_of
from device.address import DeviceAddress
from device.atomic_file import AtomicFile
from device.drive import ActuatorSettings
from device.drive.channel_router import ChannelRouter
from device.errors import InternalError, UsageError
from device.output import VibrationOutput
from device.rig import rig_by_name
from device.rig.model_record import in_words
from device.rig.simulated_rig import SimulatedRig
from device.server import PulseConnection, ServerSnapshot
from device.wav_output import WavOutput

BLOCK_FRAMES = 256  # frames of one write


class PacedOutput(Output):
    """A WAV file or the simulated rig. UsageError: the file or the rig cannot be used."""

    def __init__(self, config: RunConfig, pacer: Pacer) -> None:
        super().__init__(config.device)
        self.may_rest = config.device.kind != "wav"  # a file includes all silence of the run
        self._pacer, self._recording = pacer, config.recording
        self._job: _Writer | None = None
        self._settings = config.settings
        self._router = ChannelRouter(self._settings.actuators)
        self._make = _maker(config.device, self._settings)
        self._format: tuple[int, int] | None = None

    @property
    def name(self) -> str | None:
        """The address while vibration is written, else None."""
        return str(self) if self._job is not None and self._pacer.is_doing(self._job) else None

    @property
    def summary(self) -> str:
        """Text with peak values of the simulated rig and the models it used; empty for a file."""
        output = self._job.output if self._job else None
        if not isinstance(output, SimulatedRig):
            return ""
        return (
            f"twin (predicted): peak acceleration {output.peak_acceleration_m_s2:.1f} m/s², "
            f"excursion {output.peak_displacement_m * 1e3:.2f} mm, "
            f"current {output.peak_current_a:.2f} A"
        ) + "".join(f"\n  {line}" for line in in_words(output.seconds))

    def set_format(self, samplerate: int, channels: int) -> None:
        """See `Output`."""
        self._format = (samplerate, channel_map_of(self._settings, channels).channels)

    def check_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Raise UsageError if the number of channels or the simulated rigs would change."""
        before, after = self._settings, replace(self._settings, actuators=tuple(actuators))
        if before.numbered_channels.channels != after.numbered_channels.channels:
            raise UsageError(
                f"{self} has {before.numbered_channels.channels} channels for the actuators, and "
                f"cannot have {after.numbered_channels.channels} while it runs; restart the daemon"
            )
        if self.address.kind == "twin" and _rigs(before) != _rigs(after):
            raise UsageError(
                "the simulated rigs cannot change channels while they run; restart the daemon"
            )

    def set_actuators(self, actuators: Sequence[ActuatorSettings]) -> None:
        """Use these actuators without an interruption."""
        self._settings = replace(self._settings, actuators=tuple(actuators))
        if actuators or self._router.actuators:
            self._router.change(self._settings.actuators, self._settings.numbered_channels)

    def locate(self, snapshot: ServerSnapshot | None) -> FixedNode:
        """Return the file or rig, which is always available."""
        return FixedNode(str(self), *(self._format or (0, 0)))

    def maintain(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Start or continue the output; raise the error that ended the output, if any."""
        job = self._job
        assert self._format is not None
        if job is None:
            job = self._job = _Writer(self._make(*self._format), self._recording)
        if job.error is not None:
            raise job.error
        if not self._pacer.is_doing(job):
            channel_map = channel_map_of(self._settings, self._format[1])
            job.fill = self._router.connect(fill, channel_map, BLOCK_FRAMES)
            if self._recording:
                self._recording.reopened()
            self._pacer.begin(job, now_s)

    def close(self) -> None:
        """Pause the output until the next `maintain`."""
        if self._job is not None:
            self._pacer.end(self._job)

    def end(self, *, keep: bool) -> None:
        """Complete the file, or discard the file if `keep` is False or after an error."""
        self.close()
        if self._job is not None and keep and self._job.error is None:
            self._job.output.close()
        elif self._job is not None:
            self._job.output.abort()


class _Writer:
    """Job of the pacer's thread: write a block when its first frame is due."""

    def __init__(self, output: VibrationOutput, recording: RunRecording | None) -> None:
        self.error: Exception | None = None
        self.output, self._recording = output, recording
        self.fill: Fill
        self._written = FrameTime()
        self._block = np.zeros((BLOCK_FRAMES, output.channels), np.float32)

    @property
    def due_s(self) -> float:
        return self._written.after(0, self.output.samplerate)

    def run(self, now_s: float) -> bool:
        block, output = self._block, self.output
        self.fill(block, now_s)
        output.write(block)
        self._written.add(len(block), output.samplerate)
        if self._recording:
            self._recording.sent(block, now_s, output.samplerate)
        return True


def _rigs(settings: Settings) -> list[str | None]:
    return [
        None if index is None else settings.actuators[index].rig or settings.rig
        for index in settings.numbered_channels.sources
    ]


def _maker(address: DeviceAddress, settings: Settings) -> Callable[[int, int], VibrationOutput]:
    """Return a function that opens the output for a sample rate in Hz and a number of channels."""
    if settings.actuators:
        _ = settings.numbered_channels  # raises if an actuator gives its channel by name
    if address.kind == "wav":
        path = Path(address.name)
        AtomicFile(path).abort()
        return lambda samplerate, channels: WavOutput(path, samplerate, channels)
    if address.kind == "twin":
        for rig in (settings.rig, *(one.rig for one in settings.actuators if one.rig)):
            rig_by_name(rig)
        return lambda samplerate, channels: simulated_rig_of(
            settings, samplerate, channel_map_of(settings, channels)
        )
    raise InternalError(f"device {str(address)!r} is neither wav:FILE nor twin")
