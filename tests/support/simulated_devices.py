"""An output and an input with a simulated rig in between, block by block, without a clock."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from device.rig import Rig
from device.rig.actuator import LinearActuator
from device.rig.electronics import Amplifier, Dac
from tests.support.eddy_coils import EddyActuator

BLOCK = 256
RATE = 48_000
AFTER = 20
"""Blocks that are asked for once it has ended: an output goes on until it is closed."""


@dataclass
class SimulatedDevices:
    """A `Transport`. Every run begins at rest.

    delay_s: from played to recorded; drift_ppm: by how much the input's clock is faster; noise:
    r.m.s. of full scale; change(name, samples, first): what becomes of a block; lost: {frame: how
    many are missing there}, in one run or, if it loses_always, in each; on_block(exchange, number):
    called before each; stands_still: from this block on no input comes. played: (frames, 2) of the
    last run, with some blocks after its end at frame ended_at; levels: the peak of each run.
    """

    rig: Rig
    inputs: Any
    delay_s: float = 0.0634
    drift_ppm: float = 0.0
    noise: float = 1e-5
    gains: dict[str, float] = field(default_factory=dict)
    change: Callable[..., Any] = lambda name, samples, first: samples
    lost: dict[int, int] = field(default_factory=dict)
    on_block: Callable[..., object] = lambda exchange, number: None
    stands_still: int | None = None
    loses_always: bool = False
    samplerate = RATE
    runs = ended_at = 0

    def __post_init__(self):
        self.played, self.levels = np.zeros(0), []

    def run(self, exchange):
        self.runs += 1
        random, rig = np.random.default_rng(self.runs), self.rig
        dac, amplifier = Dac(rig.dac), Amplifier(rig.amplifier, RATE)
        source = rig.amplifier.source_impedance_ohm
        kind = EddyActuator if rig.actuator.inductance_eddy_h else LinearActuator
        actuator = kind(rig.actuator, RATE, source)
        names, rate = self.inputs.names, 1.0 + 1e-6 * self.drift_ppm
        names_of_all = ("acceleration", "current", "voltage", "loopback")
        history = {name: np.zeros(20 * RATE) for name in names_of_all}
        lost = dict(self.lost) if self.loses_always else self.lost
        played, rows, number, adc, skipped, after = [], 0, 0, 0, 0, AFTER
        exchange.begin()
        while after:
            if exchange.ended.is_set():
                after -= 1
            else:
                self.ended_at = rows + BLOCK
            now_s = number * BLOCK / RATE
            self.on_block(exchange, number)
            out = np.zeros((BLOCK, 2), np.float32)
            exchange.fill(out, now_s)
            played.append(out.copy())
            drive = amplifier.drive(dac.volts(out[:, 0]))
            motion = actuator.move(drive, ("acceleration_m_s2", "current_a"))
            new = {
                "acceleration": motion.acceleration_m_s2,
                "current": motion.current_a,
                "voltage": drive - source * motion.current_a,
                "loopback": out[:, 0].astype(float),
            }
            for name, samples in new.items():
                history[name][rows : rows + BLOCK] = samples
            rows += BLOCK
            number += 1
            j = np.arange(adc + skipped, max(adc + skipped, int((rows - 4) * rate)))
            adc += len(j)
            for frame in [frame for frame in lost if frame <= adc]:
                skipped += lost.pop(frame)
            if self.stands_still is not None and number >= self.stands_still:
                continue
            frames = random.standard_normal((len(j), len(names))) * self.noise
            t = (j - self.delay_s * RATE) / rate
            for column, name in enumerate(names):
                if name == "-":
                    continue
                shown = _cubic(history[name][:rows], t) * self.gains.get(name, 1.0)
                shown = self.change(name, shown, adc - len(j))
                frames[:, column] += shown / self.inputs.scale(name)
            exchange.on_frames(frames.astype(np.float32), now_s)
        self.played = np.concatenate(played)
        self.levels.append(float(np.abs(self.played).max()))


def _cubic(samples, t):
    """Samples at fractional frames, 0 before the first."""
    whole = np.floor(t).astype(int)
    x, at = t - whole, np.clip(whole, 1, len(samples) - 3)
    a, b, c, d = samples[at - 1], samples[at], samples[at + 1], samples[at + 2]
    shown = (
        -a * x * (x - 1) * (x - 2) / 6
        + b * (x + 1) * (x - 1) * (x - 2) / 2
        - c * (x + 1) * x * (x - 2) / 2
        + d * (x + 1) * x * (x - 1) / 6
    )
    return np.where(whole < 1, 0.0, shown)
