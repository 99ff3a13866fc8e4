"""Bench on the frontier: what each setting of the live form costs, and what error it leaves.

One setting is changed at a time, from outside, so that the transform carries no switches: the
kernel takes all of its numbers from a `LiveTransform`, whose own come from `TransformParameters`
and from the constants of `grid` and `smoothing`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import ModuleType
from typing import Literal

import numpy as np
from scipy.fft import next_fast_len
from scipy.signal import hilbert

from audioflinger_hook.bench.cost import interleaved
from audioflinger_hook.bench.fidelity import (
    BURST_AMPLITUDE,
    BURST_HZ,
    BURST_ONSET_S,
    REST_S,
)
from audioflinger_hook.bench.measures import energy_above_db, onset_lag_s, sine_fit
from audioflinger_hook.bench.report import Row, Section, number
from audioflinger_hook.bench.signals import SAMPLERATE, Stereo, burst, tone
from audioflinger_hook.bench.workbench import Playback, Subject, Workbench
from audioflinger_hook.clients import mixdown
from audioflinger_hook.scenes import demo_scene
from audioflinger_hook.transform import TransformParameters, grid, kernel_warning, smoothing
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.haptic import Stream
from audioflinger_hook.transform.kernel import KernelStream
from audioflinger_hook.transform.live import LiveTransform
from audioflinger_hook.transform.principal import PrincipalFinder
from audioflinger_hook.transform.scaling import vibration_hz
from audioflinger_hook.transform.spectrum import Spectrum, magnitude
from audioflinger_hook.transform.voices import VoiceStream

TITLE = "Cost against error"
BLOCKSIZE = 256
DEFAULT = "as it is"
SCENE_FROM_S, SCENE_S = 6.9, 2.0
"""Of the demo scene: footsteps, then speech."""
TONES_HZ, TONE_S, AMPLITUDE = (60.0, 10_000.0), 1.0, 0.3
CHIRP_FROM_HZ, CHIRP_OCTAVES_A_S, CHIRP_S = 200.0, 2.0, 1.5
CHIRP_SETTLED_S = 0.4
SWELL_HZ, SWELL_DEPTH = 4.0, 0.5
NOTES, HARMONICS, NOTE_HZ, NOTE_DECAY_S = 24, 12, (98.0, 660.0), 0.3
NOTE_REACH_HZ = 10.8
"""Half of 1/T: a partial found so near to its place is found."""

COST, TONE_ERROR, TONE_LEVEL, CHIRP = "cost", "tones", "tones, level", "chirp"
SWELL, PURITY, LAG, LEAK = "AM, level", "THD+N", "lag, p95", "over 250 Hz"
MISSED, SPURIOUS = "missed", "spurious"
UNLIKE = "not the reference's"
UNITS = {
    COST: "ms", TONE_ERROR: "Hz", TONE_LEVEL: "dB", CHIRP: "Hz", SWELL: "dB", PURITY: "dB",
    LAG: "ms", LEAK: "dB", MISSED: "%", SPURIOUS: "%", UNLIKE: "%",
}  # fmt: skip
"""What is measured of a setting; of each less is better."""
BLUR = {
    COST: 0.1, TONE_ERROR: 1e-3, TONE_LEVEL: 0.01, CHIRP: 0.1, SWELL: 0.02, PURITY: 1.0,
    LAG: 0.7, LEAK: 0.7, MISSED: 0.3, SPURIOUS: 0.3, UNLIKE: 0.3,
}  # fmt: skip
"""Differences under this, of cost as a share, are none: they are within the spread of repeats."""


NOT_COMPARED = {COST: "not compiled", UNLIKE: "other units"}
KERNEL_PADDING = 2.0
"""The kernel takes no NFFT under two windows; such a setting is tried in NumPy."""


@dataclass(frozen=True)
class Setting:
    """One change of the live form: its knob, its name in the table, and what is changed.

    parameters: of `TransformParameters`; constants: of `grid` and `smoothing`; padding: NFFT over
    the window's length.
    """

    knob: str
    name: str
    parameters: Mapping[str, float | int] = field(default_factory=dict)
    constants: Mapping[str, float | int] = field(default_factory=dict)
    padding: float = 2.0


def _hop(hops_a_window: float) -> Setting:
    hop_ms = 1e3 * TransformParameters().window_s / hops_a_window
    return Setting("hop", f"hop {hop_ms:.0f} ms", constants={"HOPS_A_WINDOW": hops_a_window})


def _filter(order: int, ripple_db: float, stop_db: float) -> Setting:
    constants = {"ORDER": order, "RIPPLE_DB": ripple_db, "STOP_DB": stop_db}
    name = f"low-pass of order {order}, {ripple_db:g} dB, {stop_db:g} dB"
    return Setting("low-pass", name, constants=constants)


SETTINGS: tuple[Setting, ...] = (
    Setting("", DEFAULT),
    *(_hop(hops_a_window) for hops_a_window in (1.0, 1.9, 4.0, 5.5, 11.0)),
    *(Setting("NFFT", f"NFFT {times:g} windows", padding=times) for times in (1.0, 3.0, 4.0)),
    *(
        Setting("window", f"window {1e3 * window_s:.0f} ms", {"window_s": window_s})
        for window_s in (0.0232, 0.0929)
    ),
    *(Setting("partials", f"{n} partials", {"partials_max": n}) for n in (4, 8, 32)),
    *(
        Setting("rate", f"oscillators at {rate_hz / 1e3:g} kHz", constants={"LOW_RATE_HZ": rate_hz})
        for rate_hz in (1_500.0, 6_000.0, 12_000.0)
    ),
    _filter(5, 1.0, 35.0),
    _filter(5, 2.0, 38.0),
)


class _Setup:
    """The live form with one setting, compiled where the kernel is there."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting

        class Padded(TransformParameters):
            def fft_length(self, samplerate: int) -> int:
                wanted = round(setting.padding * self.window_frames(samplerate))
                return int(next_fast_len(wanted, real=True))

        window_s = setting.parameters.get("window_s", TransformParameters().window_s)
        partials_max = setting.parameters.get("partials_max", TransformParameters().partials_max)
        self.parameters = Padded(window_s=window_s, partials_max=int(partials_max))
        self.compiled = kernel_warning() is None and setting.padding >= KERNEL_PADDING
        self.made = self.form()  # what the kernel takes its numbers from; never played itself
        self.latency_frames = self.made.latency_frames
        self.subject = Subject(setting.name, lambda _samplerate, channels: self._stream(channels))

    def form(self) -> LiveTransform:
        """Return one channel in NumPy."""
        with _constants(self.setting.constants):
            return LiveTransform(self.parameters, SAMPLERATE)

    def _stream(self, channels: int) -> Stream:
        if self.compiled:
            return KernelStream(self.made, channels, each=False)
        return VoiceStream([self.form()], channels)

    def vibration(self, sound: FloatArray | Stereo) -> FloatArray:
        """Return the vibration of a sound, (frames,)."""
        return self.subject.vibration(sound, SAMPLERATE)


