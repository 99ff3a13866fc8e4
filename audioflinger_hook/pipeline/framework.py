"""The audio framework: mixer, effect chains and the haptic effect."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from audioflinger_hook.config.file import Config, check
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.settings import Settings
from audioflinger_hook.config.toml_text import Mistake
from audioflinger_hook.drive.drive import Drive
from audioflinger_hook.effect import haptic_parameters
from audioflinger_hook.effect.chain import BUDGET_SHARE, EffectChains
from audioflinger_hook.effect.interface import OK, Command, Values
from audioflinger_hook.effect.module import BlockWatch, EffectModule
from audioflinger_hook.effect.registry import EffectRegistry
from audioflinger_hook.effect.xml import OUTPUT_MIX_STREAM, bundled_effects, read_effects
from audioflinger_hook.mixer import Mixer
from audioflinger_hook.mixer.mix_buffer import OUTPUT_MIX
from audioflinger_hook.transform import HapticTransform
from device.drive.channel_map import ChannelMap
from device.errors import CushionError, InternalError, UsageError
from device.output import VibrationOutput
from device.rig import rig_by_name
from device.rig.simulated_rig import SimulatedRig
from device.stream.callback_thread import cpu_time_s

HAL_FRAMES = 240  # frames per buffer of the assumed hardware; see `normal_buffer_frames`
OFFLINE_HAL_FRAMES = 32_768  # the same for files; long cycles save CPU time


class Framework:
    """A mixer with the effects that audio_effects.xml lists, including the haptic effect.

    One thread runs the mixer's cycles and calls the methods. Another thread may call `change` and
    `look_for_blocked`. Any thread may call `bypassed` and read the properties.

    samplerate: Hz. warnings: messages about effects that could not be loaded.
    haptic_channels: channels of vibration: 1, or one per channel of the mix, or one per source.
    hal_frames, standby_delay_s: see `Mixer`. If standby_delay_s is infinite, silence is output too.
    clock: returns seconds, to measure how long effects take; None: no slow effect is bypassed.
    UsageError: the settings do not fit `samplerate`, or the effects file has no haptic effect.
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
        self.settings, self.samplerate = settings or Settings(), samplerate
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
            self._try(self.settings)  # raises an error that names the wrong setting
            problem = self.haptic.bypassed or "refused its parameters"
            raise UsageError(f"the haptic effect {problem}")
        # Apply the parameters before the first buffer.
        self._chains.end_of_cycle(0.0)

    @property
    def latency_frames(self) -> int:
        """Delay of the vibration behind its sound, in frames."""
        return self._reading("latency_frames")

    @property
    def latency_s(self) -> float:
        """Delay of the vibration behind its sound, in seconds."""
        return self.latency_frames / self.samplerate

    @property
    def limited_samples(self) -> int:
        """Number of vibration samples that were limited to full scale."""
        return self._reading("limited_samples")

    @property
    def replaced_samples(self) -> int:
        """Number of invalid sound samples that were replaced by 0."""
        return self._reading("replaced_samples")

    @property
    def principal(self) -> tuple[tuple[float, float, float], ...]:
        """Partials of the latest hop, as in `HapticTransform.principal`. Any thread may read it."""
        status, partials = self.haptic.command(haptic_parameters.PRINCIPAL)
        return partials if status == OK and isinstance(partials, tuple) else ()

    def take_glides(self) -> NDArray[np.float64]:
        """Return the glides since the last call; see `HapticTransform.take_glides`."""
        return self._array(haptic_parameters.GLIDES)

    def change(self, settings: Settings) -> None:
        """Apply new transform parameters or a new gain from the next cycle on, but nothing else.

        A new gain is reached within one buffer. With new parameters, the vibration fades out within
        one buffer, and a new transform starts. After a UsageError, nothing has changed.
        """
        if settings.transform_parameters != self.settings.transform_parameters:
            self._try(settings)
        if settings == self.settings:
            return
        self.settings = settings
        self._wanted = self._parameters(settings)
        self.mixer.post(self._take_wanted)

    def drain(self) -> NDArray[np.float32]:
        """Return the vibration that the effect still holds. InternalError: see `check_haptics`."""
        return self._array(haptic_parameters.DRAIN)

    def check_haptics(self) -> None:
        """Raise InternalError if the haptic effect is bypassed: a file would lack vibration."""
        if self.haptic.bypassed:
            raise InternalError(f"the haptic effect failed: {self.haptic.bypassed}")

    def bypassed(self) -> list[str]:
        """Return a text `session, effect: reason` for each bypassed effect."""
        return self._chains.bypassed()

    def bypass_warnings(self) -> list[str]:
        """Return a message for the user about each bypassed effect."""
        return [f"effect bypassed: {reason}" for reason in self.bypassed()]

    def look_for_blocked(self, now_s: float) -> None:
        """Bypass every effect that blocks the audio thread, except the haptic effect."""
        others = [effect for effect in self._chains.effects() if effect is not self.haptic]
        self._block_watch.look(others, now_s)

    def _add_effects(self) -> EffectModule:
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
            if uuid == haptic_parameters.HAPTIC_CUSHION.uuid:
                haptic = module
        if haptic is None:
            why = f" ({'; '.join(self.warnings)})" if self.warnings else ""
            raise UsageError(
                f"{path} does not apply the haptic effect "
                f"({haptic_parameters.HAPTIC_CUSHION.uuid}) to the stream "
                f"{OUTPUT_MIX_STREAM!r}{why}; without it there is no vibration"
            )
        return haptic

    @staticmethod
    def _parameters(settings: Settings) -> Values:
        parameters = haptic_parameters.from_settings(settings)
        # The vibration of the reference form has the paper's values, so it is not clipped.
        parameters["clip"] = settings.form != "reference"
        return parameters

    def _take_wanted(self) -> None:
        """Pass the latest settings to the effect. The mixer's thread calls this method."""
        if self._wanted is not self._taken:
            self._taken = self._wanted
            # The settings are valid, so only a bypassed effect refuses them; `bypassed` reports it.
            self.haptic.set_parameters(self._taken)

    def _try(self, settings: Settings) -> None:
        rate_hz, channels = self.samplerate, self.mixer.channels
        try:
            HapticTransform(rate_hz, channels, settings.transform_parameters, form=settings.form)
        except ValueError as error:  # the sample rate is too low for the band
            raise UsageError(f"no transform can be made at {rate_hz} Hz: {error}") from error

    def _array(self, code: int) -> NDArray[Any]:
        status, reply = self.haptic.command(code)
        self.check_haptics()
        if status != OK or not isinstance(reply, np.ndarray):
            raise InternalError(f"the haptic effect failed: status {status}")
        return reply

    def _reading(self, name: str) -> int:
        status, value = self.haptic.command(Command.GET_PARAM, name)
        return value if status == OK and isinstance(value, int) else 0


