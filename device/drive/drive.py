"""The drive path: turns the vibration of the sources into the signal of each actuator."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from device.drive.actuator_feed import FADE_S, ActuatorFeed, DelayBuffer, TapPoint
from device.drive.channel_map import ChannelMap
from device.drive.rig_processor import make_rig_processor
from device.drive.settings import DELAY_MAX_MS, ActuatorSettings, sources_of
from device.errors import InternalError
from device.units import Block, Float32Array, FloatArray, check_channels

PART_FRAMES = 4_096
"""Longer blocks are routed in parts of this length, to limit the memory."""

WHOLE_DEVICE = (ActuatorSettings((0,)),)
"""Placeholder if no actuator is named: one actuator with all channels, whatever is listed."""


class Drive:
    """Routes, delays, scales and protects the signals of one device's actuators.

    Blocks come as (frames, inputs) and leave as (frames, outputs). Apart from `delay_ms`, all
    actuators have the same latency: one whose rig needs less waits for the others. Without named
    actuators, one actuator plays all channels of the vibration. If it needs no processing either,
    `process` returns the same block object.

    One thread calls `process`, `drain` and `flush`; any thread may call the rest.

    actuators: what each actuator plays; empty for one that plays all channels of the vibration.
    samplerate: rate in Hz.
    channels: number of channels of the vibration; used only if no actuators are named.
    rig, damping, protection, exposure_cap: values for actuators that do not set their own.
    sources: names of the input columns; empty if no actuators are named.
    inputs, outputs: columns of the blocks that come and leave.
    processors: processing for each actuator's rig, None if its settings are all "off".
    latency_frames: latency of all actuators in frames, without their `delay_ms`.
    UsageError: there is no such rig, or the sample rate is too low for its processing.
    """

    def __init__(
        self,
        actuators: Sequence[ActuatorSettings],
        samplerate: int,
        channels: int = 1,
        *,
        rig: str = "paper",
        damping: str = "off",
        protection: str = "off",
        exposure_cap: str = "off",
    ) -> None:
        self.samplerate = samplerate
        self.sources = sources_of(actuators)
        self.inputs = len(self.sources) or channels
        self.outputs = len(actuators) or channels
        self.processors = tuple(
            make_rig_processor(
                actuator.rig or rig,
                samplerate,
                1 if actuators else channels,
                damping=actuator.damping or damping,
                protection=actuator.protection or protection,
                exposure_cap=actuator.exposure_cap or exposure_cap,
            )
            for actuator in actuators or WHOLE_DEVICE
        )
        self._latencies = [one.latency_frames if one else 0 for one in self.processors]
        self.latency_frames = max(self._latencies)
        self._settings = self._taken = tuple(actuators)
        fade_frames = max(1, round(FADE_S * samplerate))
        self._feeds = [
            ActuatorFeed(self._tap_point(index, actuator), actuator.factor, fade_frames)
            for index, actuator in enumerate(actuators)
        ]
        # Without routing there are no delays.
        longest = round(1e-3 * DELAY_MAX_MS * samplerate) + self.latency_frames if actuators else 0
        part_frames = PART_FRAMES if actuators else 0
        self._delay_buffer = DelayBuffer(len(self.sources), longest, part_frames)
        self._column, self._spare = np.zeros((part_frames, 1)), np.zeros(part_frames)

    @property
    def settings(self) -> tuple[ActuatorSettings, ...]:
        """The latest settings of the named actuators."""
        return self._settings

    @property
    def delays_frames(self) -> tuple[int, ...]:
        """Delay set for each named actuator, in frames."""
        return tuple(self._delay(actuator) for actuator in self._settings)

    @property
    def strength_db(self) -> float | None:
        """Least perceived strength of damped actuators, see `RigProcessor`; None without any."""
        found = [one.strength_db for one in self.processors if one]
        return min((one for one in found if one is not None), default=None)

    def change(self, settings: Sequence[ActuatorSettings]) -> None:
        """Fade to other levels, polarities, delays and sources, starting with the next block.

        InternalError: the number of actuators differs, or a source is new.
        """
        if len(settings) != len(self._feeds) or not {*sources_of(settings)} <= {*self.sources}:
            raise InternalError("the number of actuators, or their sources, cannot change")
        self._settings = tuple(settings)

    def process(self, vibration: Block) -> Block | Float32Array:
        """Return the actuators' signals, (frames, outputs), for a block of (frames, inputs).

        The block does not change. A routed result is float32, else it has the block's precision.
        """
        check_channels(vibration, self.inputs)
        return self._routed(vibration) if self._feeds else self._unrouted(vibration)

    def drain(self) -> Float32Array:
        """Return the frames still held back at the signal's end, including the longest delay."""
        frames = self.latency_frames + max(self.delays_frames, default=0)
        return self.process(np.zeros((frames, self.inputs))).astype(np.float32, copy=False)

    def flush(self) -> None:
        """Drop the frames held back; counts and doses stay. Call it only while nothing plays."""
        self._delay_buffer.reset()
        for feed in self._feeds:
            feed.settle()
        self.process(np.zeros((max(1, self.latency_frames), self.inputs)))

    def _unrouted(self, vibration: Block) -> Block:
        processor = self.processors[0]
        return vibration if processor is None else processor.process(vibration.copy())

    def _routed(self, vibration: Float32Array | FloatArray) -> Float32Array:
        wanted = self._settings
        if wanted is not self._taken:
            self._taken = wanted
            for index, actuator in enumerate(wanted):
                self._feeds[index].change(self._tap_point(index, actuator), actuator.factor)
        out = np.empty((len(vibration), self.outputs), np.float32)
        for start in range(0, len(vibration), PART_FRAMES):
            part = vibration[start : start + PART_FRAMES]
            self._delay_buffer.add(part)
            column, spare = self._column[: len(part)], self._spare[: len(part)]
            for index, (feed, processor) in enumerate(
                zip(self._feeds, self.processors, strict=True)
            ):
                feed.read(self._delay_buffer, column[:, 0], spare)
                if processor is not None:
                    processor.process(column)
                out[start : start + len(part), index] = column[:, 0]
        return out

    def _tap_point(self, index: int, actuator: ActuatorSettings) -> TapPoint:
        waiting = self.latency_frames - self._latencies[index]
        return TapPoint(self.sources.index(actuator.source), waiting + self._delay(actuator))

    def _delay(self, actuator: ActuatorSettings) -> int:
        return round(1e-3 * actuator.delay_ms * self.samplerate)


