"""The daemon's status as rows of the page and as metrics for Prometheus."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any

from prometheus_client import CollectorRegistry, core, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily

from audioflinger_hook import __version__
from audioflinger_hook.monitor.clients import Clients
from audioflinger_hook.service.figure import label_of, metrics, table
from audioflinger_hook.service.json_codec import from_document
from audioflinger_hook.service.meters import TIME_BOUNDS_S
from audioflinger_hook.service.status import LatencyBudget, Status, status_rows
from device.errors import UsageError

OTHER = "The page shows figures only if the daemon has the same version."

TONES = ("bad", "wait", "good")  # the first tone has the highest priority


def figures_of(document: dict[str, Any]) -> dict[str, Any]:
    """Return `{"panels": {panel: [[label, text, tone, meaning]]}, "parts": [[name, ms, meaning]]}`.

    A tone is "bad", "wait", "good" or "". If the daemon has another version, one row says so.
    """
    try:
        status = from_document(Status, document)
    except UsageError:
        text = f"daemon {document['version']}, page {__version__}: restart the older one"
        return {"panels": {"health": [["version", text, "bad", OTHER]], "rig": []}, "parts": []}
    panels: dict[str, list[Any]] = {"health": [], "rig": []}
    for row in status_rows(status):
        if row.panel:
            tones = {piece.tone for piece in row.pieces}
            tone = next((tone for tone in TONES if tone in tones), "")
            text = str(row)
            if row.panel == "rig":  # each figure is on a separate line
                parts = (part.replace(", ", "\n", part.startswith(", ")) for part, _ in row.parts)
                text = "".join(parts)
            panels[row.panel].append([row.label.strip(), text, tone, row.help])
    delays = [
        [label_of(name, known), getattr(status.latency, name), known.help]
        for name, known, _ in table(LatencyBudget)
        if name != "total_ms"
    ]
    return {"panels": panels, "parts": delays}


def metrics_text(source: Clients) -> bytes:
    """Return all metrics. Without a daemon, `cushion_up` is 0 and most metrics are omitted."""
    registry = CollectorRegistry()
    registry.register(_Collector(source))
    return generate_latest(registry)


@dataclass(eq=False)
class _Collector:
    source: Clients

    def collect(self) -> Iterator[core.Metric]:
        source, status = self.source, None
        document = source.latest.get("status", {})
        is_up = "version" in document  # a document that is no status has only an error text
        with suppress(UsageError):  # the daemon has another version
            status = from_document(Status, document)
        yield GaugeMetricFamily("cushion_up", "Whether a daemon answers.", float(is_up))
        yield GaugeMetricFamily("cushion_page_clients", "Browsers that are connected.", len(source))
        yield CounterMetricFamily(
            "cushion_page_overwritten_frames", "Frames replaced by newer ones.", source.overwritten
        )
        if is_up:
            build = {"version": str(document["version"]), "page_version": __version__}
            yield core.InfoMetricFamily("cushion_build", "Versions of daemon and page.", build)
        if status is not None:
            yield from _families(status)
            if (times := status.buffer_times).counts:
                # Only the Python engine measures times: the native engine runs inside PipeWire.
                bounds = [*map(repr, TIME_BOUNDS_S), "+Inf"]
                hops = HistogramMetricFamily("cushion_hop_seconds", "Time to compute one buffer.")
                hops.add_metric([], list(zip(bounds, times.counts, strict=True)), times.busy_s)
                yield hops


def _families(status: Status) -> Iterator[core.Metric]:
    found: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
    for entry, value in metrics(status):
        name = entry.figure.metric.partition("{")[0]
        by, own = entry.label
        if name not in found:
            kind = CounterMetricFamily if entry.kind == "count" else GaugeMetricFamily
            # the help of the only figure, or of the group whose figures share the metric
            metric = entry.figure.metric
            is_part = len(entry.path) > 1 and "{" in metric and "{^" not in metric
            text = entry.group.__doc__.partition("\n")[0] if is_part else f"{entry.figure.help}."
            text = text[0].upper() + text[1:]
            found[name] = kind(name, text, labels=[by] if by else [])
        samples = {own: value}
        if entry.figure.words:
            now = value.value if isinstance(value, Enum) else value
            samples = {word: word == now for word in entry.figure.words}
        elif isinstance(value, Mapping):
            samples = {key.value: count for key, count in value.items()}
        for word, number in samples.items():
            found[name].add_metric([word] if by else [], entry.base(number))
    yield from found.values()
