"""Benches on bursts, noise and recordings: how early, how clean, how true, how repeatable."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import median

import numpy as np

from audioflinger_hook.transform import FloatArray, Frames, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.live.transform import LiveTransform
from audioflinger_hook.transform.principal import PrincipalFinder
from audioflinger_hook.transform.reference.transform import ReferenceTransform
from audioflinger_hook.transform.spectrum import Spectrum, magnitude
from tools.bench.measures.vibration import (
    Agreement,
    agreement,
    differing_blocks,
    energy_above_db,
    onset_lag_s,
)
from tools.bench.report import Missing, Must, Row, Section
from tools.bench.sounds.signals import (
    SAMPLERATE,
    Recording,
    burst,
    demo_sound,
    white_noise,
)
from tools.bench.workbench import LIVE, Subject, Workbench

BURST_HZ = (80.0, 5_000.0)
BURST_AMPLITUDE = 0.3
BURST_ONSET_S, BURST_STREAM_S = 0.3, 0.9
LAG_P95, LAG_P95_LEAD = Must("<=", 45.0), Must("<=", 10.0)

AUDIBLE_FROM_HZ = 250.0
REST_S = 1.0
"""Silence after a sound, in which the vibration comes to rest."""
NOISE_S = 5.0
LEAK_RECORDING, LEAK_RECORDING_LEAD = Must("<=", -50.0), Must("<=", -58.0)
LEAK_NOISE = Must("<=", -50.0)

AGREEMENT, AGREEMENT_LEAD = Must(">=", 0.95), Must(">=", 0.99)
UNITS_AT_ONCE = 64
FEWEST_FOR_A_RATIO = 50
"""Recordings with fewer principal frequencies give no meaningful precision of their own."""

SPLIT_FRAMES = (1, 7, 240, 256, 960, 4096)
SPLIT_FROM_S = 6.9
"""Where in the demo scene footsteps meet speech: partials are born and die all the time."""
RANDOM_SPLITS = 3


def onset_lag(bench: Workbench) -> Section:
    """How long after the start of a tone burst it is felt."""
    effort = bench.effort
    window_s = TransformParameters().window_s
    # Onsets at every place of the window: how a burst meets the grid decides its lag.
    places = np.random.default_rng(0).uniform(size=(effort.bursts, effort.onsets_a_burst))
    places = (places + np.arange(effort.onsets_a_burst)) / effort.onsets_a_burst
    lags_ms: dict[str, list[float]] = {subject.name: [] for subject in bench.subjects}
    for frequency_hz, row in zip(np.geomspace(*BURST_HZ, effort.bursts), places, strict=True):
        for place in row:
            onset_s = BURST_ONSET_S + place * window_s
            sound = burst(float(frequency_hz), BURST_AMPLITUDE, onset_s, BURST_STREAM_S)
            for subject in bench.subjects:
                vibration = subject.vibration(sound, SAMPLERATE)
                lags_ms[subject.name].append(1e3 * onset_lag_s(vibration, SAMPLERATE, onset_s))
    rows = []
    for subject in bench.subjects:
        lags = np.array(lags_ms[subject.name])
        asked = subject.name == LIVE
        lags_p95 = Row(
            "lag, 95th percentile",
            float(np.percentile(lags, 95)),
            "ms",
            subject.name,
            LAG_P95 if asked else None,
            lead=LAG_P95_LEAD if asked else None,
        )
        rows += [
            Row("lag, mean", float(lags.mean()), "ms", subject.name),
            Row("lag, median", float(np.median(lags)), "ms", subject.name),
            lags_p95,
            Row("lag, largest", float(lags.max()), "ms", subject.name),
            Row("declared latency", _latency_ms(subject, "latency_frames"), "ms", subject.name),
            Row(
                "what lasts follows after",
                _latency_ms(subject, "tonal_latency_frames"),
                "ms",
                subject.name,
            ),
        ]
    count = effort.bursts * effort.onsets_a_burst
    return Section(
        "Onset lag",
        f"How long after a sound starts the cushion follows: {count} tone bursts of "
        f"{BURST_HZ[0]:g} to {BURST_HZ[1]:g} Hz, until the vibration's envelope passes half of "
        "where it settles. The declared latency, by which picture and sound can be held back, is "
        "part of the lag, not on top of it. The level of what lasts, and its end, follow later.",
        tuple(rows),
        series={name: tuple(lags) for name, lags in lags_ms.items()},
    )


def _latency_ms(subject: Subject, name: str) -> float | None:
    frames = getattr(subject.start(SAMPLERATE, 1), name, None)
    return None if frames is None else 1e3 * float(frames) / SAMPLERATE


def energy_above(bench: Workbench) -> Section:
    """The vibration's energy where a shaker is heard instead of felt."""
    rows: list[Row] = []
    missing: list[Missing] = []
    for subject in bench.subjects:
        first = subject is bench.subjects[0]
        noise_db = _leak_db(subject, white_noise(NOISE_S), SAMPLERATE)
        rows.append(
            Row("white noise, 0 dBFS", noise_db, "dB", subject.name, LEAK_NOISE if first else None)
        )
        leaks = [
            (_leak_db(subject, item.frames, item.samplerate), item.name)
            for item in bench.recordings
        ]
        if leaks:
            worst_db, name = max(leaks)
            must = LEAK_RECORDING if first else None
            note = f"{subject.name}: {name}"
            lead = LEAK_RECORDING_LEAD if first else None
            rows.append(
                Row("worst recording", worst_db, "dB", subject.name, must, note=note, lead=lead)
            )
            typical_db = median(level for level, _ in leaks)
            rows.append(Row("median recording", typical_db, "dB", subject.name))
    if not bench.recordings:
        missing.append(bench.missing_recordings("energy above 250 Hz, worst recording"))
    return Section(
        f"Energy above {AUDIBLE_FROM_HZ:g} Hz",
        "Vibration should be felt, not heard: energy above "
        f"{AUDIBLE_FROM_HZ:g} Hz as a share of all of it"
        + (f", over {len(bench.recordings)} recordings." if bench.recordings else "."),
        tuple(rows),
        tuple(missing),
    )


