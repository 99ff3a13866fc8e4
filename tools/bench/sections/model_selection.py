"""Sections on the linear and the non-linear model of the rig, and on selection between them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.signal import butter, sosfilt

from audioflinger_hook.transform import FloatArray, HapticTransform
from device.rig import PAPER, Rig
from device.rig.actuator import Motion
from device.rig.adaptive_actuator import FLOOR, AdaptiveActuator, BlockReport
from device.rig.parameters import ActuatorParameters
from tools.bench.cost import Timings, in_ffts, interleaved
from tools.bench.measures.solved_motion import solved_motion
from tools.bench.report import Must, Row, Section
from tools.bench.sounds.signals import SAMPLERATE
from tools.bench.sounds.speech_sounds import repeated, scene_track
from tools.bench.workbench import Workbench

TOLERANCES = LOOSE, *_ = (1e-2, 1e-3, 1e-4)
WITHIN, OWN_COST, QUIET_COST = Must("<=", 1.0), Must("<=", 1.1), Must("<=", 0.15)
SECOND_MS = Must("<=", 10.0)
ERROR = Must("<=", 1e-4)
FULL_V = PAPER.dac.full_scale_v * PAPER.amplifier.gain
QUIET_DB = -30.0
BURST_S = 0.25
STOP_V = 60.0
FADED_ABOVE_HZ = 800.0
SOLVED_S = 0.1
REPEATS = 5
ALL_NONLINEAR = "all Runge-Kutta"


def model_selection(bench: Workbench) -> Section:
    """Measure CPU time and error of the automatic selection of a model, at several tolerances."""
    duration_s = bench.effort.rig_timed_s
    rows = []
    for name, volts in scenes(duration_s).items():
        true = AdaptiveActuator(PAPER, SAMPLERATE, model="nonlinear", refine=2).move(volts)
        whole = AdaptiveActuator(PAPER, SAMPLERATE, model="nonlinear")
        choosing = [AdaptiveActuator(PAPER, SAMPLERATE, tolerance) for tolerance in TOLERANCES]
        works = [partial(_afresh, each, volts) for each in (whole, *choosing)]
        whole_timing, *timings = interleaved(works, REPEATS)
        rows += _cost_rows(name, whole_timing, duration_s)
        rows.append(
            Row(name, float(errors_of(whole, volts, true).max()), "", f"{ALL_NONLINEAR}, error")
        )
        for actuator, timing in zip(choosing, timings, strict=True):
            column = f"{actuator.tolerance:g}"
            worst = float(errors_of(actuator, volts, true).max()) / actuator.tolerance
            share = 100.0 * actuator.frames_by_model["linear"] / len(volts)
            cost = _times(timing, whole_timing)
            must = QUIET_COST if name.startswith("quiet") else OWN_COST
            rows += [
                Row(name, cost, "times", f"{column}, cost", must),
                Row(name, worst, "", f"{column}, worst block of it", WITHIN),
                Row(name, share, "%", f"{column}, linear"),
            ]
    clicks = [Row("clicks of a change", _clicks_db(t), "dB", f"{t:g}, cost") for t in TOLERANCES]
    return Section(
        "Model selection",
        'For each block, `model = "auto"` selects the linear model if the estimated error of this '
        "model is within the tolerance. Otherwise, the non-linear model (Runge-Kutta) is selected. "
        "The drive signals are the vibration of sounds of the demo scene, and tone bursts up to "
        f"full scale, {duration_s:g} s each. One more drive signal, *the stop*, is a tone with an "
        f"amplitude of {STOP_V:g} V, and moves the rig `paper` to its end stops. For each "
        "tolerance, the table shows the CPU time relative to Runge-Kutta for all blocks. It also "
        "shows the largest error of a block divided by the tolerance, and the share of frames that "
        "the linear model computed. The error of a block is the largest difference of excursion or "
        "acceleration from the result of Runge-Kutta with a quarter of the step. The error is "
        f"relative to the peak of the block, or to the value at {FLOOR:g} Xmax if this is larger; "
        f"Xmax is the excursion limit. Costs are medians of {REPEATS} repeats.",
        (*rows, *clicks),
        footnote=f"The quiet drive signals are the same signals with a gain of {QUIET_DB:g} dB. "
        f"The row *clicks of a change* shows the peak of the acceleration above {FADED_ABOVE_HZ:g} "
        "Hz, relative to the peak of the whole acceleration. The drive signal of this row consists "
        "of two tones whose level varies, so that the selected model changes.",
    )


def _cost_rows(name: str, timing: Timings, duration_s: float) -> list[Row]:
    ffts = f"{ALL_NONLINEAR}, FFTs"
    limit = Must("<=", in_ffts(1e-3 * SECOND_MS.bound))
    middle_ms = 1e3 * timing.median_s / duration_s
    return [
        Row(name, middle_ms, "ms", f"{ALL_NONLINEAR}, a second", SECOND_MS, ffts_column=ffts),
        Row(name, round(timing.median_units / duration_s), "FFTs", ffts, limit),
    ]


def hard_cases(bench: Workbench) -> Section:
    """Measure errors of Runge-Kutta and of the selected models relative to SciPy's `solve_ivp`."""
    rows = []
    for name, (rig, volts) in hard_drives(min(SOLVED_S, bench.effort.rig_timed_s)).items():
        true = solved_motion(rig, SAMPLERATE, volts)
        for column, actuator in (
            ("Runge-Kutta", AdaptiveActuator(rig, SAMPLERATE, model="nonlinear")),
            (f"auto at {LOOSE:g}", AdaptiveActuator(rig, SAMPLERATE, LOOSE)),
        ):
            motion = actuator.move(volts)
            must = ERROR if column == "Runge-Kutta" else Must("<=", actuator.tolerance)
            for quantity, row, got in (
                ("excursion", 0, motion.displacement_m),
                ("acceleration", 3, motion.acceleration_m_s2),
            ):
                error = float(np.abs(got - true[row]).max() / np.abs(true[row]).max())
                rows.append(Row(name, error, "", f"{quantity}, {column}", must))
    return Section(
        "Hard cases",
        "The equations of the rig are hard to solve for these drive signals, which last "
        f"{SOLVED_S:g} s. The table shows the largest errors of excursion and acceleration, each "
        "relative to its peak. The reference is `solve_ivp` with a tolerance of 1e-12 (Radau with "
        "1e-10 for stiff circuits). Hard stops are stiffer than the end stops of the rig `paper`.",
        tuple(rows),
    )