def drive_of(settings: Settings, samplerate: int, haptic_channels: int) -> Drive:
    """Return a `Drive`. haptic_channels: channels of vibration. UsageError: see `Drive`."""
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
    """Return the map for a file or simulated rig. UsageError: a channel is named by position."""
    if settings.actuators:
        return settings.numbered_channels
    return ChannelMap.repeated(haptic_channels, haptic_channels)


def simulated_rig_of(
    settings: Settings,
    samplerate: int,
    channel_map: ChannelMap,
    recorder: VibrationOutput | None = None,
) -> SimulatedRig:
    """Return a simulated rig for these channels. UsageError: a rig is unknown or invalid."""
    names = [actuator.rig or settings.rig for actuator in settings.actuators]
    rigs = [rig_by_name(name) for name in names or [settings.rig] * channel_map.actuators]
    return SimulatedRig(
        [None if source is None else rigs[source] for source in channel_map.sources],
        samplerate,
        recorder=recorder,
        tolerance=settings.tolerance,
        model=settings.model,
        clock=cpu_time_s,
    )


SAMPLERATE = 48_000  # sample rate in Hz for checking an effects file


def find_mistakes(path: Path) -> tuple[Config | None, list[str], list[Mistake]]:
    """Return the settings of a config file, warnings, and all mistakes in it.

    The settings are None if there are mistakes, except those of the effects file.
    UsageError: the file cannot be read or is not text.
    """
    found, mistakes = check(path, LIVE_DEFAULT)
    warnings: list[str] = []
    if found and (effects := found.settings.effects_file):
        try:
            warnings = Framework(SAMPLERATE, 2, found.settings).warnings
        except UsageError as error:
            why = f"cannot be used: {error}"
            allowed = "an audio_effects.xml that applies the haptic effect"
            mistakes = [Mistake("effects_file", 0, f'"{effects}"', why, allowed)]
    return found, warnings, mistakes
