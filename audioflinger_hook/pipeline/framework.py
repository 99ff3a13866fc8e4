"""The audio framework: mixer, effect chains and the haptic effect."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.drive.drive import Drive
from audioflinger_hook.effect.chain import BUDGET_SHARE, EffectChains
from audioflinger_hook.effect.haptic_parameters import (
    DRAIN,
    GLIDES,
    HAPTIC_CUSHION,
    PRINCIPAL,
    from_settings,
)
from audioflinger_hook.effect.interface import OK, Command, Values
from audioflinger_hook.effect.module import BlockWatch, EffectModule
from audioflinger_hook.effect.registry import EffectRegistry
from audioflinger_hook.effect.xml import OUTPUT_MIX_STREAM, bundled_effects, read_effects
from audioflinger_hook.mixer import Mixer, dump
from audioflinger_hook.mixer.mix_buffer import OUTPUT_MIX
from audioflinger_hook.transform import HapticTransform
from device.drive.channel_map import ChannelMap
from device.errors import CushionError, InternalError, UsageError
from device.output import VibrationOutput
from device.rig import rig_by_name
from device.rig.simulated_rig import SimulatedRig
from device.stream.callback_thread import cpu_time_s

HAL_FRAMES = 240  # taken at once by the assumed output; a cycle is 20 ms of such frames
OFFLINE_HAL_FRAMES = 32_768  # offline, long cycles cost least


class Framework:
    """One mix with the effects that audio_effects.xml lists, including the haptic effect.

    The thread that steps the mix calls all methods but `change` and `look_for_blocked`, which
    another thread calls; any thread may call `dump`, `bypassed` and the properties.

    samplerate, channels: of the mix; the rate in Hz. haptic_channels: one; or one for each channel
    of the mix, or for each source of the named actuators.
    hal_frames, standby_delay_s: see `Mixer`; files keep their silence, so inf.
    clock: seconds; an effect that takes too long is bypassed. None for files: time has no effect.
    warnings: effects that were left out.
    UsageError: format and settings cannot be combined, or the effects file cannot be read or does
        not apply the haptic effect.
    """

    def __init__(
        self,
        samplerate: int,
        channels: int,
        settings: Settings | None = None,
        *,
        hal_frames: int = HAL_FRAMES,
        clock: Callable[[], float] | None = None,
        standby_delay_s: float = math.inf,
    ) -> None:
        self.settings = settings or Settings()
        self.samplerate = samplerate
        self.warnings: list[str] = []
        each = self.settings.channels == "each"
        self.haptic_channels = channels if each else max(1, len(self.settings.sources))
        self._chains = EffectChains(
            clock or (lambda: 0.0), budget_share=BUDGET_SHARE if clock else float("inf")
        )
        self.haptic = self._add_effects()
        self._block_watch = BlockWatch()
        self._wanted = self._taken = self._parameters(self.settings)
        self.mixer = Mixer(
            samplerate,
            channels,
            hal_frames=hal_frames,
            haptic_channels=self.haptic_channels,
            effects=self._chains,
            standby_delay_s=standby_delay_s,
        )
        if self.haptic.set_parameters(self._taken) != OK or self.haptic.bypassed:
            self._try(self.settings)  # finds the mistake in the format or the settings
            problem = self.haptic.bypassed or "refused its parameters"
            raise UsageError(f"the haptic effect {problem}")
        # Applied now, not a cycle later, so that the first buffer has them.
        self._chains.end_of_cycle(0.0)

    @property
    def latency_frames(self) -> int:
        """Frames by which the vibration comes after its sound."""
        return self._reading("latency_frames")

    @property
    def latency_s(self) -> float:
        """The same in seconds."""
        return self.latency_frames / self.samplerate

    @property
    def limited_samples(self) -> int:
        """Samples of vibration so far that were limited to full scale."""
        return self._reading("limited_samples")

    @property
    def replaced_samples(self) -> int:
        """Unusable samples of sound so far, which count as 0."""
        return self._reading("replaced_samples")

    @property
    def principal(self) -> tuple[tuple[float, float, float], ...]:
        """What the latest hop vibrates; see `HapticTransform.principal`. Any thread."""
        status, partials = self.haptic.command(PRINCIPAL)
        return partials if status == OK and isinstance(partials, tuple) else ()

    def take_glides(self) -> NDArray[np.float64]:
        """Return what the partials did since the last call; see `HapticTransform.take_glides`."""
        return self._array(GLIDES)

    def change(self, settings: Settings) -> None:
        """Use other parameters and another gain from the next cycle on; nothing else may differ.

        A new gain is reached within one buffer. With other parameters the vibration fades out
        within one buffer and restarts `latency_frames` later. UsageError: nothing has changed.
        """
        if settings.transform_parameters != self.settings.transform_parameters:
            self._try(settings)
        if settings == self.settings:
            return
        self.settings = settings
        self._wanted = self._parameters(settings)
        self.mixer.post(self._take_wanted)

    def drain(self) -> NDArray[np.float32]:
        """Return the vibration held back after the last sound; raises as `check_haptics`."""
        return self._array(DRAIN)

    def check_haptics(self) -> None:
        """Raise InternalError if the haptic effect is bypassed: a file must be complete."""
        if self.haptic.bypassed:
            raise InternalError(f"the haptic effect failed: {self.haptic.bypassed}")

    def bypassed(self) -> list[str]:
        """Return `session, effect: reason` of every bypassed effect."""
        return self._chains.bypassed()

    def bypass_warnings(self) -> list[str]:
        """Return a line for the user about every bypassed effect."""
        return [f"effect bypassed: {reason}" for reason in self.bypassed()]

    def look_for_blocked(self, now_s: float) -> None:
        """Bypass other effects that keep the audio thread; for one other thread, every 0.1 s."""
        others = [effect for effect in self._chains.effects() if effect is not self.haptic]
        self._block_watch.look(others, now_s)

    def dump(self, cycle_times_s: Sequence[float] = ()) -> str:
        """Return thread, tracks and chains as text, see `dump` of the mixer."""
        return dump(self.mixer, cycle_times_s)

    def _add_effects(self) -> EffectModule:
        """Add the effects that the file applies to the output mix; return the haptic effect."""
        registry = EffectRegistry.installed()
        path = self.settings.effects_file
        declared = read_effects(path, registry) if path else bundled_effects(registry)
        self.warnings += registry.problems
        self.warnings += [f"{path or 'effects'}: {problem}" for problem in declared.problems]
        haptic = None
        for uuid in declared.postprocess.get(OUTPUT_MIX_STREAM, ()):
            try:
                module = self._chains.add(registry.create(uuid), OUTPUT_MIX)
            except CushionError as error:
                self.warnings.append(f"effect {uuid} is left out: {error}")
                continue
            module.enable()
            if uuid == HAPTIC_CUSHION.uuid:
                haptic = module
        if haptic is None:
            why = f" ({'; '.join(self.warnings)})" if self.warnings else ""
            raise UsageError(
                f"{path} does not apply the haptic effect ({HAPTIC_CUSHION.uuid}) to the stream "
                f"{OUTPUT_MIX_STREAM!r}{why}; without it there is no vibration"
            )
        return haptic

    @staticmethod
    def _parameters(settings: Settings) -> Values:
        parameters = from_settings(settings)
        # The reference form keeps the published values; what reaches a device is clipped.
        parameters["clip"] = settings.form != "reference"
        return parameters

    def _take_wanted(self) -> None:
        """Give the effect the latest settings, on the thread that steps the mixer."""
        if self._wanted is not self._taken:
            self._taken = self._wanted
            # It was checked: only a bypassed effect refuses it, which `bypassed` reports.
            self.haptic.set_parameters(self._taken)

    def _try(self, settings: Settings) -> None:
        """Raise UsageError if no transform can have these settings."""
        rate_hz, channels = self.samplerate, self.mixer.channels
        try:
            HapticTransform(rate_hz, channels, settings.transform_parameters, form=settings.form)
        except ValueError as error:  # the band does not fit the sample rate
            raise UsageError(f"no transform can be made at {rate_hz} Hz: {error}") from error

    def _array(self, code: int) -> NDArray[Any]:
        """Return the haptic effect's reply to a vendor command."""
        status, reply = self.haptic.command(code)
        self.check_haptics()
        if status != OK or not isinstance(reply, np.ndarray):
            raise InternalError(f"the haptic effect failed: status {status}")
        return reply

    def _reading(self, name: str) -> int:
        status, value = self.haptic.command(Command.GET_PARAM, name)
        return value if status == OK and isinstance(value, int) else 0