def scenes(duration_s: float) -> dict[str, FloatArray]:
    """Return drive voltages for the rig `paper`, (frames,), by name."""
    played = {
        name: FULL_V * repeated(vibration(track), duration_s)
        for name, track in (("speech", "speech"), ("music", "chord"), ("explosions", "explosion"))
    }
    quiet = 10.0 ** (QUIET_DB / 20.0)
    times = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    return {
        **{f"quiet {name}": quiet * volts for name, volts in played.items()},
        **played,
        "full-scale bursts": bursts(duration_s),
        "the stop": STOP_V * np.sin(math.tau * 80.0 * times),
    }


def vibration(track: str) -> FloatArray:
    """Return the vibration of one track of the demo scene, (frames,), with full scale ±1."""
    transform = HapticTransform(SAMPLERATE, 1, form="live")
    sound = scene_track(track)[:, None]
    return np.concatenate([transform.process(sound), transform.finish()])[:, 0].astype(np.float64)


def hard_drives(duration_s: float) -> dict[str, tuple[Rig, FloatArray]]:
    """Return rigs and drive voltages, (frames,), that are hard to simulate, by name."""
    times = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    tone, large = np.sin(math.tau * 80.0 * times), PAPER.large_signal
    at_92_hz = np.sin(math.tau * 92.0 * times)
    steps = np.where(times < 0.5 * duration_s, FULL_V, -FULL_V) * (times > 0.05 * duration_s)
    hard = replace(PAPER, large_signal=large and replace(large, stop_n_per_m2=1e12))
    small = replace(PAPER, actuator=replace(PAPER.actuator, inductance_h=1e-6))
    source = replace(PAPER.amplifier, source_impedance_ohm=3_300.0, drive_mode="current")
    noise = np.random.default_rng(7).standard_normal(times.size)
    return {
        "steps of full scale": (PAPER, steps),
        "a sudden end": (PAPER, FULL_V * at_92_hz * (times < 0.5 * duration_s)),
        "+6 dB at 92 Hz": (PAPER, 2.0 * FULL_V * at_92_hz),
        "full-scale square": (PAPER, FULL_V * np.sign(np.sin(math.tau * 30.0 * times + 1e-9))),
        "squares of 15 V": (PAPER, 15.0 * np.sign(np.sin(math.tau * 90.0 * times + 1e-9))),
        "white noise of 20 V": (PAPER, 20.0 * noise),
        f"into the stops, {STOP_V:g} V": (PAPER, STOP_V * tone),
        "hard stops, 100 V": (hard, 100.0 * tone),
        "inductance of 1 uH": (small, 8.0 * tone),
        "current drive, 3300 ohm": (replace(PAPER, amplifier=source), 5_000.0 * tone),
    }