Fill = Callable[[Float32Array, float], None]
"""Called with (out, now_s); writes the next vibration, (frames, actuators), into `out`."""


class ChannelRouter:
    """Routes actuators to one output's channels; outlives the output's streams.

    For the supervising thread alone.

    actuators: the named actuators; if empty, the vibration's channels repeat over the device's.
    """

    def __init__(self, actuators: Sequence[ActuatorSettings]) -> None:
        self.actuators = actuators
        self._routed: RoutedFill | None = None

    def connect(self, fill: Fill, channel_map: ChannelMap, block_frames: int) -> Fill:
        """Return the function that fills the device's channels, for a stream that opens now."""
        self._routed = RoutedFill(fill, channel_map, block_frames)
        return self._routed.fill

    def change(self, actuators: Sequence[ActuatorSettings], channel_map: ChannelMap | None) -> bool:
        """Change the actuators; return whether the open stream can continue with them.

        channel_map: of the new actuators on the open channels, None if there is none.
        """
        before, self.actuators = self.actuators, actuators
        if before == actuators:
            return True
        routed = self._routed
        if routed is None or channel_map is None or len(before) != len(actuators):
            return False
        if routed.channels != channel_map.channels:
            return False
        routed.change(channel_map)
        return True


class RoutedFill:
    """Fills a device's channels from a `Fill` that has one column for each actuator.

    The output's thread calls `fill`; any thread may call `change`.

    fill: writes the actuators' signals.
    channel_map: which actuator each channel plays.
    block_frames: usual length of a block; another length allocates new memory.
    """

    def __init__(self, fill: Fill, channel_map: ChannelMap, block_frames: int) -> None:
        self._fill = fill
        self._map = self._wanted = channel_map
        self._take_memory(block_frames)

    @property
    def channels(self) -> int:
        """Channels of the device."""
        return self._wanted.channels

    def change(self, channel_map: ChannelMap) -> None:
        """Fade within the next block to a map of equally many actuators and channels."""
        old = self._wanted
        if (old.actuators, old.channels) != (channel_map.actuators, channel_map.channels):
            raise InternalError(
                f"{channel_map.actuators} actuators on {channel_map.channels} channels cannot "
                f"replace {old.actuators} on {old.channels}"
            )
        self._wanted = channel_map

    def fill(self, out: Float32Array, now_s: float) -> None:
        """Write the next vibration, (frames, channels)."""
        old, new = self._map, self._wanted
        if new is old and new.is_direct:
            self._fill(out[:, : new.actuators], now_s)
            out[:, new.actuators :] = out[:, :1]
            return
        if len(self._vibration) != len(out):
            self._take_memory(len(out))
        else:
            self._vibration[:] = np.float32(0.0)
        self._fill(self._vibration, now_s)
        new.write(self._vibration, out)
        if new is not old:
            old.write(self._vibration, self._old)
            out += self._leaving * (self._old - out)
            self._map = new

    def _take_memory(self, frames: int) -> None:
        self._vibration = np.zeros((frames, self._map.actuators), np.float32)
        self._old = np.zeros((frames, self._map.channels), np.float32)
        self._leaving = np.linspace(1.0, 0.0, frames + 1, dtype=np.float32)[1:, None]
