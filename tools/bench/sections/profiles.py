"""Section on profiles: what each changes, by measures on the same sounds."""

from __future__ import annotations

import numpy as np

from audioflinger_hook.config.profiles import PROFILES, parameters_of
from audioflinger_hook.transform import FloatArray, HapticTransform, TransformParameters
from audioflinger_hook.transform.mapping import vibration_hz
from device.rig import CONSUMER, PAPER, Rig
from device.rig.simulated_rig import SimulatedRig
from tools.bench.measures.similarity import envelope_correlation, felt_spectrum
from tools.bench.report import Row, Section
from tools.bench.sections.fidelity import BURST_HZ, BURST_ONSET_S, burst_lag_s
from tools.bench.sections.levels import Way, sounds_of, units_db
from tools.bench.sounds.signals import SAMPLERATE, stereo
from tools.bench.workbench import Playback, Workbench, cost_rows, timed

TITLE = "Profiles"
BURSTS = 9
BURST_STREAM_S = 0.8
OCTAVES_HZ = (20.0, 40.0, 80.0, 160.0, 250.0)
BLOCKSIZE = 256
COST_S = 2.0
RIGS = (PAPER, CONSUMER)
AUDIBLE_DB = -60.0

OTHER_MAPPING = "music, jnd"
"""No profile: `music` with equal JNDs an octave in place of equation (4)."""

LATENCY, LAG = "latency", "onset lag, mean"
CORRELATION = "envelope correlation, median sound"
RANGE = "range of speech, median to loudest twentieth"
STEP = "smallest step of an octave"
COST = "cost of a second of speech, blocks of 256"


def profiles(bench: Workbench) -> Section:
    """Lag, similarity, range, octaves and cost of every profile."""
    ways = [Way(name, parameters_of(name)) for name in PROFILES]
    ways.append(Way(OTHER_MAPPING, parameters_of("music", {"mapping": "jnd"})))
    sounds = sounds_of(bench.recordings)
    rows: list[Row] = []
    for way in ways:
        delay_ms = 1e3 * HapticTransform(SAMPLERATE, 1, way.parameters).latency_s
        rows += [
            Row(LATENCY, delay_ms, "ms", way.name),
            Row(LAG, _mean_lag_ms(way), "ms", way.name),
        ]
        felt = {name: way.settled(sound, bench.effort.settled_s) for name, sound in sounds.items()}
        alike = [
            envelope_correlation(sound, felt[name], SAMPLERATE) for name, sound in sounds.items()
        ]
        rows.append(Row(CORRELATION, float(np.median(alike)), "", way.name))
        rows.append(Row(RANGE, _range_db(felt["speech"]), "dB", way.name))
        rows += _octave_rows(way, felt)
        for rig in RIGS:
            moved = _moved_m_s2(rig, felt["chord"])
            rows.append(Row(f"acceleration on the {rig.name} rig", moved, "m/s²", way.name))
        rows.append(Row(STEP, _smallest_step_percent(way.parameters), "%", way.name))
    rows.append(Row(RANGE, _range_db(sounds["speech"]), "dB", "in"))
    rows += _cost_rows(ways, sounds["speech"], bench)
    reasons = "; ".join(
        f"*{name}*: "
        + ", ".join(f"`{key}` {said.value} ({said.reason})" for key, said in choices.items())
        for name, choices in PROFILES.items()
        if choices
    )
    return Section(
        TITLE,
        "Measures on the sounds of the section above. Lag: until the vibration of a tone burst "
        "passes half of its level, latency included. Envelope correlation: how the levels of sound "
        "and vibration vary together, whatever their range. Range: of the 46 ms units of speech. "
        "Energy: share of each octave of vibration, median sound; a small shaker does little under "
        "40 Hz. Smallest step: the least rise of the vibration's frequency for an octave of sound; "
        "people feel differences from about 35 %. Acceleration: r.m.s. of the chord on the "
        f'simulated rigs. *{OTHER_MAPPING}* is `music` with `mapping = "jnd"`.',
        tuple(rows),
        footnote=f"Values and their reasons: {reasons}.",
    )


def _mean_lag_ms(way: Way) -> float:
    places = np.random.default_rng(4).permutation(BURSTS) / BURSTS
    bursts_hz = np.geomspace(*BURST_HZ, BURSTS).tolist()
    return 1e3 * float(
        np.mean(
            [
                burst_lag_s(way.subject, audio_hz, place, BURST_ONSET_S + BURST_STREAM_S)
                for audio_hz, place in zip(bursts_hz, places.tolist(), strict=True)
            ]
        )
    )


def _range_db(signal: FloatArray) -> float:
    levels = units_db(signal)
    audible = levels[levels > AUDIBLE_DB]
    return float(np.percentile(audible, 95) - np.percentile(audible, 50))


def _octave_rows(way: Way, felt: dict[str, FloatArray]) -> list[Row]:
    shares = []
    for vibration in felt.values():
        hz, power = felt_spectrum(vibration, SAMPLERATE)
        by_octave = np.histogram(hz, OCTAVES_HZ, weights=power)[0]
        shares.append(100.0 * by_octave / by_octave.sum())
    return [
        Row(f"energy at {low:g} to {high:g} Hz", float(share), "%", way.name)
        for low, high, share in zip(
            OCTAVES_HZ[:-1], OCTAVES_HZ[1:], np.median(shares, axis=0), strict=True
        )
    ]


def _moved_m_s2(rig: Rig, vibration: FloatArray) -> float:
    simulated = SimulatedRig(rig, SAMPLERATE, 1)
    simulated.write(vibration[:, None].astype(np.float32))
    return float(np.sqrt(np.mean(simulated.acceleration_m_s2**2)))


def _smallest_step_percent(parameters: TransformParameters) -> float:
    low_hz = np.geomspace(parameters.band_low_hz, parameters.band_high_hz / 2.0, 100)
    ratio = vibration_hz(2.0 * low_hz, parameters) / vibration_hz(low_hz, parameters)
    return 100.0 * float(ratio.min() - 1.0)


def _cost_rows(ways: list[Way], sound: FloatArray, bench: Workbench) -> list[Row]:
    once = stereo(np.resize(sound, round(COST_S * SAMPLERATE)))
    playbacks = [Playback(way.subject, once, BLOCKSIZE) for way in ways]
    rows: list[Row] = []
    for way, timing in zip(ways, timed(playbacks, bench.effort.cost_repeats), strict=True):
        rows += cost_rows(COST, way.name, timing, COST_S)[:1]
    return rows