def _leak_db(subject: Subject, frames: Frames, samplerate: int) -> float:
    rest = np.zeros((round(REST_S * samplerate), frames.shape[1]), frames.dtype)
    sound = np.concatenate((frames, rest))
    return energy_above_db(subject.vibration(sound, samplerate), samplerate, AUDIBLE_FROM_HZ)


def principal_frequencies(bench: Workbench) -> Section:
    """How far the live form finds the reference form's principal frequencies."""
    title = "Principal frequencies"
    explanation = (
        "Both forms look at the same unit sequences of the recordings: of the frequencies that "
        "the live form finds, how many are the reference's (precision), and how many of the "
        "reference's it finds (recall), within half a bin and before the strongest 16 are chosen."
    )
    if not bench.recordings:
        return Section(title, explanation, (), (bench.missing_recordings("precision and recall"),))
    by_name = [(item.name, _recording_agreement(item)) for item in bench.recordings]
    total = sum((one for _, one in by_name), Agreement(0, 0, 0, 0))
    telling = [(name, one) for name, one in by_name if one.wanted >= FEWEST_FOR_A_RATIO]
    rows = [
        Row("precision, all recordings", total.precision, must=AGREEMENT, lead=AGREEMENT_LEAD),
        Row("recall, all recordings", total.recall, must=AGREEMENT, lead=AGREEMENT_LEAD),
    ]
    if telling:
        name, least = min(telling, key=lambda entry: entry[1].precision)
        rows.append(Row("precision, worst recording", least.precision, note=name))
        name, least = min(telling, key=lambda entry: entry[1].recall)
        rows.append(Row("recall, worst recording", least.recall, note=name))
    spurious, missed = total.found - total.found_hits, total.wanted - total.wanted_hits
    rows += [
        Row("found, but not by the reference", float(spurious), f"of {total.found}"),
        Row("found by the reference alone", float(missed), f"of {total.wanted}"),
    ]
    return Section(title, explanation, tuple(rows))


def _recording_agreement(recording: Recording) -> Agreement:
    parameters = TransformParameters()
    live = LiveTransform(LiveDesign.of(parameters, recording.samplerate))
    spectrum = Spectrum.of(parameters, recording.samplerate)
    finder = PrincipalFinder(parameters, spectrum.bin_hz, spectrum.bins)
    total = Agreement(0, 0, 0, 0)
    for units in _unit_batches(recording):
        wanted = finder.all_principal(magnitude(spectrum.transform(units)))
        total += agreement(live.analyse(units), wanted, spectrum.bin_hz / 2.0)
    return total


def _unit_batches(recording: Recording) -> Iterator[FloatArray]:
    """Yield the reference form's band-passed unit sequences, (units, N) at a time."""
    reference = ReferenceTransform(TransformParameters(), recording.samplerate)
    units = reference.cut(recording.frames.astype(np.float64).mean(axis=1))
    for first in range(0, len(units), UNITS_AT_ONCE):
        yield units[first : first + UNITS_AT_ONCE]


def any_split(bench: Workbench) -> Section:
    """Whether the bytes depend on how the sound arrives."""
    first = round(SPLIT_FROM_S * SAMPLERATE)
    sound = demo_sound()[first : first + round(bench.effort.split_s * SAMPLERATE)]
    rng = np.random.default_rng(2)
    rows = []
    for subject in bench.subjects:
        whole = _delivered(subject, sound, [len(sound)])
        splits = [[frames] * (len(sound) // frames + 1) for frames in SPLIT_FRAMES]
        splits += [
            list(rng.integers(0, 3000, size=len(sound) // 500)) for _ in range(RANDOM_SPLITS)
        ]
        differ = sum(differing_blocks(whole, _delivered(subject, sound, split)) for split in splits)
        must = Must("<=", 0) if subject.name == LIVE else None
        name = "splits that change a byte"
        rows.append(Row(name, float(differ), f"of {len(splits)}", subject.name, must))
    return Section(
        "Any split of the sound",
        "A player delivers sound in blocks of any size; the vibration must not depend on it. "
        f"Blocks of {', '.join(str(f) for f in SPLIT_FRAMES)} frames and {RANDOM_SPLITS} random "
        f"splits of {bench.effort.split_s:g} s of the demo scene, against one block.",
        tuple(rows),
    )


def _delivered(subject: Subject, sound: Frames, split: list[int]) -> FloatArray:
    """Return the vibration of a sound that arrives in blocks of these lengths, then the rest."""
    stream = subject.start(SAMPLERATE, sound.shape[1])
    parts = []
    start = 0
    for frames in [*split, len(sound)]:
        parts.append(stream.process(sound[start : start + frames]))
        start = min(len(sound), start + frames)
    parts.append(stream.finish())
    return np.concatenate(parts)