def bursts(duration_s: float) -> FloatArray:
    """Return a drive voltage, (frames,): tone bursts of random level and frequency, with pauses."""
    random = np.random.default_rng(11)
    times = np.arange(round(BURST_S * SAMPLERATE)) / SAMPLERATE
    edge = np.minimum(1.0, np.minimum(times, times[::-1]) / 0.005)
    parts = []
    for _ in range(math.ceil(duration_s / BURST_S)):
        level_v = FULL_V * 10.0 ** random.uniform(-1.0, 0.0) * (random.random() > 0.25)
        frequency_hz = 20.0 * 11.0 ** random.random()
        parts.append(level_v * edge * np.sin(math.tau * frequency_hz * times))
    return np.concatenate(parts)[: round(duration_s * SAMPLERATE)]


def _times(one: Timings, other: Timings) -> float:
    return float(np.median(np.array(one.seconds) / np.array(other.seconds)))


def _afresh(actuator: AdaptiveActuator, volts: FloatArray) -> None:
    actuator.reset()
    actuator.move(volts)


def errors_of(actuator: AdaptiveActuator, volts: FloatArray, true: Motion) -> FloatArray:
    """Simulate the motion from rest, and return the error of each block, (blocks,).

    volts: drive voltage.
    true: the true motion.
    """
    actuator.reset()
    motion = actuator.move(volts)
    return block_errors(actuator.reports, motion, true, actuator.rig.actuator)


def block_errors(
    blocks: Sequence[BlockReport], motion: Motion, true: Motion, actuator: ActuatorParameters
) -> FloatArray:
    """Return the larger of the errors of excursion and acceleration in each block, (blocks,).

    An error is the largest difference from the true motion, divided by the true peak in the block.
    The divisor is at least 1 % of the excursion limit Xmax, or the acceleration of such an
    excursion at the resonance frequency.
    """
    floor_m = FLOOR * actuator.x_max_m
    floors = {"displacement_m": floor_m, "acceleration_m_s2": floor_m * actuator.resonance_rad_s**2}
    errors = np.zeros(len(blocks))
    for index, block in enumerate(blocks):
        part = slice(block.frame, block.frame + block.frames)
        for name, floor in floors.items():
            expected: FloatArray = getattr(true, name)[part]
            error = float(np.abs(getattr(motion, name)[part] - expected).max(initial=0.0))
            peak = max(float(np.abs(expected).max(initial=0.0)), floor)
            errors[index] = max(errors[index], error / peak)
    return errors


def _clicks_db(tolerance: float) -> float:
    times = np.arange(round(1.6 * SAMPLERATE)) / SAMPLERATE
    envelope = 0.4 + 3.0 * np.sin(math.pi * times / 1.6) ** 2
    volts = envelope * (np.sin(math.tau * 46.6 * times) + np.sin(math.tau * 92.0 * times))
    motion = AdaptiveActuator(PAPER, SAMPLERATE, tolerance).move(volts).acceleration_m_s2
    high = butter(8, FADED_ABOVE_HZ, "high", fs=SAMPLERATE, output="sos")
    left = sosfilt(high, motion)[2_000:-2_000]
    return 20.0 * math.log10(float(np.abs(left).max() / np.abs(motion).max()))
