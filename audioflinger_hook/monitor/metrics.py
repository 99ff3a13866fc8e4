"""The daemon's figures in the text format of Prometheus."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)

from audioflinger_hook import __version__
from audioflinger_hook.service.meters import TIME_BOUNDS_S
from audioflinger_hook.service.state import DaemonState

CONTENT_TYPE = CONTENT_TYPE_LATEST

PARTS = ("tap", "transform", "driving", "delay_line", "delay", "output", "offset")


class Source(Protocol):
    """What the page knows: the daemon's latest messages by kind, and its own counts."""

    latest: dict[str, dict[str, Any]]

    def __len__(self) -> int: ...

    @property
    def overwritten(self) -> int:
        """Frames that slow browsers did not get."""
        ...


def metrics_text(source: Source) -> bytes:
    """Return all metrics; without a daemon's status, `cushion_up` is 0 and the rest left out."""
    registry = CollectorRegistry()
    registry.register(_Collector(source))
    return generate_latest(registry)


class _Collector:
    def __init__(self, source: Source) -> None:
        self._source = source

    def collect(self) -> Iterator[Metric]:
        source = self._source
        status = source.latest.get("status")
        if status is not None and "error" in status:  # it could not be told
            status = None
        yield _gauge("cushion_up", "Whether a daemon answers.", float(status is not None))
        yield _gauge("cushion_page_clients", "Browsers that are connected.", len(source))
        yield _counter(
            "cushion_page_overwritten_frames", "Frames replaced by newer ones.", source.overwritten
        )
        if status is not None:
            yield from _of_status(status)


def _of_status(status: Mapping[str, Any]) -> Iterator[Metric]:
    build = {"version": status["version"], "page_version": __version__}
    yield InfoMetricFamily("cushion_build", "Versions of daemon and page.", build)
    state = GaugeMetricFamily("cushion_state", "1 for the daemon's state.", labels=["state"])
    for one in DaemonState:
        state.add_metric([one.value], float(status["state"] == one.value))
    yield state
    engine = GaugeMetricFamily("cushion_engine", "1 for the engine that plays.", labels=["engine"])
    for name in ("native", "python"):
        engine.add_metric([name], float(status["engine"] == name))
    yield engine
    latency = status["latency"]
    total = latency["total_ms"]
    yield _gauge("cushion_delay_seconds", "Vibration behind its sound.", 1e-3 * total)
    parts = GaugeMetricFamily("cushion_delay_part_seconds", "Parts of the delay.", labels=["part"])
    for part in PARTS:
        parts.add_metric([part], 1e-3 * latency[f"{part}_ms"])
    yield parts
    yield from _of_streams(status)
    yield from _of_levels(status)
    yield from _of_rig(status)
    recoveries = CounterMetricFamily(
        "cushion_recoveries", "What was lost and came back, by cause.", labels=["cause"]
    )
    for cause, count in status["recoveries"].items():
        recoveries.add_metric([cause], count)
    yield recoveries


def _of_streams(status: Mapping[str, Any]) -> Iterator[Metric]:
    line, times = status["delay_line"], status["buffer_times"]
    xruns = CounterMetricFamily("cushion_xruns", "Late or lost buffers.", labels=["stream"])
    for stream in ("tap", "output"):
        if status["xruns"][stream] is not None:
            xruns.add_metric([stream], status["xruns"][stream])
    yield xruns
    yield _counter("cushion_underruns", "Frames that the delay line lacked.", line["underflows"])
    yield _counter("cushion_resyncs", "Restarts of the delay line.", line["resyncs"])
    yield _counter(
        "cushion_late_callbacks", "Buffers that took longer to compute than to play.", times["late"]
    )
    ratio = 1.0 + 1e-6 * line["ratio_ppm"]
    yield _gauge("cushion_clock_ratio", "Output's clock over the tap's, as measured.", ratio)
    if times["counts"]:
        bounds = [*map(repr, TIME_BOUNDS_S), "+Inf"]
        buckets = list(zip(bounds, times["counts"], strict=True))
        # Of the Python engine; the native one runs inside PipeWire, which has figures of its own.
        hops = HistogramMetricFamily("cushion_hop_seconds", "Time to compute one buffer.")
        hops.add_metric([], buckets, times["busy_s"])
        yield hops
    yield _counter("cushion_limited_samples", "Samples limited.", status["limited_samples"])
    yield _counter("cushion_replaced_samples", "Unusable samples.", status["replaced_samples"])


def _of_levels(status: Mapping[str, Any]) -> Iterator[Metric]:
    for kind, unit in (("peak", "Peak"), ("rms", "RMS")):
        level = GaugeMetricFamily(
            f"cushion_level_{kind}_ratio", f"{unit}, 1 for full scale.", labels=["signal"]
        )
        for signal in ("sound", "vibration"):
            dbfs = status["levels"][signal][f"{kind}_dbfs"]
            level.add_metric([signal], 10.0 ** (dbfs / 20.0))
        yield level
    yield _gauge("cushion_muted", "Whether the vibration is muted.", float(status["muted"]))


def _of_rig(status: Mapping[str, Any]) -> Iterator[Metric]:
    protection, exposure = status["protection"], status["exposure"]
    if protection:
        yield _gauge("cushion_protection_gain_ratio", "Of the drive.", protection["gain"])
        excursion = 1e-3 * protection["excursion_mm"]
        yield _gauge("cushion_excursion_meters", "Predicted amplitude.", excursion)
        if protection["coil_c"] is not None:
            coil = protection["coil_c"]
            yield _gauge("cushion_coil_temperature_celsius", "Predicted.", coil)
    if exposure:
        a8 = exposure["a8_m_s2"]
        name = "cushion_exposure_a8_meters_per_second_squared"
        yield _gauge(name, "Predicted daily exposure A(8).", a8)
        above = float(exposure["above_limit"])
        yield _gauge("cushion_exposure_above_limit", "Whether the limit is exceeded.", above)


def _gauge(name: str, meaning: str, value: float) -> Metric:
    return GaugeMetricFamily(name, meaning, value)


def _counter(name: str, meaning: str, value: float) -> Metric:
    return CounterMetricFamily(name, meaning, value)