@contextmanager
def _constants(changed: Mapping[str, float | int]) -> Iterator[None]:
    """Change constants of `grid` and `smoothing` for as long as a transform is being made."""
    kept: list[tuple[ModuleType, str, float | int]] = []
    try:
        for name, value in changed.items():
            (home,) = (module for module in (grid, smoothing) if hasattr(module, name))
            kept.append((home, name, getattr(home, name)))
            setattr(home, name, value)
        yield
    finally:
        for home, name, before in kept:
            setattr(home, name, before)


def frontier(bench: Workbench) -> Section:
    """Cost and errors of the live form, one setting changed at a time, and who dominates whom."""
    setups = [_Setup(setting) for setting in SETTINGS]
    first = round(SCENE_FROM_S * SAMPLERATE)
    scene = mixdown(demo_scene())[first : first + round(SCENE_S * SAMPLERATE)]
    costs_ms = _costs_ms(setups, scene, bench.effort.cost_repeats)
    count = bench.effort.frontier_sounds
    measured = {
        setup.setting.name: {COST: cost_ms, **_errors(setup, scene, count)}
        for setup, cost_ms in zip(setups, costs_ms, strict=True)
    }
    rows = [
        Row(name, value, UNITS[column], f"{column}, {UNITS[column]}",
            note="" if value is not None else NOT_COMPARED[column])
        for name, values in measured.items()
        for column, value in values.items()
    ]  # fmt: skip
    return Section(
        TITLE,
        f"The live form ({'compiled' if kernel_warning() is None else 'in NumPy'}) with one "
        "setting changed at a time. Cost of a second of stereo of the demo scene; then errors "
        "against what is known: root mean square over steady tones "
        f"({TONES_HZ[0]:g} to {TONES_HZ[1]:g} Hz) in Hz of vibration and dB, and their worst "
        f"THD+N; a chirp of {CHIRP_OCTAVES_A_S:g} octaves a second; a level that swells at "
        f"{SWELL_HZ:g} Hz; onset lag of bursts; energy over 250 Hz of the scene; partials missed "
        f"and spurious on {NOTES} decaying notes of {HARMONICS} harmonics; and principal "
        "frequencies of the scene that only one of this and the reference form finds. "
        "Interpolation and precision (64 bit) are no settings of the live form.",
        tuple(rows),
        footnote=_verdict(measured),
    )  # fmt: skip


