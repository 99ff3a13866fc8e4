"""Section "Speech suppression": how well the live form recognises and attenuates speech."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.design.speech import RAMPS
from audioflinger_hook.transform.haptic import CoreStream
from tools.bench.measures.similarity import level_db
from tools.bench.report import Missing, Row, Section
from tools.bench.sounds.signals import SAMPLERATE, Recording
from tools.bench.sounds.speech_sounds import (
    OTHER_HALF,
    desktop,
    even,
    no_speech,
    repeated,
    scene_track,
    spoken,
)
from tools.bench.workbench import Workbench

TITLE = "Speech suppression"
SUPPRESSION_DB = 18.0
LENGTH_S = 2.0, 6.0  # shortest and longest sound in s
HEARD_DB = -30.0  # lowest level of a hop with sound, relative to the sound's maximum
KNOWN_AFTER_S = 0.5
BELIEVED = 0.5
OFF = TransformParameters()
ON = TransformParameters(speech_suppression_db=SUPPRESSION_DB)


Hops = np.ndarray[tuple[int], np.dtype[np.bool_]]


@dataclass(frozen=True)
class Heard:
    """Level of a sound and estimated probability of speech, for each hop (step of the analysis).

    belief: probability of speech, 0 to 1.
    level_db: mean square of the sound in dB relative to 1.
    hop_s: duration of a hop in s.
    """

    belief: FloatArray
    level_db: FloatArray
    hop_s: float

    @property
    def sounding(self) -> Hops:
        """Whether the level of each hop is at most 30 dB under the largest level."""
        sounding: Hops = self.level_db > self.level_db.max() + HEARD_DB
        return sounding


def _told_of_belief(parameters: TransformParameters, samplerate: int) -> LiveDesign:
    """Return a design in which only the probability of speech determines the attenuation."""
    design = LiveDesign.of(parameters, samplerate)
    never, always = (1e9, 2e9), (-2e9, -1e9)
    selection = {"spared_hz": always, "excess_db": never, "background_db": always, "between": never}
    ramps = zip(RAMPS, design.speech.speech_ramps, strict=True)
    return replace(
        design,
        analysis=replace(design.analysis, threshold_hz=1e-9, peak_span_min=0.0),
        mapping=replace(design.mapping, full_scale_r=1e3 * design.mapping.full_scale_r),
        speech=replace(
            design.speech,
            speech_ramps=np.array([selection.get(name, ramp) for name, ramp in ramps]),
        ),
    )


def heard(sound: FloatArray, samplerate: int = SAMPLERATE) -> Heard:
    """Return the probability of speech that the live form estimates in each hop of a sound.

    The probability is computed from the attenuation of the partials in the hop.
    """
    designs = [_told_of_belief(parameters, samplerate) for parameters in (OFF, ON)]
    streams = [CoreStream(design, 1, each=False) for design in designs]
    grid = designs[0].grid
    hops = sound.size // grid.hop_frames
    pieces = sound[: hops * grid.hop_frames].reshape(hops, -1)
    strength = np.zeros((2, hops))
    for hop, piece in enumerate(pieces):
        for which, stream in enumerate(streams):
            stream.process(piece[:, None])
            strength[which, hop] = sum(amplitude for _, _, amplitude in stream.told)
    plain, lowered = np.where(strength > 0.0, strength, 1.0)
    belief = np.log10(lowered / plain) * (-20.0 / SUPPRESSION_DB)
    levels_db = 10.0 * np.log10((pieces**2).mean(axis=1) + 1e-12)
    return Heard(belief, levels_db, grid.hop_s)


def speech_suppression(bench: Workbench) -> Section:
    """Measure how often speech, and how often other sounds, are classified as speech."""
    length_s = float(np.clip(bench.effort.cost_s, *LENGTH_S))
    recorded = spoken(bench.recordings)
    rows: list[Row] = []
    missing: list[Missing] = []
    if recorded:
        for half, sound in recorded.items():
            rows += _clean("recorded speech", repeated(sound, length_s), half)
    else:
        missing.append(bench.missing_recordings(f"{TITLE}: recorded speech"))
    rows += _clean("synthetic speech", repeated(scene_track("speech"), length_s), OTHER_HALF)
    rows += _false_alarms(0.6 * length_s, bench)
    return Section(
        TITLE,
        "The table shows the share of the hops with sound that the live form classifies as speech. "
        "If the sound is speech, these hops are hits, otherwise false alarms. The speech consists "
        "of recorded names of loudspeakers (spoken by one woman), and of the synthetic voice of "
        f"the demo scene. Rows with *known* leave out the first {KNOWN_AFTER_S:g} s of the sound. "
        "The detection was tuned with one half of the sounds (*chosen on*), and is tested with the "
        "other half. Rows with *lowered by* show the reduction of the level of the vibration with "
        f"`speech_suppression_db` = {SUPPRESSION_DB:g}.",
        tuple(rows),
        tuple(missing),
        footnote="Both halves of the recordings have the same speaker, so the test covers only "
        "one recorded voice. The live form does not detect the start of speech after a pause of "
        "more than a second. It also misses speech that is no louder than the other sounds. "
        "Telephones and sirens cause false alarms, because their tones glide or have the rhythm "
        "of syllables.",
    )


def _clean(name: str, sound: FloatArray, half: str) -> Iterator[Row]:
    found = heard(sound)
    hits = found.belief > BELIEVED
    known = found.sounding.copy()
    known[: round(KNOWN_AFTER_S / found.hop_s)] = False
    yield Row(f"{name}, all of it", _percent(hits, found.sounding), "%", half)
    yield Row(f"{name}, known", _percent(hits, known), "%", half)
    first = float(np.argmax(found.sounding)) * found.hop_s
    at_s = float(np.argmax(hits)) * found.hop_s - first if hits.any() else None
    yield Row(f"{name}, first known after", at_s, "s", half, note="" if hits.any() else "never")
    plain, lowered = (_vibration(sound, parameters) for parameters in (OFF, ON))
    start = round(2.0 * KNOWN_AFTER_S * SAMPLERATE)
    change = _level(plain[start:]) - _level(lowered[start:])
    yield Row(f"{name}, lowered by", change, "dB", half)


def _false_alarms(length_s: float, bench: Workbench) -> Iterator[Row]:
    for half, sounds in no_speech(length_s).items():
        for name, sound in sounds.items():
            found = heard(sound)
            share = _percent(found.belief > BELIEVED, found.sounding)
            yield Row(f"no speech: {name}", share, "%", half)
    for half, items in desktop(bench.recordings).items():
        items = items[: bench.effort.compared_recordings]
        alarms = [_alarm_and_sound_s(item) for item in items]
        if not alarms:
            continue
        false_s, sound_s = (float(sum(column)) for column in zip(*alarms, strict=True))
        worst = max(range(len(alarms)), key=lambda place: alarms[place][0])
        note = f"{half}: most on {items[worst].name}, {alarms[worst][0]:.1f} s"
        share = 100.0 * false_s / sound_s
        yield Row("no speech: desktop sounds", share, "%", half, note=note)


def _alarm_and_sound_s(recording: Recording) -> tuple[float, float]:
    sound = even(recording.frames.mean(axis=1, dtype=np.float64))
    found = heard(sound, recording.samplerate)
    alarms = (found.belief > BELIEVED) & found.sounding
    return float(alarms.sum()) * found.hop_s, float(found.sounding.sum()) * found.hop_s


def _vibration(sound: FloatArray, parameters: TransformParameters) -> FloatArray:
    transform = HapticTransform(SAMPLERATE, 1, parameters)
    whole = np.concatenate((transform.process(sound), transform.finish()))[:, 0]
    in_time: FloatArray = whole[transform.latency_frames :]
    return in_time


def _level(vibration: FloatArray) -> float:
    return level_db(float((vibration**2).mean()))


def _percent(chosen: Hops, among: Hops) -> float:
    return 100.0 * float(chosen[among].mean())
