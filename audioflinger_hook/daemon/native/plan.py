"""What one chain in PipeWire's graph is to do: from the config, the tap and the device."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from audioflinger_hook.config.settings import Settings
from audioflinger_hook.daemon.native.taps import Tap
from audioflinger_hook.mixer.layouts import source_weights
from audioflinger_hook.transform import TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from device.drive import ChannelMap
from device.drive.channel_positions import actuators_of_channels
from device.server.snapshot import Sink
from device.units import FloatArray


@dataclass(frozen=True)
class ChainPlan:
    """The fixed part of a chain; another plan needs another chain.

    samplerate: of the graph in Hz. tap_channels: of the tap. sources: of vibrations, empty for one
    of the mono mix, or one for each channel. outputs: vibrations. actuators: for each, the number
    of its vibration. parameters: of the transform.
    """

    samplerate: int
    tap_channels: int
    sources: tuple[str, ...]
    outputs: int
    actuators: tuple[int, ...]
    parameters: TransformParameters

    @classmethod
    def of(cls, settings: Settings, tap: Tap, samplerate: int) -> ChainPlan:
        """Return the plan for the settings, a tap and the graph's rate."""
        sources = settings.sources
        each = settings.channels == "each"
        outputs = len(sources) or (tap.channels if each else 1)
        if settings.actuators:
            routed = tuple(sources.index(actuator.source) for actuator in settings.actuators)
        else:
            routed = tuple(range(outputs))
        # As in the Python engine, the mix alone needs no weights.
        mixed = () if sources in ((), ("mix",)) else sources
        return cls(samplerate, tap.channels, mixed, outputs, routed, settings.transform_parameters)

    @property
    def weights(self) -> FloatArray | None:
        """Return the weights of each channel in the sources' halves, None without sources."""
        return source_weights(self.tap_channels, self.sources) if self.sources else None

    @property
    def design(self) -> LiveDesign:
        """Return the design of the transform."""
        return _design(self.parameters, self.samplerate)


@lru_cache(maxsize=8)
def _design(parameters: TransformParameters, samplerate: int) -> LiveDesign:
    return LiveDesign.of(parameters, samplerate)


def device_map(settings: Settings, plan: ChainPlan, sink: Sink) -> ChannelMap:
    """Return which actuator each channel of the device plays.

    UsageError: an actuator wants a channel that the device does not have.
    """
    return actuators_of_channels(sink, settings.actuators, plan.outputs)
