"""Recordings of `cushion run --record`: buffers of tap, effect and device in one capture."""

import json
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.capture import STREAMS, CaptureRecorder, CaptureWriter
from audioflinger_hook.capture.format import Facts
from audioflinger_hook.config.schema import REPLACED_PARAMETERS
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.engine import OnMix, OnStep
from audioflinger_hook.transform import TransformParameters
from device.drive import ActuatorSettings
from device.errors import CushionError, UsageError
from device.rig.rig import SHIPPED
from device.units import Float32Array
from device.values import counted

NESTED = "parameters"  # field of `Settings` whose fields are stored like fields of `Settings`
SAID = "said"  # field stored as names separated by commas; omitted if empty
ACTUATORS = "actuators"  # field stored as JSON, a list of tables as in a config file


def facts_of(settings: Settings) -> Facts:
    """Return all settings that are not None, keyed by name. Paths become absolute."""
    chosen = {field.name: getattr(settings, field.name) for field in fields(settings)}
    parameters = chosen.pop(NESTED)
    tables = [
        asdict(replace(one, rig=one.rig and _absolute(one.rig))) for one in settings.actuators
    ]
    said = [{key: value for key, value in one.items() if value is not None} for one in tables]
    chosen[ACTUATORS] = json.dumps(said) if said else None
    chosen[SAID] = ",".join(chosen[SAID]) or None
    chosen |= {field.name: getattr(parameters, field.name) for field in fields(parameters)}
    chosen["rig"] = _absolute(chosen["rig"])
    if chosen["effects_file"] is not None:
        chosen["effects_file"] = str(chosen["effects_file"].absolute())
    return {name: value for name, value in chosen.items() if value is not None}


def settings_from(facts: Facts) -> Settings | None:
    """Return a recorded run's settings, None if it has none. UsageError: invalid settings."""
    if "form" not in facts:
        return None
    try:
        for name in REPLACED_PARAMETERS.keys() & facts.keys():
            raise UsageError(f"{name} is now {REPLACED_PARAMETERS[name]}")
        parameters = TransformParameters(**_named(TransformParameters, facts))
        chosen = _named(Settings, facts)
        chosen.pop(NESTED, None)
        if "effects_file" in chosen:
            chosen["effects_file"] = Path(chosen["effects_file"])
        if SAID in chosen:
            chosen[SAID] = tuple(chosen[SAID].split(","))
        if ACTUATORS in chosen:
            tables = json.loads(chosen[ACTUATORS])
            chosen[ACTUATORS] = tuple(ActuatorSettings.from_values(table) for table in tables)
        return Settings(**chosen, parameters=parameters)
    except (UsageError, TypeError, ValueError, KeyError) as error:
        raise UsageError(
            f"the settings in the capture cannot be used ({error}); give others with --config"
        ) from None


def _absolute(rig: str) -> str:
    return rig if rig in SHIPPED else str(Path(rig).absolute())


def _named(kind: type[Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    names = {field.name for field in fields(kind)}
    return {name: value for name, value in facts.items() if name in names}


class RunRecording(AbstractContextManager["RunRecording"]):
    """Records one run as a capture with streams `tap`, `effect` and `device`.

    A replay of `tap` reproduces `effect` bit for bit, unless an effect was bypassed. If writing
    fails, the run continues, and `close` raises the error. The thread that calls `Engine.advance`
    also calls `delivered` and the results of `hooks`. The output thread calls `sent`. These calls
    never block. The supervising thread calls `reopened` while the output is closed.
    """

    def __init__(self, folder: Path, settings: Settings, tap: str, device: str) -> None:
        self._mix: tuple[int, int] | None = None
        self._begun = self._device_begun = False
        self._broken = {"effect": False, "device": False}
        self._folder, self._ended = folder, ""
        self._facts = {"tap": tap, "device": device, **facts_of(settings)}
        self._recorder: CaptureRecorder | None = None

    def begin(self) -> None:
        """Create the folder. Call it before the first buffer. For errors, see `CaptureWriter`."""
        writer = CaptureWriter(self._folder, streams=STREAMS, facts=self._facts)
        self._recorder = CaptureRecorder(writer)

    @property
    def problem(self) -> str:
        """Why the recording has ended, in one line, or "". Any thread may read it."""
        error = self._recorder.error if self._recorder else None
        return f"the recording has ended: {error}" if error else self._ended

    @property
    def warnings(self) -> list[str]:
        """Problems of the recording, one line each. Any thread may read them."""
        if self.problem:
            return [self.problem]
        if self._recorder is None:
            return []
        dropped = {name: self._recorder.dropped(name)[0] for name in STREAMS}
        return [
            f"not recorded: {counted(count, 'buffers')} of stream {name}: the disk was too slow"
            for name, count in dropped.items()
            if count
        ]

    def hooks(self, samplerate: int, channels: int, *, of_mix: bool) -> tuple[OnStep, OnMix | None]:
        """Return `on_step` and `on_mix` for this mix format. of_mix: whether `tap` gets the mix."""
        self._mix = (samplerate, channels)

        def felt(_: Float32Array, vibration: Float32Array, now_s: float) -> None:
            self._offer("effect", vibration, samplerate, now_s)

        def mixed(sound: Float32Array, now_s: float) -> None:
            self.delivered(sound, samplerate, now_s, discontinuity=False)

        return felt, mixed if of_mix else None

    def delivered(
        self, frames: Float32Array, samplerate: int, now_s: float, discontinuity: bool
    ) -> None:
        """Record a buffer of the tap. discontinuity: whether earlier frames are missing."""
        recorder = self._recorder
        if self._ended or recorder is None:
            return
        if not self._begun and self._mix not in (None, (samplerate, frames.shape[1])):
            # A replay mixes in the format of the first buffer, so an empty buffer sets the format.
            mix_samplerate, mix_channels = self._mix or (samplerate, 1)
            recorder.offer("tap", np.zeros((0, mix_channels), np.float32), mix_samplerate, now_s)
        self._begun = True
        self._broken["effect"] |= discontinuity
        recorder.offer("tap", frames, samplerate, now_s, discontinuity=discontinuity)

    def reopened(self) -> None:
        """Mark a discontinuity before the next buffer of stream `device`."""
        self._broken["device"] = self._device_begun

    def sent(self, frames: Float32Array, now_s: float, samplerate: int) -> None:
        """Record the frames sent to the device."""
        self._device_begun = True
        self._offer("device", frames, samplerate, now_s)

    def end(self, why: str) -> None:
        """Stop recording. why: reason, as text for the user."""
        self._ended = self._ended or f"the recording {self._folder} has ended: {why}"

    def close(self) -> None:
        """Complete the capture; raise its error, if any. All other threads must have ended."""
        if self._recorder:
            self._recorder.close()

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or not issubclass(kind, CushionError):
            self.close()
            return
        with suppress(CushionError):  # the error that ended the run is more important
            self.close()

    def _offer(self, stream: str, frames: Float32Array, samplerate: int, now_s: float) -> None:
        if self._ended or self._recorder is None:
            return
        broken, self._broken[stream] = self._broken[stream], False
        self._recorder.offer(stream, frames, samplerate, now_s, discontinuity=broken)
