"""Drives by number, and what a rig that is a tenth off does under them.

Tones, bursts, sweeps, noise, music-like chords and steps, up to three times full scale.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import butter, sosfilt

from device.drive.exposure import ACTION_A8_M_S2, ACTION_VDV, DAY_S, DoseSums, Exposure
from device.drive.safety import SafetyState
from device.rig import CONSUMER, PAPER, Rig
from device.rig.actuator import LinearActuator
from device.rig.electronics import Amplifier, Dac
from device.rig.parameters import ThermalParameters, vary
from device.rig.thermal import Temperatures
from device.units import Float32Array, FloatArray
from tools.rig_driver import RigDriver

RATE, SECONDS, CHANNELS = 6_000, 1.5, 40
KINDS = ("tone", "bursts", "sweep", "noise", "music", "steps")
OFF = 0.1
"""Share by which mass, Bl and, through the spring, f0 may each differ."""
HEAT_S = 0.002
"""Step of the temperature: the current's mean square over it counts."""


def behind(
    rig: Rig, volts: float, thermal: ThermalParameters | None = None, headroom: float = 4.0
) -> Rig:
    """Return a rig whose amplifier gives so many volts at full scale and clips at `headroom`."""
    amplifier = replace(rig.amplifier, gain=volts, output_limit_v=headroom * volts)
    return replace(rig, amplifier=amplifier, thermal=thermal or rig.thermal)


RIGS = (
    behind(PAPER, 20.0),
    behind(PAPER, 40.0),
    behind(PAPER, 30.0, ThermalParameters(4.0, 0.4, 3.0, 400.0)),
    behind(CONSUMER, 30.0),
    behind(CONSUMER, 80.0, ThermalParameters(6.0, 0.2, 5.0, 200.0)),
    behind(PAPER, 40.0, headroom=0.75),
)
"""Rigs that can be driven beyond their limits; two have coils that are hot within a second, and the
amplifier of one clips below full scale."""


@dataclass(frozen=True)
class Case:
    """A drive, (frames,), the rig that is protected, the true one, and how its coil and day are."""

    name: str
    drive: FloatArray
    rig: Rig
    true: Rig
    begins: SafetyState