def _plain(value: float | None) -> float:
    return float("nan") if value is None else value


def _costs_ms(setups: list[_Setup], scene: Stereo, repeats: int) -> list[float | None]:
    """Return the cost of each setting; None where it runs by other means than the default."""
    timed = [setup for setup in setups if setup.compiled == setups[0].compiled]
    playbacks = [Playback(setup.subject, scene, BLOCKSIZE) for setup in timed]
    timings = interleaved(
        [each.play for each in playbacks], repeats, [each.open for each in playbacks]
    )
    costs = {
        setup.setting.name: 1e3 * timing.median_s / SCENE_S
        for setup, timing in zip(timed, timings, strict=True)
    }
    return [costs.get(setup.setting.name) for setup in setups]


def _errors(setup: _Setup, scene: Stereo, count: int) -> dict[str, float | None]:
    """Return every error of a setting by its column; None where it cannot be compared."""
    tone_hz, tone_db, purity_db = _tone_errors(setup, count)
    missed, spurious = _notes(setup)
    rest = np.zeros((round(REST_S * SAMPLERATE), 2), scene.dtype)
    quiet = setup.vibration(np.concatenate((scene, rest)))
    return {
        TONE_ERROR: tone_hz,
        TONE_LEVEL: tone_db,
        PURITY: purity_db,
        CHIRP: _chirp_error_hz(setup),
        SWELL: _swell_error_db(setup),
        LAG: _lag_p95_ms(setup, count),
        LEAK: energy_above_db(quiet, SAMPLERATE),
        MISSED: missed,
        SPURIOUS: spurious,
        UNLIKE: _unlike_reference(setup, scene),
    }


