"""Sections on fidelity: recordings used, onset lag, audible energy, principal frequencies."""

from __future__ import annotations

from statistics import median

import numpy as np

from audioflinger_hook.transform import FloatArray, Frames, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.principal import PrincipalFinder, Spectrum, magnitude
from audioflinger_hook.transform.reference import ReferenceTransform
from tools.bench.measures.vibration import (
    agreement,
    energy_above_db,
    onset_lag_s,
)
from tools.bench.measures.windows import WindowAnalysis
from tools.bench.report import Missing, Must, Row, Section, line
from tools.bench.sounds.signals import (
    KNOWN,
    RECORDINGS_COMMAND,
    SAMPLERATE,
    SHORTEST_S,
    Recording,
    burst,
    white_noise,
)
from tools.bench.workbench import Subject, Workbench

BURST_HZ = (80.0, 5_000.0)
BURST_AMPLITUDE = 0.3
BURST_ONSET_S, BURST_STREAM_S = 0.3, 0.9
LAG_P95, LAG_P95_LEAD = Must("<=", 45.0), Must("<=", 10.0)

AUDIBLE_FROM_HZ = 250.0
REST_S = 1.0
"""Silence after a sound, in which the vibration comes to rest."""
NOISE_S = 5.0
LEAK, LEAK_RECORDING_LEAD = Must("<=", -50.0), Must("<=", -58.0)

AGREEMENT, AGREEMENT_LEAD = Must(">=", 0.95), Must(">=", 0.99)
UNITS_AT_ONCE = 64
FEWEST_FOR_A_RATIO = 50
"""Recordings with fewer principal frequencies have no precision of their own."""


def recordings(bench: Workbench) -> Section:
    """How many recordings are used, and which are missing."""
    title = "Recordings"
    explanation = (
        f"The {len(KNOWN)} recordings are speech of alsa-utils and sounds of "
        f"sound-theme-freedesktop; those longer than {SHORTEST_S:g} s are used. Where one is "
        "missing, rows on recordings cannot be compared with other runs."
    )
    if not bench.recordings and not bench.absent:
        return Section(title, explanation, (), (bench.missing_recordings("recordings"),))
    command = f"remove its folder, then {RECORDINGS_COMMAND}"
    return Section(
        title,
        explanation,
        (Row("recordings used", float(len(bench.recordings)), column="found"),),
        tuple(Missing(f"recording {name}", why, command) for name, why in bench.absent.items()),
    )


def burst_lag_s(subject: Subject, audio_hz: float, place: float, stream_s: float) -> float:
    """Return the onset lag of one burst; place: of its onset in the analysis window, 0 to 1."""
    onset_s = BURST_ONSET_S + place * TransformParameters().window_s
    sound = burst(audio_hz, BURST_AMPLITUDE, onset_s, stream_s)
    return onset_lag_s(subject.vibration(sound, SAMPLERATE), SAMPLERATE, onset_s)


def onset_lag(bench: Workbench) -> Section:
    """Time from the start of a tone burst to its vibration."""
    effort = bench.effort
    # Onsets at every place of the window: how a burst meets the grid decides its lag.
    places = np.random.default_rng(0).uniform(size=(effort.bursts, effort.onsets_a_burst))
    places = (places + np.arange(effort.onsets_a_burst)) / effort.onsets_a_burst
    bursts_hz = np.geomspace(*BURST_HZ, effort.bursts).tolist()
    lags_ms = {
        subject.name: np.array(
            [
                1e3 * burst_lag_s(subject, audio_hz, place, BURST_STREAM_S)
                for audio_hz, row in zip(bursts_hz, places.tolist(), strict=True)
                for place in row
            ]
        )
        for subject in bench.subjects
    }

    def latencies_ms(name: str) -> dict[str, float | None]:
        streams = {subject.name: subject.start(SAMPLERATE, 1) for subject in bench.subjects}
        return {
            column: 1e3 * getattr(stream, name) / SAMPLERATE for column, stream in streams.items()
        }

    def percentile(share: float) -> dict[str, float | None]:
        return {name: float(np.percentile(lags, share)) for name, lags in lags_ms.items()}

    means: dict[str, float | None] = {name: float(lags.mean()) for name, lags in lags_ms.items()}
    return Section(
        "Onset lag",
        f"How long after a sound starts the cushion follows: {places.size} tone bursts of "
        f"{BURST_HZ[0]:g} to {BURST_HZ[1]:g} Hz, until the vibration's envelope passes half of "
        "its settled level. The lag includes the declared latency, by which sound and picture can "
        "be delayed. Sustained levels and endings follow later.",
        (
            *line("lag, mean", means, "ms"),
            *line("lag, median", percentile(50.0), "ms"),
            *line("lag, 95th percentile", percentile(95.0), "ms", LAG_P95, LAG_P95_LEAD),
            *line("lag, largest", percentile(100.0), "ms"),
            *line("declared latency", latencies_ms("latency_frames"), "ms"),
            *line("sustained levels follow after", latencies_ms("tonal_latency_frames"), "ms"),
        ),
        series={name: tuple(lags.tolist()) for name, lags in lags_ms.items()},
    )


