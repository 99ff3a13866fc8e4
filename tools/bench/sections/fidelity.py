"""Sections on recordings, onset lag, audible energy and principal frequencies."""

from __future__ import annotations

from statistics import median

import numpy as np

from audioflinger_hook.transform import FloatArray, Frames, TransformParameters
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.principal import PrincipalFinder, Spectrum, magnitude
from audioflinger_hook.transform.reference import ReferenceTransform
from tools.bench.measures.vibration import agreement, energy_above_db, onset_lag_s
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
REST_S = 1.0  # silence in s after a sound, for the decay of the vibration
NOISE_S = 5.0
LEAK, LEAK_RECORDING_LEAD = Must("<=", -50.0), Must("<=", -58.0)

AGREEMENT, AGREEMENT_LEAD = Must(">=", 0.95), Must(">=", 0.99)
UNITS_AT_ONCE = 64
FEWEST_FOR_A_RATIO = 50  # recordings with fewer principal frequencies get no separate ratio


def recordings(bench: Workbench) -> Section:
    """Return the section that shows the number of used recordings and the missing recordings."""
    title = "Recordings"
    explanation = (
        f"The {len(KNOWN)} recordings are speech from the package alsa-utils and sounds from the "
        f"package sound-theme-freedesktop. Only recordings longer than {SHORTEST_S:g} s are used. "
        "If a recording is missing, results for recordings are not comparable with those of other "
        "runs."
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
    """Return the delay in s from the start of a tone burst to its vibration.

    place: additional delay of the burst, as a share of the analysis window, 0 to 1.
    stream_s: duration of the whole signal in s.
    """
    onset_s = BURST_ONSET_S + place * TransformParameters().window_s
    sound = burst(audio_hz, BURST_AMPLITUDE, onset_s, stream_s)
    return onset_lag_s(subject.vibration(sound, SAMPLERATE), SAMPLERATE, onset_s)


def onset_lag(bench: Workbench) -> Section:
    """Measure the delay from the start of a tone burst to its vibration."""
    effort = bench.effort
    # Onsets are placed at all positions in the window, since the position determines the lag.
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
        "The lag is the delay from the start of a sound until the vibration's envelope passes "
        f"half of its settled level. The sounds are {places.size} tone bursts of {BURST_HZ[0]:g} "
        f"to {BURST_HZ[1]:g} Hz. The lag includes the latency that the transform declares "
        "(`latency_frames`). When a sustained level changes or a sound ends, the vibration "
        "follows with a longer delay, which the last row shows.",
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
    """Measure the energy of the vibration above 250 Hz, where an actuator is audible."""
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
        f"Vibration above {AUDIBLE_FROM_HZ:g} Hz is audible. The table shows the energy of the "
        "vibration above this frequency, relative to the total energy of the vibration, for white "
        f"noise and {len(bench.recordings)} recordings.",
        tuple(rows),
        missing,
    )


def leak_db(subject: Subject, frames: Frames, samplerate: int) -> float:
    """Return the energy of the vibration above 250 Hz in dB relative to its total energy.

    The vibration includes its decay in 1 s of silence after the sound.
    """
    rest = np.zeros((round(REST_S * samplerate), frames.shape[1]), frames.dtype)
    sound = np.concatenate((frames, rest))
    return energy_above_db(subject.vibration(sound, samplerate), samplerate, AUDIBLE_FROM_HZ)


def principal_frequencies(bench: Workbench) -> Section:
    """Measure how well the principal frequencies of the live and the reference form agree."""
    title = "Principal frequencies"
    explanation = (
        "Both forms analyse the same windows of the recordings. Precision is the share of the "
        "live form's principal frequencies that the reference form finds too. Recall is the share "
        "of the reference form's principal frequencies that the live form finds. Two frequencies "
        "are counted as equal if they differ by at most half a bin of the FFT. All principal "
        "frequencies count, not only the strongest 16."
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
