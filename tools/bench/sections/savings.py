"""Section on savings: what the live form saves by leaving out work, and what that changes.

Each saving is switched off by a design, so the transform itself carries no switches.
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
DEMO_FROM_S, DEMO_TO_S = 8.0, 12.0
"""Of the demo scene: speech, a second of silence, an explosion, a chord."""
DEMO_TIMES = 2.5
"""Longest part of the demo scene, as a multiple of the other scenes' length."""
PARTIALS_MAX = TransformParameters().partials_max

FAINT = 1e-20
"""Added to sound of which outputs are compared. After silence that is exactly 0 hops begin anew as
soon as the vibration has decayed, so they would begin elsewhere where it plays on."""
TIED = 0.06
"""Bound where two peaks tie for the last place: twice 0.03, the strongest partials of white noise.
 The smallest change then decides which peak, and which phase, is kept."""


@dataclass(frozen=True)
class Saving:
    """One saving: what is done without it, and how a design switches it off.

    bound: of the change of any sample, of full scale.
    """

    name: str
    switch_off: Callable[[LiveDesign], LiveDesign]
    bound: float = 0.0


def _setting(section: str, name: str, value: float) -> Callable[[LiveDesign], LiveDesign]:
    """Return what sets a number of one section of a design."""
    return lambda design: replace(
        design, **{section: replace(getattr(design, section), **{name: value})}
    )


def _keep_every_bin(design: LiveDesign) -> LiveDesign:
    spectrum = Spectrum.of(TransformParameters(), design.samplerate)
    analysis = AnalysisDesign.of(TransformParameters(), spectrum, spectrum.bins)
    return replace(design, analysis=analysis)


def _clear_high_images(design: LiveDesign) -> LiveDesign:
    """Let images be cleared however high a peak stands."""
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
    """Return the scenes that savings are tried on, mono float64."""
    cut_short = chord(duration_s)
    cut_short[SAMPLERATE // 2 :] = 0.0
    clicks = np.zeros(round(duration_s * SAMPLERATE))
    clicks[:: SAMPLERATE // 40] = 1.0  # as wide in frequency as the band
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
    """Cost with and without each saving, by scene, and what it changes."""
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
        "The live form leaves out work that a scene does not need. First the cost of a second with "
        "all savings, then without one at a time: the row says what is done then. It is of one "
        f"channel, blocks of {BLOCKSIZE} frames, medians of {bench.effort.saving_repeats} "
        f"over {bench.effort.saving_s:g} s. Then "
        "the most that it saves on any scene, and the largest change of any sample, of full "
        f"scale. In noise two peaks can tie for the last of {PARTIALS_MAX} places; a tiny change "
        "then decides which one is kept.",
        tuple(rows),
        tuple(missing),
    )


def _streams_of(design: LiveDesign) -> Callable[[int, int], CoreStream]:
    return lambda _samplerate, channels: CoreStream(design, channels, each=False)


def _with_and_without(
    sound: FloatArray, repeats: int
) -> tuple[dict[str, FloatArray], dict[str, Timings]]:
    """Return output and timings, by name, with every saving and without each one."""
    design = LiveDesign.of(TransformParameters(), SAMPLERATE)
    designs = {EVERY_SAVING: design}
    designs |= {saving.name: saving.switch_off(design) for saving in SAVINGS}
    subjects = [Subject(name, _streams_of(made)) for name, made in designs.items()]
    outputs = {one.name: one.vibration(sound + FAINT, SAMPLERATE) for one in subjects}
    timings = timed([Playback(one, sound[:, None], BLOCKSIZE) for one in subjects], repeats)
    return outputs, dict(zip(designs, timings, strict=True))
