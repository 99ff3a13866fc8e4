"""A file, or the simulated rig, in the place of a device: it takes vibration in real time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.pacing import FrameTime, Pacer
from audioflinger_hook.daemon.recording import RunRecording
from audioflinger_hook.daemon.sides import Actuated, Fill
from audioflinger_hook.pipeline.drive_factory import channel_map_of, simulated_rig_of
from device.address import DeviceAddress
from device.atomic_file import AtomicFile
from device.drive import ChannelRouter
from device.errors import InternalError, UsageError
from device.output import VibrationOutput
from device.rig import rig_by_name
from device.rig.simulated_rig import SimulatedRig
from device.server import PulseConnection, ServerSnapshot
from device.wav_output import WavOutput

BLOCK_FRAMES = 256
"""What a sound server asks for at a time."""


class PacedOutput:
    """A WAV file or the twin, asked for by nobody: blocks are taken as their time comes.

    address: of kind wav or twin; settings: say what rigs the twin has, and what actuators hang at
    which channels. It has the mix's rate and the vibration's channels, or as many as the actuators
    need. A file appears with `end(keep=True)`, whole, and has a silence its length. Closed,
    it pauses. For the supervising thread alone; the pacer's thread writes.

    Raises
    ------
    UsageError
        The file cannot be written there; there is no such rig.
    """

    needs_server = False
    xruns = 0

    def __init__(
        self,
        address: DeviceAddress,
        pacer: Pacer,
        settings: Settings | None = None,
        recording: RunRecording | None = None,
    ) -> None:
        self._address = address
        self._pacer = pacer
        self._recording = recording
        self._job: _Taking | None = None
        self._settings = settings or Settings()
        self._router = ChannelRouter(self._settings.actuators)
        self._make = _maker(address, self._settings)
        self._format: tuple[int, int] | None = None

    def __str__(self) -> str:
        return str(self._address)

    @property
    def may_rest(self) -> bool:
        """Only what keeps no time of its own."""
        return self._address.kind != "wav"

    @property
    def name(self) -> str | None:
        """What is written to, while it is."""
        return str(self._address) if self.is_open else None

    @property
    def is_open(self) -> bool:
        """Whether it takes vibration."""
        return self._job is not None and self._pacer.is_doing(self._job)

    @property
    def warnings(self) -> list[str]:
        """None."""
        return []

    @property
    def summary(self) -> str:
        """What the rig did, one line; empty for a file, and before the first block."""
        output = self._job.output if self._job else None
        if not isinstance(output, SimulatedRig):
            return ""
        return (
            f"twin (predicted): peak acceleration {output.peak_acceleration_m_s2:.1f} m/s², "
            f"excursion {output.peak_displacement_m * 1e3:.2f} mm, "
            f"current {output.peak_current_a:.2f} A"
        )

    def suit(self, samplerate: int, channels: int) -> None:
        """Be told the mix's rate, Hz, and the vibration's channels, before the first `keep`."""
        self._format = (samplerate, channel_map_of(self._settings, channels).channels)

    def refuse(self, actuators: Actuated) -> None:
        """Raise UsageError if these do not fit what is written, or the rigs that are simulated."""
        before, after = self._settings, replace(self._settings, actuators=tuple(actuators))
        if before.numbered_channels.channels != after.numbered_channels.channels:
            raise UsageError(
                f"{self} has {before.numbered_channels.channels} channels for the actuators, and "
                f"cannot have {after.numbered_channels.channels} while it runs; start it anew"
            )
        if self._address.kind == "twin" and _rigs(before) != _rigs(after):
            raise UsageError(
                "the simulated rigs stay on their channels while they run; start it anew"
            )

    def wire(self, actuators: Actuated) -> None:
        """Take these actuators, without a gap."""
        self._settings = replace(self._settings, actuators=tuple(actuators))
        self._router.change(self._settings.actuators, self._settings.numbered_channels)

    def delay_s(self, snapshot: ServerSnapshot | None) -> float:
        """Nothing is on its way."""
        return 0.0

    def locate(self, snapshot: ServerSnapshot | None) -> _Device:
        """It is there."""
        return _Device(str(self._address), *(self._format or (0, 0)))

    def keep(self, connection: PulseConnection | None, fill: Fill, now_s: float) -> None:
        """Take vibration, or go on. Raises what has ended it, for good (WriteError: disk full)."""
        job = self._job
        if job is None:
            assert self._format is not None
            channel_map = channel_map_of(self._settings, self._format[1])
            fill = self._router.connect(fill, channel_map, BLOCK_FRAMES)
            job = self._job = _Taking(self._make(*self._format), fill, self._recording)
        if job.error is not None:
            raise job.error
        if not self._pacer.is_doing(job):
            if self._recording:
                self._recording.reopened()
            self._pacer.begin(job, now_s)

    def close(self) -> None:
        """Pause."""
        if self._job is not None:
            self._pacer.end(self._job)

    def end(self, *, keep: bool) -> None:
        """Finish the file, or drop it."""
        self.close()
        if self._job is not None:
            if keep and self._job.error is None:
                self._job.output.close()
            else:
                self._job.output.abort()


@dataclass(frozen=True)
class _Device:
    """What takes the vibration, as a place."""

    name: str
    samplerate: int
    channels: int


class _Taking:
    """The job: a block is taken when its first frame is due."""

    def __init__(self, output: VibrationOutput, fill: Fill, recording: RunRecording | None) -> None:
        self.error: Exception | None = None
        self.output = output
        self._fill = fill
        self._recording = recording
        self._taken = FrameTime(output.samplerate)
        self._block = np.zeros((BLOCK_FRAMES, output.channels), np.float32)

    @property
    def due_s(self) -> float:
        """When what was taken has been played."""
        return self._taken.after(0, self.output.samplerate)

    def run(self, now_s: float) -> bool:
        """Take the next block."""
        block, output = self._block, self.output
        self._fill(block, now_s)
        output.write(block)
        self._taken.add(len(block), output.samplerate)
        if self._recording:
            self._recording.sent(block, output.samplerate, now_s)
        return True


def _rigs(settings: Settings) -> list[str | None]:
    """The rig at every channel, None for none."""
    return [
        None if index is None else settings.actuators[index].rig or settings.rig
        for index in settings.numbered_channels.sources
    ]


def _maker(address: DeviceAddress, settings: Settings) -> Callable[[int, int], VibrationOutput]:
    """Return what opens the output for a rate in Hz and channels; what is wrong shows at once."""
    if settings.actuators:
        _ = settings.numbered_channels  # raises: one of them goes by a name
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
    raise InternalError(f"device {str(address)!r} is none that is paced")