def drive_of(settings: Settings, samplerate: int, haptic_channels: int) -> Drive:
    """Return the drive of a mix with so many channels of vibration; UsageError: see `Drive`."""
    return Drive(
        settings.actuators,
        samplerate,
        haptic_channels,
        rig=settings.rig,
        damping=settings.damping,
        protection=settings.protection,
        exposure_cap=settings.exposure_cap,
    )


def channel_map_of(settings: Settings, haptic_channels: int) -> ChannelMap:
    """Return which actuator each channel of a file or rig plays; UsageError: one has no number."""
    if settings.actuators:
        return settings.numbered_channels
    return ChannelMap.repeated(haptic_channels, haptic_channels)


def simulated_rig_of(
    settings: Settings,
    samplerate: int,
    channel_map: ChannelMap,
    recorder: VibrationOutput | None = None,
) -> SimulatedRig:
    """Return the simulated rig that the map's channels play to; UsageError: a rig lacks figures."""
    names = [actuator.rig or settings.rig for actuator in settings.actuators]
    rigs = [rig_by_name(name) for name in names or [settings.rig] * channel_map.actuators]
    connected = [None if source is None else rigs[source] for source in channel_map.sources]
    return SimulatedRig(
        connected,
        samplerate,
        recorder=recorder,
        tolerance=settings.tolerance,
        model=settings.model,
        clock=cpu_time_s,
    )
