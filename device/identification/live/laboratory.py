"""A laboratory of real devices: an output plays the sweep, an input records the rig."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from device.errors import BrokenStreamError, UsageError
from device.identification.live import two_clocks
from device.identification.live.exchange import Exchange
from device.identification.recording import (
    PLAYED,
    Excitation,
    IdentificationError,
    Recording,
    Sweep,
)
from device.identification.simulated_laboratory import through_amplifier
from device.rig.parameters import AmplifierParameters
from device.units import FloatArray

QUANTITIES = ("acceleration", "current", "voltage", "loopback")
UNUSED = "-"
SHUNT_OHM = 1e-3, 10.0  # a larger shunt reduces the voltage too much; a smaller one gives no signal
DRIVE = "drive"  # name of the loop-back if there is one, else of the played signal
MOST_CHANNELS = 32


@dataclass(frozen=True)
class Inputs:
    """The input's channels in order, each one of QUANTITIES or "-", and their scales."""

    names: tuple[str, ...]
    full_scale_v: float | None = None  # peak volts at the input for a sample of 1.0
    acceleration_v_per_m_s2: float | None = None  # of accelerometer and conditioning amplifier
    shunt_ohm: float | None = None  # resistor across which the current is measured
    voltage_ratio: float = 1.0  # volts at the coil per volt at the input

    def __post_init__(self) -> None:
        used = [name for name in self.names if name != UNUSED]
        unknown = [name for name in used if name not in QUANTITIES]
        twice = sorted({name for name in used if used.count(name) > 1})
        shown = ",".join(self.names)
        what = ""
        if unknown:
            what = f"{unknown[0]!r} is unknown"
        elif twice:
            what = f"{', '.join(twice)} twice"
        elif not 1 <= len(self.names) <= MOST_CHANNELS:
            what = f"1 to {MOST_CHANNELS} channels are possible"
        if what:
            raise UsageError(
                f"channels={shown}: {what}; name each input in order, of "
                f"{', '.join(QUANTITIES)}, and {UNUSED} for one that is not used"
            )
        if "acceleration" not in used and not {"voltage", "current"} <= set(used):
            raise UsageError(
                f"channels={shown}: nothing can be identified from that; name acceleration, or "
                "voltage and current"
            )
        scales = {
            "input full scale": self.full_scale_v,
            "acceleration sensitivity": self.acceleration_v_per_m_s2,
            "shunt": self.shunt_ohm,
            "voltage ratio": self.voltage_ratio,
        }
        for name, value in scales.items():
            if value is not None and not 0.0 < value < 1e9:
                raise UsageError(f"{name}={value!r} must be above 0; correct it")
        if self.shunt_ohm is not None and not SHUNT_OHM[0] <= self.shunt_ohm <= SHUNT_OHM[1]:
            raise UsageError(
                f"shunt={self.shunt_ohm:g} ohm is not that of a resistor in a coil's line: "
                f"{SHUNT_OHM[0]:g} to {SHUNT_OHM[1]:g} ohm is allowed, 0.1 to 1 usual; measure "
                "the resistor and give --shunt-ohm in ohm"
            )
        physical = {"voltage", "current"} & set(used) or self.acceleration_scaled
        if physical and self.full_scale_v is None:
            raise UsageError(
                f"channels={shown}: volts, amperes and an acceleration sensitivity need the "
                "input's full scale; give --input-full-scale-v V, the peak volts of a sample of 1.0"
            )
        if "current" in used and self.shunt_ohm is None:
            raise UsageError(
                f"channels={shown}: amperes need the resistance that the current's channel is "
                "across; give --shunt-ohm R"
            )

    @classmethod
    def parse(cls, text: str, **known: float | None) -> "Inputs":
        """Parse names like "acceleration,current,-". known: other fields; None keeps a default."""
        names = tuple(part.strip() for part in text.split(","))
        return cls(names, **{key: value for key, value in known.items() if value is not None})

    @property
    def acceleration_scaled(self) -> bool:
        """Whether acceleration is in m/s^2; otherwise it is relative to full scale."""
        return self.acceleration_v_per_m_s2 is not None

    def scale(self, name: str) -> float:
        """Return the value of a sample of 1.0 in m/s^2, A, or V at the coil; 1 if not scaled."""
        volts = self.full_scale_v or 1.0
        if name == "acceleration":
            return volts / self.acceleration_v_per_m_s2 if self.acceleration_v_per_m_s2 else 1.0
        if name == "current":
            assert self.shunt_ohm is not None
            return volts / self.shunt_ohm
        return volts * self.voltage_ratio if name == "voltage" else 1.0

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The pairs (reference, response) that these channels can measure."""
        driven = ("voltage" if "voltage" in self.names else DRIVE, "acceleration")
        known = {*self.names, DRIVE, PLAYED}
        possible = ("current", "acceleration"), ("voltage", "current"), driven, (PLAYED, "voltage")
        return tuple(pair for pair in possible if known.issuperset(pair))


MOST_CHANGE_PPM = 40.0  # largest change of drift between two sweeps; more means lost frames
MOST_TRIES = 3  # number of tries for each sweep; a busy machine loses some frames
_MIN_SIGNAL, _MAX_AFTER, _REST_S = 1.5, 0.1, 0.2

MAINS_HZ, HARMONICS = (50.0, 60.0), 8
MOST_HUM = 0.05  # largest hum relative to the sweep, r.m.s.; louder hum hides the marks
_CLEAR = 0.02  # least share of the silence's power that counts as hum; white noise has 0.1 %
_MOST = 0.3  # at a smaller share, the silence is mainly noise, and hum is not refused


class Transport(Protocol):
    """Two streams at one sample rate, one in each direction."""

    samplerate: int  # of both streams, Hz

    def run(self, exchange: Exchange) -> None:
        """Run the exchange, then close both streams. Raises an error if a stream cannot open."""


@dataclass(frozen=True)
class Devices:
    """The used devices, their delay, and the drift between their clocks."""

    output: str
    input: str
    delay_s: float
    drift_ppm: float


class LiveLaboratory:
    """A `Laboratory` of real devices, for one thread. amplifier: its response is divided out."""

    def __init__(
        self,
        transport: Transport,
        inputs: Inputs,
        output_channel: int = 0,
        amplifier: AmplifierParameters | None = None,
    ) -> None:
        self._transport, self._inputs = transport, inputs
        self._output_channel, self._amplifier = output_channel, amplifier
        self._drifts: list[two_clocks.Drift] = []
        self.drift: two_clocks.Drift | None = None  # between the two clocks, in the last sweep
        self.delay_s = 0.0  # from the playing of a frame to its recording, in the last sweep
        self.current_turned = False  # whether the current was negated: a coil absorbs power
        self.repeated = 0  # number of sweeps that were repeated after frames were lost

    def measure(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        """Return one recording for each pair (reference, response), scaled by `Inputs.scale`.

        "drive" is the loop-back if there is one, else the played signal with an unknown delay.
        """
        for _ in range(MOST_TRIES - 1):
            with suppress(BrokenStreamError, two_clocks.DropoutError):
                return self._measure_once(sweep, pairs)
            self.repeated += 1
        return self._measure_once(sweep, pairs)

    def _measure_once(self, sweep: Sweep, pairs: Sequence[tuple[str, str]]) -> list[Recording]:
        excitation, names = Excitation(sweep), self._inputs.names
        exchange = Exchange(excitation.samples, sweep.samplerate, names, self._output_channel)
        self._transport.run(exchange)
        channels = dict(zip(names, exchange.recorded.T.astype(np.float64), strict=True))
        channels.pop(UNUSED, None)
        if exchange.error is not None:
            if not exchange.played:  # the background was too loud: is it hum?
                for name, silence in channels.items():
                    _check_hum(silence, float(np.std(silence)), sweep.samplerate, name)
            raise exchange.error
        background = exchange.background_frames
        hum_hz = {name: self._check_signal(s, background, name) for name, s in channels.items()}
        # the channel in which the rig has the least effect on the playback
        clearest = next(name for name in reversed(QUANTITIES) if name in channels)
        after = channels[clearest][background:]
        two_clocks.check_latency(excitation, after, clearest)
        for name, samples in channels.items():
            self._check_end(samples, background, name)
        delay = two_clocks.find_delay(excitation, after, clearest)
        drift = two_clocks.find_drift(excitation, after, delay, clearest)
        for before in self._drifts:
            if abs(drift.value - before.value) > MOST_CHANGE_PPM + drift.reach + before.reach:
                raise two_clocks.DropoutError(
                    f"{clearest}: the clocks differ by {drift.value:+.0f} ppm, in an earlier sweep "
                    f"by {before.value:+.0f}: frames were lost or added; close other programs, and "
                    "sweep again"
                )
        self._drifts.append(drift)
        self.drift = drift
        self.delay_s = delay / sweep.samplerate
        first = background + delay + excitation.sweep_start * (1.0 + 1e-6 * drift.value)
        read = {
            name: self._inputs.scale(name)
            * two_clocks.resample_to_played(samples, first, drift.value, sweep.frames)
            for name, samples in channels.items()
        }
        if {"voltage", "current"} <= set(read):
            self.current_turned = float(np.mean(read["voltage"] * read["current"])) < 0.0
            if self.current_turned:
                read["current"] = -read["current"]
        read[PLAYED] = sweep.samples()
        read[DRIVE] = read.get("loopback", read[PLAYED])
        limits = {name: self._inputs.scale(name) for name in channels}
        recordings = []
        for reference, response in pairs:
            delayed = reference == PLAYED or (reference == DRIVE and "loopback" not in read)
            found = Recording(
                sweep,
                read[reference],
                read[response],
                (reference, response),
                (limits.get(reference, math.inf), limits.get(response, math.inf)),
                hum_hz=max(hum_hz.get(name, 0.0) for name in (reference, response)),
                delayed=delayed,
                polarity_known=response != "acceleration",
                drift_reach=1e-6 * drift.reach if delayed else 0.0,
            )
            if reference in (DRIVE, PLAYED) and self._amplifier is not None:
                found = through_amplifier(found, self._amplifier)
            recordings.append(found)
        return recordings

    def _check_signal(self, samples: FloatArray, background: int, name: str) -> float:
        """Return the frequency of hum in Hz, or 0. IdentificationError: no signal, or loud hum."""
        noise, whole = (float(np.std(s)) for s in (samples[:background], samples[background:]))
        hum_hz = _check_hum(samples[:background], whole, self._transport.samplerate, name)
        if whole <= _MIN_SIGNAL * noise or whole == 0.0:
            raise IdentificationError(
                f"{name}: no signal, {whole:.3g} r.m.s. of full scale during the sweep and "
                f"{noise:.3g} before it; check power, volume, cables and that channel, or raise "
                "the level"
            )
        return hum_hz

    def _check_end(self, samples: FloatArray, background: int, name: str) -> None:
        noise, whole = (float(np.std(s)) for s in (samples[:background], samples[background:]))
        after = float(np.std(samples[-round(_REST_S * self._transport.samplerate) :]))
        if after > max(3.0 * noise, _MAX_AFTER * whole):
            raise IdentificationError(
                f"{name}: {after:.3g} r.m.s. of full scale after the sweep, {noise:.3g} before it: "
                "something else began to play or to move the cushion; stop it, and sweep again"
            )


def _check_hum(silence: FloatArray, loud: float, samplerate: float, name: str) -> float:
    """Return the frequency, Hz, of mains hum in silence, (frames,); 0 if there is no hum.

    loud: r.m.s. during the sweep. IdentificationError: the hum is too large relative to `loud`.
    """
    time_s = np.arange(len(silence)) / samplerate
    still = silence - silence.mean()
    rms, hz = 0.0, 0.0
    for mains_hz in MAINS_HZ:
        turns = math.tau * mains_hz * np.outer(time_s, np.arange(1, HARMONICS + 1))
        waves = np.concatenate([np.cos(turns), np.sin(turns)], axis=1)
        hum = waves @ np.linalg.lstsq(waves, still)[0]
        rms, hz = max((rms, hz), (float(np.sqrt(np.mean(hum**2))), mains_hz))
    share = rms**2 / max(float(np.mean(still**2)), 1e-300)
    if share > _MOST and rms > MOST_HUM * loud:
        raise IdentificationError(
            f"{name}: mains hum of {hz:g} Hz, {rms:.3g} r.m.s. of full scale, is "
            f"{100 * rms / loud:.2g} % of the signal, at most {100 * MOST_HUM:g} % is allowed; "
            "break the ground loop (a balanced input, a transformer, one socket for all), move "
            "cables away from power supplies, or raise the level"
        )
    return hz if share > _CLEAR else 0.0
