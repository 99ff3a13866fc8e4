"""Puts figures of the benchmarks into sentences of the docs."""

import json
import re
from collections.abc import Mapping
from math import ceil, floor
from pathlib import Path
from typing import Any

from tools.docs.results import ROOT

NAME = re.compile(r"{\w+}")
NUMBER = r"(-?\d+(?:\.\d+)?)"
NATIVE = r"PipeWire [\d.]+, native, .*"
PYTHON = r"\w+ [\d.]+,( quantum \d+,)? 512 frames"
LOST = "sounds not felt at all"
EXPLOSIONS = "film: explosions over dialogue"
IMPACTS = "impacts over music that add .*"

SENTENCES = {
    "README.md": (
        "The vibration of a 4.2 kHz tone has a level of {high_tone_db} dB relative to the tone",
        "the level of explosions is {explosions_db} dB above that of dialogue in the vibration, "
        "and {heard_db} dB in the sound.",
        "With `cinema`, {lost} of {sounds} recorded sounds are without vibration",
        "reaches half of its peak {burst_ms} ms after the start of the burst (median). "
        "For 95 % of bursts, this time is at most {burst_p95_ms} ms",
        "takes {cpu_least} to {cpu_most} % of a processor core",
        "On PulseAudio, the delay is [about {pulse_ms} ms]",
        "distortion and noise under {thdn_db} dB",
        "is under {above_250_db} dB for each of {recordings} recordings",
        "#residual-vibration) by {damped_db} dB",
        "The vibration rises by at least 1.5 dB at {impacts} % of impacts over music",
    ),
    "docs/results.md": ("`game` and `music`, the delay is up to {later_ms} ms longer",),
    "docs/live.md": (
        "reaches half of its peak {burst_ms} ms after the start of the burst (median). "
        "For 95 % of bursts, this time is at most {burst_p95_ms} ms",
        "The native engine takes {cpu_least} to {cpu_most} % of a core.",
        "then reaches half of its peak {monitor_ms} ms after the burst begins",
        "its vibration lags {python_least_ms} to {python_most_ms} ms behind the sound, "
        "and the engine takes {python_cpu_least} to {python_cpu_most} % of a core",
        "vibration comes about {pulse_ms} ms after its sound on PulseAudio, "
        "and {pipewire_ms} ms on PipeWire",
        "delays onsets by {cinema_ms} ms (`paper`: {paper_ms}, `game`: {game_ms})",
        "changes of sustained sound by {sustained_ms} ms",
    ),
    "docs/plugin.md": (
        "({cinema_ms} ms with `cinema`, {paper_ms} with `paper`, {game_ms} with `game`)",
    ),
    "docs/transform.md": (
        "latency of onsets, {latency_ms} ms",
        "`tonal_latency_frames`, {sustained_ms} ms",
    ),
    "docs/exports.md": ("files of {sounds} sounds of eight classes",),
    "docs/catalogue.md": (
        "one core renders {hours_of_seconds} hours of sound in clips of a second, "
        "or {hours_of_minutes} hours in files of a minute",
        "of a finished item takes {done_ms} ms",
        "{memory_1_mb} MB for a minute, {memory_10_mb} MB for ten minutes of sound",
    ),
    "docs/get-started/films.md": (
        "reaches half of its peak {burst_ms} ms after the start of the burst",
        "On PulseAudio, the delay is about {pulse_ms} ms",
    ),
    "docs/get-started/gamer.md": (
        "With the profile `game` on PipeWire, the vibration follows {game_ms} ms after its sound",
    ),
}


class Benchmarks:
    """Values of docs/benchmarks.json, or of another file of the same format."""

    def __init__(self, path: Path = ROOT / "docs/benchmarks.json") -> None:
        document = json.loads(path.read_text())
        self._rows = {section["title"]: section["rows"] for section in document["sections"]}

    def rows(self, section: str, row: str, column: str) -> list[dict[str, Any]]:
        """Return the rows of a column whose names match `row`. LookupError: there are none."""
        found = [
            each
            for each in self._rows[section]
            if each["column"] == column and re.fullmatch(row, each["name"])
        ]
        if not found:
            raise LookupError(f"the benchmarks have no {row!r}, {column!r} in {section!r}")
        return found

    def all(self, section: str, row: str, column: str) -> list[float]:
        """Return the values of the rows that `rows` finds."""
        return [float(each["value"]) for each in self.rows(section, row, column)]

    def one(self, section: str, row: str, column: str = "live") -> float:
        """Return the value of the single matching row."""
        [value] = self.all(section, row, column)
        return value


