"""Section "What each saving saves": CPU time saved by skipping unnecessary work.

For each measurement, a modified `LiveDesign` switches off one saving.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.analysis import AnalysisDesign, window_tables
from audioflinger_hook.transform.haptic import CoreStream
from audioflinger_hook.transform.principal import Spectrum
from tools.bench.cost import Timings
from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sounds.signals import (
    SAMPLERATE,
    Recording,
    chord,
    demo_sound,
    looped,
    speech,
    stereo,
    white_noise,
)
from tools.bench.workbench import Playback, Subject, Workbench, timed

BLOCKSIZE = 256
EVERY_SAVING = "all savings on"
SAVED, CHANGE = "saves at most", "largest change"
DEMO_FROM_S, DEMO_TO_S = 8.0, 12.0  # part of the demo in s: speech, silence, explosion, chord
DEMO_TIMES = 2.5  # largest length of the demo scene, as a multiple of the other scenes' length
PARTIALS_MAX = TransformParameters().partials_max

FAINT = 1e-20
"""Amplitude added to sounds whose outputs are compared, to avoid exact silence. After exact
silence, hops may restart at another frame.
"""
TIED = 0.06
"""Largest change where two peaks tie for the last partial: twice 0.03, the amplitude of the
strongest partials of white noise. A tiny difference then decides which peak and phase are kept.
"""


@dataclass(frozen=True)
class Saving:
    """Unnecessary work that the live form skips.

    name: the work that is done without the saving.
    switch_off: function that returns a design without the saving.
    bound: limit for the change of any sample of the vibration, relative to full scale.
    """

    name: str
    switch_off: Callable[[LiveDesign], LiveDesign]
    bound: float = 0.0


def _setting(section: str, name: str, value: float) -> Callable[[LiveDesign], LiveDesign]:
    return lambda design: replace(
        design, **{section: replace(getattr(design, section), **{name: value})}
    )


def _keep_every_bin(design: LiveDesign) -> LiveDesign:
    spectrum = Spectrum.of(TransformParameters(), design.samplerate)
    analysis = AnalysisDesign.of(TransformParameters(), spectrum, spectrum.bins)
    return replace(design, analysis=analysis)


def _clear_high_images(design: LiveDesign) -> LiveDesign:
    spectrum = Spectrum.of(TransformParameters(), design.samplerate)
    turn, table = window_tables(spectrum, design.analysis.bins, spectrum.window_frames)
    return replace(design, analysis=replace(design.analysis, image_turn=turn, image_table=table))


SAVINGS: tuple[Saving, ...] = (
    Saving("quiet windows are analysed", _setting("input", "silence", -1.0)),
    Saving("vibration that has decayed plays on", _setting("synthesis", "ring_hops", 10**6), 1e-8),
    Saving("small peaks are refined", _setting("analysis", "peak_span_min", -1.0)),
    Saving("bins above the band are kept", _keep_every_bin, 0.02),
    Saving("weak peaks lose their image", _setting("analysis", "weakest_image", 0.0), 0.02),
    Saving("high peaks lose their image", _clear_high_images, TIED),
)


def _scenes(duration_s: float, recordings: tuple[Recording, ...]) -> dict[str, FloatArray | None]:
    cut_short = chord(duration_s)
    cut_short[SAMPLERATE // 2 :] = 0.0
    clicks = np.zeros(round(duration_s * SAMPLERATE))
    clicks[:: SAMPLERATE // 40] = 1.0  # clicks cover the whole band
    spoken = speech(recordings)
    from_s = max(DEMO_FROM_S, DEMO_TO_S - DEMO_TIMES * duration_s)
    demo = demo_sound()[round(from_s * SAMPLERATE) : round(DEMO_TO_S * SAMPLERATE)]
    scenes = {
        "0.5 s, then silence": cut_short,
        "demo scene": demo,
        "speech": None if spoken is None else looped(spoken, duration_s),
        "white noise": white_noise(duration_s),
        "clicks": stereo(clicks),
    }
    return {
        name: None if sound is None else sound.astype(np.float64).mean(axis=1)
        for name, sound in scenes.items()
    }


def savings(bench: Workbench) -> Section:
    """Measure the CPU time without each saving, and how a saving changes the vibration."""
    rows: list[Row] = []
    missing: list[Missing] = []
    saved: dict[str, list[tuple[float, str]]] = {saving.name: [] for saving in SAVINGS}
    change: dict[str, float] = dict.fromkeys(saved, 0.0)
    for scene, sound in _scenes(bench.effort.saving_s, bench.recordings).items():
        if sound is None:
            missing.append(bench.missing_recordings(f"savings on {scene}"))
            continue
        outputs, timings = _with_and_without(sound, bench.effort.saving_repeats)
        every = timings[EVERY_SAVING]
        for name, timing in timings.items():
            rows.append(Row(name, 1e3 * SAMPLERATE / sound.size * timing.median_s, "ms", scene))
        for name in saved:
            ratio = float(np.median(np.array(every.seconds) / np.array(timings[name].seconds)))
            saved[name].append((100.0 * (1.0 - ratio), scene))
            largest = float(np.abs(outputs[name] - outputs[EVERY_SAVING]).max())
            change[name] = max(change[name], largest)
    for saving in SAVINGS:
        most, scene = max(saved[saving.name])
        must = Must("<=", saving.bound)
        rows.append(Row(saving.name, most, "%", SAVED, note=f"most on {scene}"))
        rows.append(Row(saving.name, change[saving.name], "", CHANGE, must))
    return Section(
        "What each saving saves",
        "The live form skips unnecessary work. The table shows the cost of a second of sound for "
        "several scenes. In the first row, no unnecessary work is done. Every further row names "
        "one saving that is switched off, and shows the cost. The sound has one channel and "
        f"blocks of {BLOCKSIZE} frames. Values are medians of {bench.effort.saving_repeats} "
        f"repeats over {bench.effort.saving_s:g} s of sound. The column *saves at most* shows the "
        "largest saving of cost among all scenes. The column *largest change* shows the largest "
        "change of a sample of the vibration, relative to full scale. In noise, a tiny change can "
        f"decide which of two similar peaks becomes the last of {PARTIALS_MAX} partials.",
        tuple(rows),
        tuple(missing),
    )


def _streams_of(design: LiveDesign) -> Callable[[int, int], CoreStream]:
    return lambda _samplerate, channels: CoreStream(design, channels, each=False)


def _with_and_without(
    sound: FloatArray, repeats: int
) -> tuple[dict[str, FloatArray], dict[str, Timings]]:
    design = LiveDesign.of(TransformParameters(), SAMPLERATE)
    designs = {EVERY_SAVING: design}
    designs |= {saving.name: saving.switch_off(design) for saving in SAVINGS}
    subjects = [Subject(name, _streams_of(made)) for name, made in designs.items()]
    outputs = {one.name: one.vibration(sound + FAINT, SAMPLERATE) for one in subjects}
    timings = timed([Playback(one, sound[:, None], BLOCKSIZE) for one in subjects], repeats)
    return outputs, dict(zip(designs, timings, strict=True))
