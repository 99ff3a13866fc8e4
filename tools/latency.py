"""Measures live latency: tools/latency.py [--kind pulse|pipewire|both] [--seconds S] ...

The program starts a separate sound server (tools/sound_server.py) and `cushion run`, and plays a
sound whose level varies irregularly. It records sound and vibration simultaneously, and prints the
delay of the vibration, including the latency of the transform.

With --here, the tool measures the daemon that runs on this desktop, with the sound of the programs
that play. With such sound, the result is accurate to a few milliseconds. With --play, the tool also
plays its own sound; the result is then as accurate as on a separate server.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import product
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from audioflinger_hook.cli.terminal import progress_bar
from audioflinger_hook.config import file as config
from audioflinger_hook.config.profiles import LIVE_DEFAULT
from audioflinger_hook.config.settings import Settings
from device.errors import CushionError, NotFoundError
from tools.bench.sections.kept_records import USUAL_BLOCK_FRAMES
from tools.bench.sounds.signals import stereo
from tools.live_latency.bursts import REFERENCE, GraphOnce
from tools.live_latency.daemon import running_daemon, status_of_daemon
from tools.live_latency.lag import swelling_tone
from tools.live_latency.measurement import WINDOW_S, Place, measure
from tools.live_latency.record import LiveRecord, keep_records, to_json
from tools.live_latency.recording import PLAYER, playing, samplerate_of
from tools.sound_server import PROGRAMS, ServerError, SoundServer

LOOP_S = 60.0
MONITOR = ".monitor"
DEFAULT = Settings(profile=LIVE_DEFAULT)  # settings of a daemon without a config file


def main() -> int:
    """Measure and print the latencies, and store them with --out. Return the exit code.

    The exit code is 1 after an error, or if a result is missing or unreliable.
    """
    options = _parse()
    try:
        records = []
        for record in _here(options) if options.here else _on_servers(options):
            records.append(record)
            if options.out:
                keep_records([record], options.out)
            if not options.json:
                print(_told(record), flush=True)
        if options.json:
            print(json.dumps(to_json(records), indent=2))
    except (CushionError, ServerError) as error:
        print(f"latency: error: {error}", file=sys.stderr)
        return 1
    return (
        0 if all(record.trusted and record.lag_median_ms is not None for record in records) else 1
    )


def _parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description="Measure by how much live vibration comes after its sound.", allow_abbrev=False
    )
    parser.add_argument("--kind", choices=(*sorted(PROGRAMS), "both"), default="both")
    parser.add_argument("--seconds", type=float, default=30.0, metavar="S", help="default: 30")
    parser.add_argument(
        "--block-frames",
        type=int,
        nargs="+",
        default=[USUAL_BLOCK_FRAMES],
        metavar="N",
        help=f"block of the daemon's streams in frames; default: {USUAL_BLOCK_FRAMES}",
    )
    parser.add_argument(
        "--engine",
        choices=("native", "python"),
        nargs="+",
        default=["python"],
        help="engine of the daemon, one run each; native: on PipeWire only; default: python",
    )
    parser.add_argument(
        "--quantum",
        type=int,
        nargs="+",
        default=[None],
        metavar="N",
        help="cycle of PipeWire's graph in frames, one run each; default: PipeWire's choice",
    )
    parser.add_argument("--hz", type=float, default=145.0, help="tone frequency; default: 145")
    parser.add_argument("--here", action="store_true", help="measure this desktop's daemon")
    parser.add_argument("--play", action="store_true", help="with --here: also play the tone")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file of results to update")
    options = parser.parse_args()
    if not WINDOW_S <= options.seconds <= 86_400.0:
        parser.error(f"--seconds {options.seconds:g}: {WINDOW_S:g} to 86400 are possible")
    if not 60.0 <= options.hz <= 10_000.0:
        parser.error(f"--hz {options.hz:g}: 60 to 10000 are possible")
    return options


def _on_servers(options: argparse.Namespace) -> Iterator[LiveRecord]:
    kinds = sorted(PROGRAMS) if options.kind == "both" else [options.kind]
    for kind in kinds:
        for engine, quantum, block_frames in product(
            options.engine, options.quantum, options.block_frames
        ):
            if kind == "pulse" and (engine == "native" or quantum is not None):
                continue
            with (
                tempfile.TemporaryDirectory(prefix="latency-") as folder,
                SoundServer(kind, Path(folder)) as server,
            ):
                if quantum is not None:
                    _force_quantum(server, quantum)
                yield on_server(server, options, block_frames, engine, quantum)


def on_server(
    server: SoundServer,
    options: argparse.Namespace,
    block_frames: int,
    engine: str = "python",
    quantum: int | None = None,
) -> LiveRecord:
    """Start a daemon on this server and return its measured latency."""
    heard = "desktop"
    if server.kind == "pipewire":
        # The monitor of a sink that drives the graph is a cycle late.
        heard = REFERENCE
        server.add_reference(REFERENCE)
    place = Place(heard + MONITOR, "haptic" + MONITOR, server.environment)
    asked = None if block_frames == USUAL_BLOCK_FRAMES else block_frames
    with (
        _tone(place, options.hz, "desktop"),
        running_daemon(
            "haptic",
            server.environment,
            server.folder,
            block_frames=asked,
            arguments=("--engine", engine),
        ),
    ):
        frames = None if engine == "native" else block_frames  # the native engine has no block size
        return _measured(place, options, DEFAULT, frames, _name(options.hz), quantum)


def _force_quantum(server: SoundServer, quantum: int) -> None:
    command = ["pw-metadata", "-n", "settings", "0", "clock.force-quantum", str(quantum)]
    done = subprocess.run(command, env=server.environment, capture_output=True, text=True)
    if done.returncode:
        raise ServerError(f"{' '.join(command)}: {done.stderr.strip()}")


def _here(options: argparse.Namespace) -> Iterator[LiveRecord]:
    environment = dict(os.environ)
    status = status_of_daemon(environment)
    if status is None or status.tap.name is None or status.device.name is None:
        raise NotFoundError("no daemon plays here; start one with `cushion run`")
    place = Place(status.tap.name, status.device.name + MONITOR, environment)
    path = config.default_path()
    settings = config.load(path).settings if path.exists() else DEFAULT
    settings = settings.choosing(profile=status.profile)
    with _tone(place, options.hz) if options.play else nullcontext():
        name = _name(options.hz) if options.play else "whatever played"
        yield _measured(place, options, settings, None, name)


@contextmanager
def _tone(place: Place, hertz: float, sink: str = "") -> Iterator[None]:
    """A context that plays a tone to `sink`, and to the recorded sink if that is another sink."""
    rate = samplerate_of(place.heard, place.environment)
    heard = place.heard.removesuffix(MONITOR)
    sound = stereo(swelling_tone(hertz, LOOP_S, rate))
    with playing(sink or heard, sound, rate, place.environment):
        if sink not in ("", heard):
            graph = GraphOnce(place.environment)
            inputs = graph.ports(heard, "playback_")
            for channel, port in graph.ports(PLAYER, "output_").items():
                graph.link(port, inputs[channel])
        yield


def _name(hertz: float) -> str:
    return f"a tone of {hertz:g} Hz that swells irregularly"


def _measured(
    place: Place,
    options: argparse.Namespace,
    settings: Settings,
    block_frames: int | None,
    stimulus: str,
    quantum: int | None = None,
) -> LiveRecord:
    with progress_bar("latency") as advance:
        return measure(
            place,
            options.seconds,
            settings=settings,
            block_frames=block_frames,
            quantum_frames=quantum,
            stimulus=stimulus,
            progress=advance,
        )


def _told(record: LiveRecord) -> str:

    def ms(value: float | None, sign: str = "") -> str:
        return "-" if value is None else f"{value:{sign}.2f} ms"

    lines = [
        f"{record.name}: {record.seconds:.0f} s of {record.stimulus}, load "
        f"{record.load_before:.1f} to {record.load_after:.1f}",
        "  from      lag   the daemon says",
    ]
    for index, (lag_ms, budget_ms) in enumerate(
        zip(record.lags_ms, record.budgets_ms, strict=True)
    ):
        lines.append(f"{index * record.window_s:4.0f} s {ms(lag_ms):>12} {ms(budget_ms):>12}")
    lines += [
        f"  lag: median {ms(record.lag_median_ms)}, 5 % under {ms(record.lag_p5_ms)}, 95 % under "
        f"{ms(record.lag_p95_ms)}, {ms(record.growth_ms, '+')} over the run, "
        f"{ms(record.hidden_growth_ms, '+')} of which the daemon does not report",
        f"  the daemon: {ms(record.budget_ms)} in all, of it transform {ms(record.transform_ms)}, "
        f"delay line {ms(record.delay_ms)} (target {ms(record.target_ms)}); {record.resyncs} "
        f"resyncs, {record.underflows} underflows, {record.overflows} overflows, "
        f"{record.recoveries} recoveries",
        f"  it used {record.cpu_percent or 0.0:.1f} % of a core, its memory grew by "
        f"{record.memory_growth_kb or 0.0:+.0f} kB; the native engine's process used "
        f"{record.child_cpu_percent or 0.0:.2f} %, {record.child_memory_growth_kb or 0.0:+.0f} kB",
        f"  dropouts: {record.dropouts}, {record.dropout_ms:.1f} ms; splices in the recordings: "
        f"{record.splices}; the machine stood still {record.machine_pauses or 0} times, for up to "
        f"{record.machine_pause_ms or 0.0:.0f} ms",
        f"  self-check: one monitor recorded twice differs by {ms(record.check_median_ms, '+')}, "
        f"at worst {ms(record.check_worst_ms, '+')}: "
        + ("as it should" if record.trusted else "NOT TO BE TRUSTED"),
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