def _tone_errors(setup: _Setup, count: int) -> tuple[float, float, float]:
    """Return r.m.s. errors in Hz and dB, and the worst THD+N in dB, of steady tones."""
    errors_hz, errors_db, purities_db = [], [], []
    for audio_hz in np.geomspace(*TONES_HZ, count):
        vibration = setup.vibration(tone(float(audio_hz), AMPLITUDE, TONE_S))
        fit = sine_fit(vibration[SAMPLERATE // 2 :], SAMPLERATE)
        wanted_hz = float(vibration_hz(np.array(audio_hz), setup.parameters))
        errors_hz.append(fit.frequency_hz - wanted_hz)
        errors_db.append(20.0 * np.log10(fit.amplitude / AMPLITUDE / _band_gain(setup, audio_hz)))
        purities_db.append(fit.residual_db)
    return _rms(errors_hz), _rms(errors_db), max(purities_db)


def _band_gain(setup: _Setup, audio_hz: float) -> float:
    """Return what the band-pass leaves of a tone: that it is weaker there is no error."""
    bandpass = setup.made._bandpass
    delay = np.exp(-2j * np.pi * audio_hz / SAMPLERATE)
    powers = delay ** np.arange(bandpass._a.size)
    return float(np.abs((bandpass._b * powers).sum() / (bandpass._a * powers).sum()))


def _chirp_error_hz(setup: _Setup) -> float:
    """Return the r.m.s. error in Hz of vibration on a chirp, at the declared latency."""
    time_s = np.arange(round(CHIRP_S * SAMPLERATE)) / SAMPLERATE
    growth = CHIRP_OCTAVES_A_S * np.log(2.0)
    phase = 2.0 * np.pi * CHIRP_FROM_HZ / growth * (np.exp(growth * time_s) - 1.0)
    vibration = setup.vibration(AMPLITUDE * np.sin(phase))
    turned = np.unwrap(np.angle(hilbert(vibration)))
    span = SAMPLERATE // 50  # a mean over 20 ms
    found_hz = (turned[span:] - turned[:-span]) / span * SAMPLERATE / (2.0 * np.pi)
    middle_s = time_s[:-span] + 0.5 * span / SAMPLERATE - setup.latency_frames / SAMPLERATE
    settled = (time_s[:-span] > CHIRP_SETTLED_S) & (time_s[:-span] < CHIRP_S - 0.1)
    audio_hz = CHIRP_FROM_HZ * np.exp(growth * middle_s[settled])
    return _rms(found_hz[settled] - vibration_hz(audio_hz, setup.parameters))


def _swell_error_db(setup: _Setup) -> float:
    """Return the r.m.s. error in dB of the level of a tone that swells, at the declared latency."""
    duration_s = 1.5
    time_s = np.arange(round(duration_s * SAMPLERATE)) / SAMPLERATE
    swell = 1.0 + SWELL_DEPTH * np.sin(2.0 * np.pi * SWELL_HZ * time_s)
    vibration = setup.vibration(tone(1_000.0, AMPLITUDE, duration_s) * swell)
    late = setup.latency_frames
    middle = slice(SAMPLERATE // 4, vibration.size - late - SAMPLERATE // 10)
    level = np.abs(hilbert(vibration))[late:][middle]
    return _rms(20.0 * np.log10(level / (AMPLITUDE * swell[middle])))


def _lag_p95_ms(setup: _Setup, count: int) -> float:
    """Return the 95th percentile of the onset lag over twice as many bursts as count."""
    stream_s = BURST_ONSET_S + 0.4  # the latest onset, and what the measure looks at after it
    lags = []
    for place, audio_hz in enumerate(np.geomspace(*BURST_HZ, 2 * count)):
        # places spread over the window by the golden ratio, so that no hop is favoured
        onset_s = BURST_ONSET_S + (0.618 * place % 1.0) * TransformParameters().window_s
        sound = burst(float(audio_hz), BURST_AMPLITUDE, onset_s, stream_s)
        lags.append(1e3 * onset_lag_s(setup.vibration(sound), SAMPLERATE, onset_s))
    return float(np.percentile(lags, 95))


def _notes(setup: _Setup) -> tuple[float, float]:
    """Return missed and spurious partials of decaying notes, in percent of all there are."""
    form = setup.made
    rng = np.random.default_rng(6)
    time_s = np.arange(form._grid.window_frames) / SAMPLERATE
    note_hz = np.exp(rng.uniform(np.log(NOTE_HZ[0]), np.log(NOTE_HZ[1]), NOTES))
    order = np.arange(1, HARMONICS + 1)
    wanted_hz = note_hz[:, None] * order
    turns = 2.0 * np.pi * wanted_hz[:, :, None] * time_s
    phases = rng.uniform(0.0, 2.0 * np.pi, (NOTES, HARMONICS, 1))
    waves = np.sin(turns + phases) * (AMPLITUDE / order)[:, None]
    windows = waves.sum(axis=1) * np.exp(-time_s / NOTE_DECAY_S)
    found = form._analysis.strongest(form._spectrum.transform(windows))
    hits = np.zeros(wanted_hz.shape, dtype=bool)
    spurious = 0
    for row, audio_hz in zip(found.row, found.audio_hz, strict=True):
        near = np.abs(wanted_hz[row] - audio_hz) < NOTE_REACH_HZ
        spurious += not (near & ~hits[row]).any()
        hits[row] |= near
    return 100.0 * float((~hits).mean()), 100.0 * spurious / hits.size


def _unlike_reference(setup: _Setup, scene: Stereo) -> float | None:
    """Return the share in percent of principal frequencies that only one of both forms finds."""
    parameters = TransformParameters()
    if setup.parameters.window_s != parameters.window_s:
        return None
    spectrum = Spectrum(parameters, SAMPLERATE)
    finder = PrincipalFinder(parameters, spectrum.bin_hz, spectrum.bins)
    form = setup.form()
    filtered = form._bandpass.process(scene.astype(np.float64).mean(axis=1))
    units = filtered[: filtered.size - filtered.size % spectrum.window_frames]
    units = units.reshape(-1, spectrum.window_frames)
    wanted, found = finder.all_principal(magnitude(spectrum.transform(units))), form.analyse(units)
    pitch_hz = 4.0 * SAMPLERATE
    here, there = (each.row * pitch_hz + each.audio_hz for each in (found, wanted))
    near = np.abs(here[:, None] - there) <= spectrum.bin_hz / 2.0
    alone = int((~near.any(axis=0)).sum()) + int((~near.any(axis=1)).sum())
    return 100.0 * alone / max(1, here.size + there.size)


def _rms(errors: FloatArray | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def _compared(
    one: Mapping[str, float | None], other: Mapping[str, float | None]
) -> dict[str, Literal["better", "worse"]]:
    """Return in which columns one setting differs from another by more than the blur."""
    found: dict[str, Literal["better", "worse"]] = {}
    for column, blur in BLUR.items():
        mine, theirs = one[column], other[column]
        if mine is None or theirs is None:
            continue
        apart = blur * theirs if column == COST else blur
        if abs(mine - theirs) > apart:
            found[column] = "better" if mine < theirs else "worse"
    return found


def _verdict(measured: Mapping[str, Mapping[str, float | None]]) -> str:
    """Return why the defaults lie where they lie: what every other setting costs and gains."""
    default = measured[DEFAULT]
    dominating, lines = [], []
    for name, values in measured.items():
        if name == DEFAULT:
            continue
        compared = _compared(values, default)
        gains, losses = (
            [f"{column} {number(_plain(values[column]))} {UNITS[column]}"
             for column, side in compared.items() if side == wanted]
            for wanted in ("better", "worse")
        )  # fmt: skip
        if gains and not losses:
            dominating.append(name)
        lines.append(
            f"- {name}: better in {', '.join(gains) or 'nothing'}; "
            f"worse in {', '.join(losses) or 'nothing'}"
        )
    shown = ", ".join(
        f"{column} {number(_plain(value))} {UNITS[column]}" for column, value in default.items()
    )
    head = (
        f"The defaults ({shown}) lie on the frontier: no other setting is better in something "
        "and worse in nothing."
        if not dominating
        else f"The defaults ({shown}) do not lie on the frontier: {', '.join(dominating)} "
        "is better in something and worse in nothing."
    )
    return "\n".join((head, "Against them, as far as the spread of repeats lets one tell:", *lines))