def energy_above(bench: Workbench) -> Section:
    """The vibration's energy at frequencies where a shaker is heard."""
    noise, leaks = {}, {}
    for subject in bench.subjects:
        noise[subject.name] = leak_db(subject, white_noise(NOISE_S), SAMPLERATE)
        leaks[subject.name] = [
            (leak_db(subject, item.frames, item.samplerate), item.name) for item in bench.recordings
        ]
    rows = line("white noise, 0 dBFS", noise, "dB", LEAK)
    missing: tuple[Missing, ...] = ()
    if bench.recordings:
        worst = {name: max(found) for name, found in leaks.items()}
        values: dict[str, float | None] = {name: level for name, (level, _) in worst.items()}
        note = "; ".join(f"{name}: {at}" for name, (_, at) in worst.items())
        rows += line("worst recording", values, "dB", LEAK, LEAK_RECORDING_LEAD, note)
        middle = {name: median(level for level, _ in found) for name, found in leaks.items()}
        rows += line("median recording", dict(middle), "dB")
    else:
        missing = (bench.missing_recordings("energy above 250 Hz, worst recording"),)
    return Section(
        f"Energy above {AUDIBLE_FROM_HZ:g} Hz",
        "A vibration should not be heard. This is the share of its energy above "
        f"{AUDIBLE_FROM_HZ:g} Hz, over {len(bench.recordings)} recordings.",
        tuple(rows),
        missing,
    )


def leak_db(subject: Subject, frames: Frames, samplerate: int) -> float:
    """Return the energy over AUDIBLE_FROM_HZ of a sound's vibration, with silence after it."""
    rest = np.zeros((round(REST_S * samplerate), frames.shape[1]), frames.dtype)
    sound = np.concatenate((frames, rest))
    return energy_above_db(subject.vibration(sound, samplerate), samplerate, AUDIBLE_FROM_HZ)


def principal_frequencies(bench: Workbench) -> Section:
    """How many of the reference form's principal frequencies the live form finds."""
    title = "Principal frequencies"
    explanation = (
        "Both forms analyse the same unit sequences of the recordings. Precision is the share of "
        "the live form's frequencies that the reference form finds too; recall is the reverse. "
        "They agree within half a bin, before the strongest 16 are chosen."
    )
    if not bench.recordings:
        return Section(title, explanation, (), (bench.missing_recordings("precision and recall"),))
    counts = {item.name: _recording_agreement(item) for item in bench.recordings}
    total = np.sum(list(counts.values()), axis=0)
    telling = {name: one for name, one in counts.items() if one[3] >= FEWEST_FOR_A_RATIO}
    rows = []
    for kind, alone, place in (("precision", "live", 0), ("recall", "reference", 2)):
        hits, of = total[place : place + 2].tolist()
        rows += [
            Row(f"{kind}, all recordings", hits / of, must=AGREEMENT, lead=AGREEMENT_LEAD),
            Row(f"found by the {alone} form alone", of - hits, f"of {of:.0f}"),
        ]
        if telling:
            shares = {name: one[place] / one[place + 1] for name, one in telling.items()}
            worst = min(shares, key=lambda name: shares[name])
            rows.append(Row(f"{kind}, worst recording", float(shares[worst]), note=worst))
    return Section(title, explanation, tuple(rows))


def _recording_agreement(recording: Recording) -> FloatArray:
    parameters = TransformParameters()
    live = WindowAnalysis(LiveDesign.of(parameters, recording.samplerate), every=True)
    spectrum = Spectrum.of(parameters, recording.samplerate)
    finder = PrincipalFinder(parameters, spectrum.bin_hz, spectrum.bins)
    total: FloatArray = np.zeros(4)
    reference = ReferenceTransform(parameters, recording.samplerate)
    whole = reference.cut(recording.frames.astype(np.float64).mean(axis=1))
    for first in range(0, len(whole), UNITS_AT_ONCE):
        units = whole[first : first + UNITS_AT_ONCE]
        wanted = finder.all_principal(magnitude(spectrum.transform(units)))
        total += agreement(live(units), wanted, spectrum.bin_hz / 2.0)
    return total