def figures(found: Benchmarks) -> dict[str, str]:
    """Return the figures for the sentences by name, as text, rounded as in the docs."""
    native = found.all("Live latency", NATIVE, "CPU of the native engine")
    python = found.all("Live latency", PYTHON, "lag")
    paper, cinema, game = (
        found.one("Profiles", "latency", name) for name in ("paper", "cinema", "game")
    )
    lag = found.one("Live latency", r"PipeWire [\d.]+, native, quantum 256", "lag") - cinema
    bursts = "Live bursts"
    streams, monitor = r".*, native, streams, .*", r".*, native, monitor, 1024 frames at 48000 Hz"
    pulse, pipewire = (
        found.one("Live latency", rf"{server} [\d.]+, 512 frames", "lag")
        for server in ("PulseAudio", "PipeWire")
    )
    undamped, damped = (
        found.one("Residual vibration", f"voltage drive{how}", "exact")
        for how in ("", ", automatic")
    )
    numbers = {
        "high_tone_db": round(found.one("Baselines", "4.2 kHz, level .*"), 1),
        "explosions_db": round(found.one("On real sounds", EXPLOSIONS, "cinema"), 1),
        "heard_db": round(found.one("On real sounds", EXPLOSIONS, "sound"), 1),
        "impacts": round(found.one("On real sounds", IMPACTS, "cinema")),
        "lost": found.one("On real sounds", LOST, "cinema"),
        "sounds": int(found.rows("On real sounds", LOST, "cinema")[0]["unit"].removeprefix("of ")),
        "recordings": found.one("Recordings", "recordings used", "found"),
        "thdn_db": ceil(found.one("Steady tones", r"worst THD\+N, 150 .*")),
        "above_250_db": ceil(found.one("Energy above 250 Hz", "worst recording")),
        "damped_db": round(undamped - damped, 1),
        "paper_ms": round(paper + lag),
        "cinema_ms": round(cinema + lag),
        "burst_ms": round(max(found.all(bursts, streams, "to half, median")), 1),
        "burst_p95_ms": round(max(found.all(bursts, streams, "to half, 95 % under")), 1),
        "monitor_ms": round(max(found.all(bursts, monitor, "to half, median")), 1),
        "game_ms": round(game + lag),
        "later_ms": round(max(cinema, game) - paper, 1),
        "latency_ms": round(found.one("Onset lag", "declared latency"), 1),
        "sustained_ms": round(found.one("Onset lag", "sustained levels follow after"), 1),
        "pulse_ms": round(pulse),
        "pipewire_ms": round(pipewire),
        "python_least_ms": floor(min(python)),
        "python_most_ms": ceil(max(python)),
        "python_cpu_most": round(max(found.all("Live latency", PYTHON, "CPU")), 1),
        "python_cpu_least": round(min(found.all("Live latency", PYTHON, "CPU")), 1),
        "cpu_least": floor(10 * min(native)) / 10,
        "cpu_most": ceil(10 * max(native)) / 10,
        "hours_of_seconds": found.one("Catalogue", "1 s", "wav"),
        "hours_of_minutes": found.one("Catalogue", "1 min", "wav"),
        "done_ms": round(found.one("Catalogue", "a done item", "CPU time"), 2),
        "memory_1_mb": round(found.one("Rendering a file", "1 min", "peak memory")),
        "memory_10_mb": round(found.one("Rendering a file", "10 min", "peak memory")),
    }
    return {name: f"{value:g}" for name, value in numbers.items()}


def corrected(page: str, text: str, sentences: tuple[str, ...], numbers: Mapping[str, str]) -> str:
    """Return the text of a page with new numbers in the sentences, which may span several lines.

    ValueError: a sentence does not occur exactly once.
    """
    for sentence in sentences:
        names = [name[1:-1] for name in NAME.findall(sentence)]
        pieces = [r"\s+".join(map(re.escape, piece.split(" "))) for piece in NAME.split(sentence)]
        found = [*re.finditer(NUMBER.join(pieces), text)]
        if len(found) != 1:
            raise ValueError(f"{page} says {sentence!r} {len(found)} times; say it there once")
        for place in range(len(names), 0, -1):
            begin, end = found[0].span(place)
            text = text[:begin] + numbers[names[place - 1]] + text[end:]
    return text
