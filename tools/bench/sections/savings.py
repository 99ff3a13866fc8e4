"""Benches on savings: what each rule of "model only what a scene needs" saves, and what it changes.

Each rule is switched off from outside, on the running transform, so that the transform itself
carries no switches. A rule that changes more than its bound is not met.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.arrays import strided_windows
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.analysis import AnalysisDesign, window_tables
from audioflinger_hook.transform.live.analysis import LiveAnalysis
from audioflinger_hook.transform.live.synthesis import Glides, OscillatorBank
from audioflinger_hook.transform.live.transform import LiveTransform
from audioflinger_hook.transform.principal import Principals
from audioflinger_hook.transform.spectrum import Spectrum
from tools.bench.cost import Timings, interleaved
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
from tools.bench.workbench import Workbench

BLOCKSIZE = 256
EVERY_SAVING = "all savings on"
SAVED, CHANGE, PARTIAL = "saves at most", "largest change", "of a partial alike"
DEMO_FROM_S, DEMO_TO_S = 8.0, 12.0
"""Of the demo scene: speech, a second of silence, an explosion, a chord."""
DEMO_TIMES = 2.5
"""So many times as long as the other scenes that part is at most; its beginning is left out."""
PARTIALS_MAX = TransformParameters().partials_max

TIED = 0.06
"""Bound of what a tie changes: twice the amplitude of white noise's strongest partials, 0.03. Where
two peaks are as good as equal for the last of n places, anything, however small, decides which one
is kept. The two may differ by a hundredth, but what is found in the next hop goes on from the one,
in its phase, and from the other it does not."""

ALIKE = 0.1
"""Two bandwidths are the same within a tenth. A dip over half power ends the walk down a peak;
where it fills up, the walk goes on to the next."""

INAUDIBLE = 1e-300
"""Stands for an amplitude of 0 where a rule looks for 0; added to anything it changes nothing."""


@dataclass(frozen=True)
class Saving:
    """One saving: what is done without it, how to switch it off, and the bound of its change.

    bound: of the change of any sample, of full scale, 0 for the same bytes. partial_bound: of the
    change of any partial's amplitude in hops in which it decides nothing, see `kept_alike`.
    """

    name: str
    switch_off: Callable[[LiveTransform], None]
    bound: float = 0.0
    partial_bound: float | None = None


def _analyse_silence(transform: LiveTransform) -> None:
    transform._silence = -1.0


def _never_rest(transform: LiveTransform) -> None:
    transform._ring_hops = 10**9


def _examine_every_peak(transform: LiveTransform) -> None:
    transform._analysis._peak_span_min = -1.0


def _keep_every_bin(transform: LiveTransform) -> None:
    spectrum = transform._spectrum
    transform._analysis = LiveAnalysis(
        AnalysisDesign.of(TransformParameters(), spectrum, spectrum.bins)
    )


def _clear_every_image(transform: LiveTransform) -> None:
    transform._analysis._weakest_image = 0.0


class _EveryImage(LiveAnalysis):
    """The analysis with images cleared however high a peak stands."""

    def __init__(self, spectrum: Spectrum, bins: int) -> None:
        super().__init__(AnalysisDesign.of(TransformParameters(), spectrum, bins))
        self._turn, self._table = window_tables(spectrum, bins, spectrum.window_frames)


def _clear_high_images(transform: LiveTransform) -> None:
    transform._analysis = _EveryImage(transform._spectrum, transform._analysis._bins)


class _EverySlot(OscillatorBank):
    """The oscillator bank with no slot left out: amplitudes of 0 become inaudible ones."""

    def render(self, glides: Glides) -> FloatArray:
        return super().render(
            Glides(
                glides.start_hz,
                glides.end_hz,
                np.where(glides.start_amplitude == 0.0, INAUDIBLE, glides.start_amplitude),
                glides.end_amplitude,
                glides.start_phase,
            )
        )


def _sound_every_slot(transform: LiveTransform) -> None:
    design = transform.design.synthesis
    transform._bank = _EverySlot(
        design.attack, design.glide, transform.design.grid.hop_s, design.still
    )


SAVINGS: tuple[Saving, ...] = (
    Saving("saving off: quiet windows are analysed", _analyse_silence),
    Saving("saving off: what has rung out plays on", _never_rest, 1e-8),
    Saving("saving off: empty slots are played", _sound_every_slot),
    Saving("saving off: small peaks are refined", _examine_every_peak),
    Saving("saving off: bins above the band are kept", _keep_every_bin, 0.02),
    Saving("saving off: images of weak peaks are cleared", _clear_every_image, 0.02),
    Saving("saving off: images of high peaks are cleared", _clear_high_images, TIED, 0.001),
)


def _scenes(duration_s: float, recordings: tuple[Recording, ...]) -> dict[str, FloatArray | None]:
    """Return the scenes that savings are tried on, mono float64."""
    cut_short = chord(duration_s)
    cut_short[SAMPLERATE // 2 :] = 0.0
    spoken = speech(recordings)
    from_s = max(DEMO_FROM_S, DEMO_TO_S - DEMO_TIMES * duration_s)
    demo = demo_sound()[round(from_s * SAMPLERATE) : round(DEMO_TO_S * SAMPLERATE)]
    scenes = {
        "0.5 s, then silence": cut_short,
        "demo scene": demo,
        "speech": None if spoken is None else looped(spoken, duration_s),
        "white noise": white_noise(duration_s),
        "clicks": stereo(_clicks(duration_s)),
    }
    return {
        name: None if sound is None else sound.astype(np.float64).mean(axis=1)
        for name, sound in scenes.items()
    }


def _clicks(duration_s: float) -> FloatArray:
    """Return a full-scale sample forty times a second: its peaks are as wide as the band."""
    clicks = np.zeros(round(duration_s * SAMPLERATE))
    clicks[:: SAMPLERATE // 40] = 1.0
    return clicks


def kept_alike(sound: FloatArray, saving: Saving) -> tuple[float, int, int]:
    """Return what a saving changes where it decides nothing.

    The largest change of a partial's amplitude in hops in which the same peaks are kept, each as
    wide within a tenth; how many hops are others; of how many.
    """
    ours, theirs = (
        LiveTransform(LiveDesign.of(TransformParameters(), SAMPLERATE)) for _ in range(2)
    )
    saving.switch_off(theirs)
    reach_hz = ours._spectrum.bin_hz / 2.0
    change, others = 0.0, 0
    hops = list(zip(_hops(ours, sound), _hops(theirs, sound), strict=True))
    for (found, amplitude), (their, their_amplitude) in hops:
        if (
            len(found) != len(their)
            or (np.abs(found.audio_hz - their.audio_hz) > reach_hz).any()
            or (np.abs(found.bandwidth_hz / their.bandwidth_hz - 1.0) > ALIKE).any()
        ):
            others += 1
        else:
            change = max(change, float(np.abs(amplitude - their_amplitude).max(initial=0.0)))
    return change, others, len(hops)


def _hops(transform: LiveTransform, sound: FloatArray) -> Iterator[tuple[Principals, FloatArray]]:
    """Yield what each hop's window holds, and its amplitudes by the level law."""
    grid = transform._grid
    filtered = transform._bandpass.process(sound)
    windows = strided_windows(filtered, grid.window_frames, grid.hop_frames)
    for window in windows:
        found = transform._analysis.strongest(transform._spectrum.transform(window[None]))
        yield (
            found,
            transform.design.mapping.amplitudes(found.amplitude, found.r)
            if len(found)
            else found.r,
        )


