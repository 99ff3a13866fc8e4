"""Measures how late the vibration of tone bursts is: tools/burst_latency.py [--quantum N ...] ...

The program starts a private sound server and `cushion run`, and plays tone bursts of 150, 440 and
900 Hz. It prints two delays: from the start of a burst until the vibration reaches a tenth of its
peak, and until it reaches half. Sound and vibration are recorded in one stream. The sound is
recorded at an additional sink, which does not drive PipeWire's graph.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from audioflinger_hook.service.status import Status
from device.errors import CushionError, LostError
from tools.live_latency.burst_record import BurstRecord, keep_records, to_json
from tools.live_latency.bursts import REFERENCE, burst_delays
from tools.live_latency.daemon import running_daemon, status_of_daemon
from tools.live_latency.recording import server_name
from tools.live_latency.refusing import refusing_pw_cli
from tools.records import now
from tools.sound_server import ServerError, SoundServer


def main() -> int:
    """Measure and print the delays, and store them with --out. Return 0, or 1 after an error."""
    parser = argparse.ArgumentParser(description="Measure how late bursts are felt on PipeWire.")
    parser.add_argument("--quantum", type=int, nargs="+", default=[1024, 256], metavar="N")
    parser.add_argument("--rate", type=int, nargs="+", default=[48_000], metavar="HZ")
    parser.add_argument("--engine", choices=("native", "python"), nargs="+", default=["native"])
    parser.add_argument(
        "--tap", choices=("streams", "monitor"), nargs="+", default=["streams"],
        help="tap of the native engine; monitor: links from streams are refused",
    )  # fmt: skip
    parser.add_argument("--count", type=int, default=60, metavar="N", help="bursts in each run")
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file of results to update")
    options = parser.parse_args()
    records = []
    try:
        for record in _measured(options):
            records.append(record)
            if options.out:
                keep_records([record], options.out)
            if not options.json:
                print(record.told, flush=True)
    except (CushionError, ServerError) as error:
        print(f"burst_latency: error: {error}", file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps(to_json(records), indent=2))
    return 0


def _measured(options: argparse.Namespace) -> Iterator[BurstRecord]:
    for engine, tap, rate, quantum in product(
        options.engine, options.tap, options.rate, options.quantum
    ):
        with (
            tempfile.TemporaryDirectory(prefix="latency-") as folder,
            SoundServer("pipewire", Path(folder)) as server,
        ):
            server.add_reference(REFERENCE)
            server.set_clock("force-quantum", quantum)
            server.set_clock("force-rate", rate)
            refused = refusing_pw_cli(Path(folder)) if tap == "monitor" else {}
            environment = server.environment | refused
            with running_daemon(
                "haptic", environment, server.folder, arguments=("--engine", engine)
            ):
                yield measured_here(server, quantum, rate, options.count, Path(folder))


def measured_here(
    server: SoundServer, quantum: int, rate: int, count: int, folder: Path
) -> BurstRecord:
    """Return the delays of the vibration that a running daemon makes.

    server: the daemon's sound server, which has the additional sink for recording the sound.

    LostError: no burst caused vibration, the daemon does not answer, or PipeWire failed.
    """
    seen: list[Status | None] = []
    found = burst_delays(
        count,
        rate,
        folder,
        server.environment,
        midway=lambda: seen.append(status_of_daemon(server.environment)),
    )
    status = seen[0]
    if status is None or not found.half_ms.size:
        raise LostError("no burst was felt")
    graph = status.graph
    return BurstRecord(
        server=server_name(server.environment),
        engine=status.engine,
        tap=graph.tap if graph else "monitor",
        quantum_frames=quantum,
        rate_hz=rate,
        date=now(),
        bursts=int(found.half_ms.size),
        tenth_median_ms=float(np.median(found.tenth_ms)),
        tenth_p95_ms=float(np.percentile(found.tenth_ms, 95.0)),
        half_median_ms=float(np.median(found.half_ms)),
        half_p95_ms=float(np.percentile(found.half_ms, 95.0)),
        budget_ms=status.latency.total_ms,
    )


if __name__ == "__main__":
    sys.exit(main())
