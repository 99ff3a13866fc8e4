"""The daemon's figures in the text format of Prometheus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)

from audioflinger_hook import __version__
from audioflinger_hook.monitor.clients import Clients
from audioflinger_hook.service.figure import Entry, metrics
from audioflinger_hook.service.json_codec import from_document
from audioflinger_hook.service.meters import TIME_BOUNDS_S, BufferTimes
from audioflinger_hook.service.status import Status
from device.errors import UsageError

CONTENT_TYPE = CONTENT_TYPE_LATEST


def metrics_text(source: Clients) -> bytes:
    """Return all metrics; without a daemon's status, `cushion_up` is 0 and the rest left out."""
    registry = CollectorRegistry()
    registry.register(_Collector(source))
    return generate_latest(registry)


@dataclass(eq=False)
class _Collector:
    source: Clients

    def collect(self) -> Iterator[Metric]:
        source, status = self.source, None
        document = source.latest.get("status", {})
        is_up = "version" in document  # else it says why there is no status
        with suppress(UsageError):  # of a daemon of another version
            status = from_document(Status, document)
        yield GaugeMetricFamily("cushion_up", "Whether a daemon answers.", float(is_up))
        yield GaugeMetricFamily("cushion_page_clients", "Browsers that are connected.", len(source))
        yield CounterMetricFamily(
            "cushion_page_overwritten_frames", "Frames replaced by newer ones.", source.overwritten
        )
        if is_up:
            build = {"version": str(document["version"]), "page_version": __version__}
            yield InfoMetricFamily("cushion_build", "Versions of daemon and page.", build)
        if status is not None:
            yield from _families(status)
            if status.buffer_times.counts:
                yield _histogram(status.buffer_times)


def _families(status: Status) -> Iterator[Metric]:
    """Yield what the table of figures has a metric for, samples of one metric together."""
    found: dict[str, CounterMetricFamily | GaugeMetricFamily] = {}
    for entry, value in metrics(status):
        name = entry.figure.metric.partition("{")[0]
        by, own = entry.label
        if name not in found:
            kind = CounterMetricFamily if entry.kind == "count" else GaugeMetricFamily
            found[name] = kind(name, _meaning(entry), labels=[by] if by else [])
        samples = {own: value}
        if entry.figure.words:
            now = value.value if isinstance(value, Enum) else value
            samples = {word: word == now for word in entry.figure.words}
        elif isinstance(value, Mapping):
            samples = {key.value: count for key, count in value.items()}
        for word, number in samples.items():
            found[name].add_metric([word] if by else [], entry.base(number))
    yield from found.values()


def _meaning(entry: Entry) -> str:
    """Return the metric's help: that of the group, where its label tells the figures apart."""
    is_part = len(entry.path) > 1 and "{" in entry.figure.metric and "{^" not in entry.figure.metric
    text = entry.group.__doc__.partition("\n")[0] if is_part else f"{entry.figure.help}."
    return f"{text[0].upper()}{text[1:]}"


def _histogram(times: BufferTimes) -> Metric:
    # Of the Python engine; the native one runs inside PipeWire, which has figures of its own.
    bounds = [*map(repr, TIME_BOUNDS_S), "+Inf"]
    hops = HistogramMetricFamily("cushion_hop_seconds", "Time to compute one buffer.")
    hops.add_metric([], list(zip(bounds, times.counts, strict=True)), times.busy_s)
    return hops