def savings(bench: Workbench) -> Section:
    """Cost with and without each saving, scene by scene, and what it changes."""
    rows: list[Row] = []
    missing: list[Missing] = []
    saved: dict[str, list[tuple[float, str]]] = {saving.name: [] for saving in SAVINGS}
    change: dict[str, float] = dict.fromkeys(saved, 0.0)
    alike: dict[str, list[tuple[float, int, int]]] = {saving.name: [] for saving in SAVINGS}
    for scene, sound in _scenes(bench.effort.saving_s, bench.recordings).items():
        if sound is None:
            missing.append(bench.missing_recordings(f"savings on {scene}"))
            continue
        outputs, timings = _with_and_without(sound, bench.effort.saving_repeats)
        ms_a_second = 1e3 * SAMPLERATE / sound.size
        every = timings[EVERY_SAVING]
        for name, timing in timings.items():
            rows.append(Row(name, ms_a_second * timing.median_s, "ms", scene))
        for name in saved:
            ratio = float(np.median(np.array(every.seconds) / np.array(timings[name].seconds)))
            saved[name].append((100.0 * (1.0 - ratio), scene))
            largest = float(np.abs(outputs[name] - outputs[EVERY_SAVING]).max())
            change[name] = max(change[name], largest)
        for saving in SAVINGS:
            if saving.partial_bound is not None:
                alike[saving.name].append(kept_alike(sound, saving))
    for saving in SAVINGS:
        most, scene = max(saved[saving.name])
        must = Must("<=", saving.bound)
        rows.append(Row(saving.name, most, "%", SAVED, note=f"most on {scene}"))
        rows.append(Row(saving.name, change[saving.name], "", CHANGE, must))
        if saving.partial_bound is not None:
            partial_change, _, _ = max(alike[saving.name])
            others, hops = (sum(one[place] for one in alike[saving.name]) for place in (1, 2))
            must = Must("<=", saving.partial_bound)
            note = f"it decides something in {others} of {hops} hops"
            rows.append(Row(saving.name, partial_change, "", PARTIAL, must, note=note))
    return Section(
        "What each saving saves",
        "The live form leaves out what a scene does not need. First the cost of a second with "
        f"all of its savings, then without one at a time (one channel, blocks of {BLOCKSIZE} "
        f"frames, in NumPy, medians of {bench.effort.saving_repeats} over "
        f"{bench.effort.saving_s:g} s; the kernel leaves out the same). Then the most that this "
        "one saves on any scene, and the most that it changes any sample, full scale being 1, with "
        "the bound that it states. In noise two peaks can tie for the last of "
        f"{PARTIALS_MAX} places, and what is a hundred times weaker than either then decides which "
        "one is kept, and in which phase the next goes on from it. So for the images of high peaks "
        "there is also what they change otherwise: the amplitude of a partial, in hops in which "
        "the same peaks are kept, each as wide as it is.",
        tuple(rows),
        tuple(missing),
    )


def _with_and_without(
    sound: FloatArray, repeats: int
) -> tuple[dict[str, FloatArray], dict[str, Timings]]:
    """Return output and timings, by name, with every saving and without each one."""
    outputs: dict[str, FloatArray] = {}

    def play(name: str, switch_off: Callable[[LiveTransform], None]) -> None:
        transform = LiveTransform(LiveDesign.of(TransformParameters(), SAMPLERATE))
        switch_off(transform)
        outputs[name] = np.concatenate(
            [
                transform.process(sound[first : first + BLOCKSIZE])
                for first in range(0, sound.size, BLOCKSIZE)
            ]
        )

    ways: dict[str, Callable[[LiveTransform], None]] = {EVERY_SAVING: lambda _: None}
    ways |= {saving.name: saving.switch_off for saving in SAVINGS}
    works = [partial(play, name, switch_off) for name, switch_off in ways.items()]
    timings = interleaved(works, repeats, warm=False)  # each takes a tenth of a second or more
    return outputs, dict(zip(ways, timings, strict=True))