def case(seed: int, samplerate: int = RATE, *, used: bool = False) -> Case:
    """Return the case of a number at a rate; used: half of the day's action value or more is."""
    rng = np.random.default_rng(seed)
    rig, kind = RIGS[seed % len(RIGS)], KINDS[seed // len(RIGS) % len(KINDS)]
    signs = rng.choice([-OFF, OFF], 3)
    if rng.random() < 0.5:
        signs *= rng.random(3)
    mass, f0, force_factor = 1.0 + signs
    true = replace(rig, actuator=vary(rig.actuator, mass, f0**2, force_factor))
    assert rig.thermal
    coil_c = rng.uniform(rig.thermal.ambient_c, 119.0)
    a8, vdv = 1.0 - 0.5 * 10.0 ** rng.uniform(-3.0, 0.0, 2) if used else (0.0, 0.0)
    dose = DoseSums(0.0, a8 * ACTION_A8_M_S2**2 * DAY_S, vdv * ACTION_VDV**4)
    begins = SafetyState(coil_c, rng.uniform(rig.thermal.ambient_c, coil_c), dose)
    drive = _drive(rng, kind, rig.actuator.resonance_hz, samplerate)
    return Case(f"{seed}: {kind}", drive, rig, true, begins)


def _drive(rng: np.random.Generator, kind: str, f0: float, samplerate: int) -> FloatArray:
    at_s = np.arange(round(SECONDS * samplerate)) / samplerate
    hz, level = f0 * 10.0 ** rng.uniform(-0.5, 0.5), 3.0 * 10.0 ** rng.uniform(-1.0, 0.0)
    turns = math.tau * (hz * at_s + rng.random())
    if kind == "tone":
        wave = np.sin(turns) if rng.random() < 0.5 else np.sign(np.sin(turns))
    elif kind == "bursts":
        wave = np.sin(turns) * (at_s % rng.uniform(0.05, 0.5) < rng.uniform(0.02, 0.25))
    elif kind == "sweep":
        first_hz, last_hz = f0 * 10.0 ** rng.uniform(-0.6, 0.6, 2)
        wave = np.sin(math.tau / samplerate * np.cumsum(np.geomspace(first_hz, last_hz, len(at_s))))
    elif kind == "noise":
        band_hz = f0 * 10.0 ** np.array([rng.uniform(-1.0, -0.1), rng.uniform(0.1, 1.0)])
        sections = butter(2, band_hz, "band", fs=samplerate, output="sos")
        wave = sosfilt(sections, rng.standard_normal(len(at_s)))
        wave = wave / np.abs(wave).max()
    elif kind == "music":
        notes_hz, beats_hz = rng.uniform(20.0, 220.0, 5), rng.uniform(1.0, 8.0, 5)
        beats = np.sin(math.tau * np.outer(beats_hz, at_s)) > 0.2
        wave = 0.4 * (np.sin(math.tau * np.outer(notes_hz, at_s)) * beats).sum(axis=0)
    else:
        lengths = rng.integers(1, samplerate // 20, len(at_s))
        wave = np.repeat(rng.uniform(-1.0, 1.0, len(at_s)), lengths)[: len(at_s)]
    return np.asarray(level * wave)


@dataclass(frozen=True)
class Reached:
    """The true rig's largest values as shares of Xmax and of the amplifier's limit, its warmest
    coil; limited and infeasible blocks, what the cap allows at the end, and the day's dose."""

    name: str
    excursion: float
    current: float
    coil_c: float
    limited: int
    infeasible: int
    gain: float
    dose: Exposure


def reached(seeds: Sequence[int], cap: str = "off", samplerate: int = RATE) -> list[Reached]:
    """Return what becomes of many cases; with a cap, most of the day's action value is used up."""
    found: list[Reached] = []
    for which in range(len(RIGS)):
        own = [seed for seed in seeds if seed % len(RIGS) == which]
        for first in range(0, len(own), CHANNELS):
            several = own[first : first + CHANNELS]
            cases = [case(seed, samplerate, used=cap != "off") for seed in several]
            found += driven(cases, samplerate, cap)
    return found


def driven(cases: Sequence[Case], samplerate: int, cap: str) -> list[Reached]:
    """Return what becomes of cases of one protected rig, side by side in one core."""
    driver = RigDriver(cases[0].rig, samplerate, len(cases), exposure_cap=cap)
    driver.restore([one.begins for one in cases])
    tail = np.zeros((driver.latency_frames + samplerate // 10, len(cases)))
    out = driver.process(np.concatenate([np.stack([one.drive for one in cases], 1), tail]))
    readings, states = driver.core.readings.actuators, driver.safety_states()
    return [
        Reached(
            one.name,
            *_moved(one, column, samplerate),
            said.limited_blocks,
            said.infeasible_blocks,
            said.exposure_gain,
            Exposure.of([state.dose]),
        )
        for one, column, said, state in zip(cases, out.T, readings, states, strict=False)
    ]


def _moved(one: Case, out: Float32Array, samplerate: int) -> tuple[float, float, float]:
    """Return what the simulated rig reaches, from its DAC on."""
    true = one.true
    dac, amplifier = Dac(true.dac), Amplifier(true.amplifier, samplerate)
    volts = amplifier.drive(dac.volts(out))
    assert dac.clipped_samples == 0
    actuator = LinearActuator(true.actuator, samplerate, true.amplifier.source_impedance_ohm)
    motion = actuator.move(volts, ("displacement_m", "current_a"))
    return (
        float(np.abs(motion.displacement_m).max()) / true.actuator.x_max_m,
        float(np.abs(motion.current_a).max()) / true.amplifier.current_limit_a,
        _warmest_c(one, motion.current_a, samplerate),
    )


def _warmest_c(one: Case, current_a: FloatArray, samplerate: int) -> float:
    """Return the largest temperature of a coil with the resistance of warm copper."""
    thermal, begins, frames = one.true.thermal, one.begins, round(HEAT_S * samplerate)
    assert thermal
    assert begins.coil_c is not None
    assert begins.magnet_c is not None
    warm, largest_k = Temperatures(thermal), 0.0
    warm.coil_k, warm.magnet_k = (at - thermal.ambient_c for at in (begins.coil_c, begins.magnet_c))
    whole = current_a[: len(current_a) // frames * frames].reshape(-1, frames)
    for square in np.mean(whole**2, axis=1).tolist():
        warm.heat(square * warm.resistance_ohm(one.true.actuator.resistance_ohm), HEAT_S)
        largest_k = max(largest_k, warm.coil_k)
    return thermal.ambient_c + largest_k
