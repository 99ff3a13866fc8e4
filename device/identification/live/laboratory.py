"""A laboratory of real devices: an output plays the sweep, an input records the rig."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from device.identification.live.channels import DRIVE, Inputs
from device.identification.live.exchange import Exchange
from device.identification.live.two_clocks import (
    Drift,
    DropoutError,
    find_delay,
    find_drift,
    resample_to_played,
)
from device.identification.recording import IdentificationError, Recording
from device.identification.sweep import Excitation, Sweep
from device.rig.electronics import Band
from device.rig.parameters import AmplifierParameters
from device.units import FloatArray

MOST_CHANGE_PPM = 40.0
"""Largest change of the drift between two sweeps. Crystals do not change more; lost frames do."""

MOST_TRIES = 3
"""Attempts per sweep; a busy machine loses some frames."""

_MIN_SIGNAL = 1.5
_MAX_AFTER = 0.1
_REST_S = 0.2


class Transport(Protocol):
    """Two streams at one sample rate, one in each direction."""

    samplerate: int  # of both streams, Hz

    def run(self, exchange: Exchange) -> None:
        """Call `exchange.begin` and its callbacks until it has ended; then both are silent.

        Raises LostError or NotFoundError if a stream is missing or was lost.
        """
        ...


@dataclass(frozen=True)
class Devices:
    """The devices used, their delay, and the drift of the input's clock."""

    output: str
    input: str
    delay_s: float
    drift_ppm: float


class LiveLaboratory:
    """A `Laboratory` of real devices. One thread uses it.

    The amplifier's band is divided out of a response to the played signal.
    """

    def __init__(
        self,
        transport: Transport,
        inputs: Inputs,
        output_channel: int = 0,
        amplifier: AmplifierParameters | None = None,
    ) -> None:
        self._transport, self._inputs = transport, inputs
        self._output_channel, self._amplifier = output_channel, amplifier
        self._drifts: list[Drift] = []
        self.delay_s = 0.0  # from a played frame until it is recorded, in the last sweep
        self.current_turned = False  # because a coil takes power
        self.repeated = 0  # sweeps in which frames were lost

    @property
    def drift(self) -> Drift | None:
        """The drift between the two clocks in the last sweep."""
        return self._drifts[-1] if self._drifts else None

    def measure(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        """Return a recording per pair (reference, response) of one sweep, in physical units.

        "drive" is the loop-back or the played signal. In the latter case the unknown delay is
        fitted as well (`Recording.delayed`).
        """
        for _ in range(MOST_TRIES - 1):
            try:
                return self._measure_once(sweep, pairs)
            except DropoutError:
                self.repeated += 1
        return self._measure_once(sweep, pairs)

    def _measure_once(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        excitation = Excitation(sweep)
        exchange = Exchange(
            excitation.samples, sweep.samplerate, self._inputs.names, self._output_channel
        )
        self._transport.run(exchange)
        if exchange.error is not None:
            raise exchange.error
        recorded = exchange.recorded.astype(np.float64)
        background = exchange.background_frames
        for channel in self._inputs.used:
            self._check_signal(recorded[:, channel], background, self._inputs.names[channel])
        channel, name = self._clearest()
        after = recorded[background:, channel]
        delay = find_delay(excitation, after, name)
        drift = find_drift(excitation, after, delay, name)
        self._compare(drift, name)
        self.delay_s = delay / sweep.samplerate
        first = background + delay + excitation.sweep_start * (1.0 + 1e-6 * drift.value)
        read = {}
        for index in self._inputs.used:
            samples = resample_to_played(recorded[:, index], first, drift.value, sweep.frames)
            what = self._inputs.names[index]
            read[what] = samples * self._inputs.scale(what)
        if {"voltage", "current"} <= set(read):
            self.current_turned = float(np.mean(read["voltage"] * read["current"])) < 0.0
            if self.current_turned:
                read["current"] = -read["current"]
        read[DRIVE] = read.get("loopback", sweep.samples())
        return [self._recording(sweep, read, pair) for pair in pairs]

    def _recording(
        self, sweep: Sweep, read: dict[str, FloatArray], pair: tuple[str, str]
    ) -> Recording:
        reference, response = pair
        limits = tuple(self._inputs.scale(name) if name != DRIVE else float("inf") for name in pair)
        delayed = reference == DRIVE and "loopback" not in read
        drift = self._drifts[-1]
        found = Recording(
            sweep,
            read[reference],
            read[response],
            pair,
            (limits[0], limits[1]),
            delayed=delayed,
            polarity_known=response != "acceleration",
            drift_reach=1e-6 * drift.reach if delayed else 0.0,
        )
        if reference == DRIVE and (a := self._amplifier) is not None:
            band = Band(a.low_cut_hz, a.high_cut_hz, sweep.samplerate)
            found = replace(found, correction=band.response(found.frequencies_hz))
        return found

    def _clearest(self) -> tuple[int, str]:
        """Return the channel that shows the playback with the least effect of the rig."""
        names = self._inputs.names
        name = next(n for n in ("loopback", "voltage", "current", "acceleration") if n in names)
        return names.index(name), name

    def _check_signal(self, samples: FloatArray, background: int, name: str) -> None:
        noise, whole = (float(np.std(s)) for s in (samples[:background], samples[background:]))
        if whole <= _MIN_SIGNAL * noise or whole == 0.0:
            raise IdentificationError(
                f"{name}: no signal, {whole:.3g} r.m.s. of full scale during the sweep and "
                f"{noise:.3g} before it; check power, volume, cables and that channel, or raise "
                "the level"
            )
        after = float(np.std(samples[-round(_REST_S * self._transport.samplerate) :]))
        if after > max(3.0 * noise, _MAX_AFTER * whole):
            raise IdentificationError(
                f"{name}: {after:.3g} r.m.s. of full scale after the sweep, {noise:.3g} before it: "
                "something else began to play or to move the cushion; end that, and sweep again"
            )

    def _compare(self, drift: Drift, name: str) -> None:
        for before in self._drifts:
            change = abs(drift.value - before.value)
            if change > MOST_CHANGE_PPM + drift.reach + before.reach:
                raise DropoutError(
                    f"{name}: the clocks differ by {drift.value:+.0f} ppm, in an earlier sweep by "
                    f"{before.value:+.0f}: frames were lost or added; close other programs, and "
                    "sweep again"
                )
        self._drifts.append(drift)
