import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import is_dataclass, replace
from types import MappingProxyType, SimpleNamespace
from typing import Any, get_args, get_origin, get_type_hints

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.console import Console

from audioflinger_hook.cli.status import meter_line, status_view
from audioflinger_hook.service import status as figures
from audioflinger_hook.service.figure import entries, gathered, table
from audioflinger_hook.service.json_codec import from_json, to_json
from audioflinger_hook.service.meters import BufferTimes, Level
from audioflinger_hook.service.shown import duration
from audioflinger_hook.service.state import Cause, DaemonState
from audioflinger_hook.service.status import Endpoint, GraphFigures, LatencyBudget, Partial, Status
from device.errors import UsageError
from tests.support.data import text
from tests.support.recordings import ROOT

TIMES_MS = {"tap_ms": 21.3, "transform_ms": 42.7, "delay_line_ms": 20.0, "output_ms": 10.7}
STATUS = Status(
    version="0.1.0",
    pid=4321,
    state=DaemonState.RUNNING,
    reason="",
    since_s=7503.25,
    tap=Endpoint("default", "alsa_output.pci-0000_00_1f.3.analog-stereo.monitor"),
    device=Endpoint("sink:Cushion", "alsa_output.usb-Amplifier-00.analog-stereo"),
    levels=figures.Levels(Level(-3.1, -14.2), Level(-18.2, -27.0)),
    latency=LatencyBudget.of(**TIMES_MS, offset_ms=-5.0, driving_ms=4.0),
    offset_ms=-5.0,
    offset_reason="set in the config",
    delay_line=figures.DelayLineFigures(20.0, 20.1, 13.4, 1, 2, 3, "locked"),
    xruns=figures.Xruns(4, 5),
    buffer_times=BufferTimes(1.2, 2.9, 8.1, 21.3, 5.8),
    recoveries=MappingProxyType(dict.fromkeys(Cause, 0) | {Cause.STALL: 2}),
    effects_bypassed=("loudness",),
    limited_samples=12,
    replaced_samples=1,
    protection=figures.ProtectionFigures(
        5000, 12, 1, 3, 0.5, 0.25, "temperature", 1.234, 61.5, 15.48, -1.23
    ),
    exposure=figures.ExposureFigures(10.0, 1.25, 0.6, 9.5, True, False, 0.31),
    profile="cinema",
    server="PipeWire 1.4.2",
    graph=GraphFigures(1024, 48_000, "monitor", "links are refused"),
    warnings=("the sink runs at 44100 Hz",),
)


def status_text(status: Status, width: int = 80) -> str:
    """Return the view as plain text with lines of at most `width` cells."""
    console = Console(file=io.StringIO(), width=width, color_system=None, legacy_windows=False)
    with console.capture() as capture:
        console.print(status_view(status))
    return "\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n"


OF_SCALARS = {
    str: st.text(max_size=40),
    bool: st.booleans(),
    int: st.integers(0, 2**40),
    float: st.floats(allow_nan=False, allow_infinity=False),
}


def any_of(kind: Any) -> st.SearchStrategy[Any]:
    arguments = get_args(kind)
    if isinstance(kind, type) and is_dataclass(kind):
        parts = {name: any_of(part) for name, part in get_type_hints(kind).items()}
        return st.builds(kind, **parts)
    if get_origin(kind) is tuple:
        return st.lists(any_of(arguments[0]), max_size=3).map(tuple)
    if get_origin(kind) is Mapping:
        items = st.fixed_dictionaries(dict.fromkeys(arguments[0], any_of(arguments[1])))
        return items.map(MappingProxyType)
    if arguments:
        return st.none() | any_of(arguments[0])
    return OF_SCALARS[kind] if kind in OF_SCALARS else st.sampled_from(kind)


statuses = any_of(Status)
large = settings(suppress_health_check=[HealthCheck.too_slow])


@large
@given(statuses)
def test_a_status_comes_back_from_its_document_as_it_was(status):
    line = to_json(status)
    assert ("\n" in line, line.isascii()) == (False, True)
    assert (from_json(Status, line), from_json(Status, line.encode())) == (status, status)


def test_the_document_has_the_keys_of_the_table_and_every_cause_counted():
    document = json.loads(to_json(STATUS))
    assert list(document) == [name for name, _, _ in table(Status)]
    assert document["latency"]["total_ms"] == pytest.approx(93.7)
    assert list(document["recoveries"]) == [cause.value for cause in Cause]
    assert document["buffer_times"]["share_percent"] == 5.8


WRONG = [
    *((("pid",), "12", "pid is '12'; allowed: a whole number"), (("pid",), True, "pid is True")),
    *((("pid",), 1.0, "pid is 1.0"), (("version",), None, "version is None; allowed: a text")),
    (("since_s",), "x", "since_s is 'x'; allowed: a number"),
    (("since_s",), 10**400, "since_s is 0x"),
    (("state",), "flying", "state is 'flying'; allowed: starting,"),
    *((("state",), ["running"], "state is"), (("tap", "address"), None, "tap.address is None")),
    (("tap",), None, "tap is None; allowed: an object"),
    (("levels", "sound", "peak_dbfs"), [], "levels.sound.peak_dbfs is []"),
    (("recoveries", "stall"), 1.5, "recoveries.stall is 1.5"),
    (("recoveries", "rain"), 1, "unknown key recoveries.rain"),
    (("colour",), 1, "unknown key colour"),
    (("warnings",), "x", "warnings is 'x'; allowed: a list"),
    (("warnings",), [1], "warnings[0] is 1"),
]


@pytest.mark.parametrize(("path", "value", "message"), WRONG)
def test_whatever_is_not_exactly_a_status_is_refused_by_name(path, value, message):
    document = json.loads(to_json(STATUS))
    part = document
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    with pytest.raises(UsageError) as caught:
        from_json(Status, json.dumps(document))
    assert message in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("section", [None, "tap", "levels", "delay_line", "recoveries"])
def test_a_missing_key_is_refused(section):
    document = json.loads(to_json(STATUS))
    part = document if section is None else document[section]
    for key in list(part):
        value = part.pop(key)
        with pytest.raises(UsageError, match=f"has no .*{key}"):
            from_json(Status, json.dumps(document))
        part[key] = value


@pytest.mark.parametrize(
    "text",
    ["", "x", "[]", "1", "NaN", '{"pid": 1, "pid": 2}', "[" * 100_000, b"\xff\xfe", "9" * 5000],
    ids=range(9),
)
def test_what_is_no_document_is_refused(text):
    with pytest.raises(UsageError, match="the document"):
        from_json(Status, text)
    with pytest.raises(UsageError, match="a key is given twice"):
        from_json(Status, to_json(STATUS).replace('"pid": 4321', '"pid": 4321, "pid": 4322'))


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_numbers_that_are_not_finite_neither_go_out_nor_come_in(number):
    with pytest.raises(ValueError, match="JSON"):
        to_json(replace(STATUS, since_s=number))
    with pytest.raises(UsageError, match="not JSON"):
        from_json(Status, to_json(STATUS).replace("7503.25", json.dumps(number)))
    with pytest.raises(UsageError, match="finite"):
        from_json(Status, to_json(STATUS).replace("7503.25", "1e999"))


USED = re.compile(r"\bcushion_\w+")
OWN = {"cushion_up", "cushion_build_info", "cushion_hop_seconds_bucket"}


def test_every_figure_says_what_it_means_and_dashboard_and_alerts_use_no_others():
    for entry in entries(Status):
        assert entry.figure.help, entry.path
        assert not entry.figure.help.endswith("."), entry.path
    known = {entry.figure.metric.partition("{")[0] for entry in entries(Status)}
    known |= {f"{name}_total" for name in known} | OWN
    for page in ("docs/grafana.json", "docs/alerts.yml"):
        assert set(USED.findall((ROOT / page).read_text())) <= known, page


def test_a_figure_is_read_from_the_first_source_that_has_it_in_its_own_unit():
    line = SimpleNamespace(target_s=0.02, delay_s=0.0201, state=SimpleNamespace(value="locked"))
    counts = SimpleNamespace(ratio_ppm=1.5, resyncs=1, underflows=2, overflows=3, target_s=9.0)
    found = gathered(figures.DelayLineFigures, line, counts)
    assert found.delay_ms == pytest.approx(20.1)
    figures_of_line = figures.DelayLineFigures(20.0, 0.0, 1.5, 1, 2, 3, "locked")
    assert replace(found, delay_ms=0.0) == figures_of_line
    assert gathered(figures.DelayLineFigures, line).overflows == 0
    with pytest.raises(TypeError, match="address"):
        gathered(Endpoint, line)


def test_the_view_shows_every_figure():
    assert status_text(STATUS, 100).splitlines() == text("status.txt").splitlines()


def test_who_waits_says_for_what_and_why():
    waiting = Status(
        *("0.1.0", 1, DaemonState.WAITING_FOR_SOUND_SOURCE, "it feeds the cushion", 0.25),
        *(Endpoint("default"), Endpoint("usb:0d8c:0014")),
    )
    shown = status_text(waiting)
    assert "waiting-for-sound-source: it feeds the cushion, for 0.2 s" in shown
    assert "usb:0d8c:0014 (not there)" in shown
    assert "silence" in shown
    assert "recoveries none" in shown
    assert not re.search("bypassed|protection|exposure|driving", shown)


@pytest.mark.exhaustive
@large
@given(statuses, st.integers(20, 200))
def test_no_line_is_wider_than_the_terminal_whatever_the_names_are(status, width):
    shown = status_text(status, width)
    assert all(cell_len(line) <= width for line in shown.splitlines())
    assert all(sign.isprintable() or sign == "\n" for sign in shown)


def test_names_are_text_and_no_commands_to_the_terminal_and_a_flood_of_warnings_is_cut():
    evil = replace(STATUS, tap=Endpoint("[bold]x[/bold]", "\x1b]0;t\x07\u202egnp.exe\nnew line"))
    shown = status_text(evil, 120)
    assert "?]0;t??gnp.exe new line ([bold]x[/bold])" in shown
    flooded = replace(STATUS, warnings=tuple(f"number {i}" for i in range(1000)))
    shown = status_text(flooded)  # the last ones are shown
    assert "(980 earlier ones left out)" in shown
    assert ("number 999" in shown, "number 979" in shown) == (True, False)


@pytest.mark.parametrize(
    ("time_s", "text"),
    [
        *((0.0, "0.0 s"), (59.94, "59.9 s"), (59.96, "1 min 00 s"), (3599.6, "1 h 00 min")),
        *((125.0, "2 min 05 s"), (172_799.0, "47 h 59 min"), (172_800.0, "2 d 00 h")),
    ],
)
def test_a_duration_is_shown_in_its_two_largest_units(time_s, text):
    assert duration(time_s) == text


EARLY_MS = {"tap_ms": 20.0, "transform_ms": 7.5, "delay_line_ms": 20.0, "output_ms": 31.0}
EARLY = LatencyBudget.of(**EARLY_MS, offset_ms=-80.0)
PARTIALS = tuple(Partial(100.0 * n, 20.0 + n, 0.01 * n) for n in range(1, 8))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"latency": EARLY}, "-1.5 ms (1.5 ms before the sound) = tap 20.0"),
        ({"principal": PARTIALS}, "principal  700 → 27 Hz, 600 → 26 Hz, 500 → 25 Hz, 400 → 24 Hz"),
        ({"principal": PARTIALS}, "24 Hz and 3 more"),
        ({"muted": True}, ", muted"),
        ({"offset_reason": "not known"}, "ms, not known: `cushion sync` measures the delay"),
        ({"xruns": figures.Xruns(None, None)}, "dropouts   the server does not report them"),
        ({"graph": GraphFigures(256, 44_100, "streams")}, "(default), from its streams"),
        ({"graph": GraphFigures(256, 44_100, "")}, "256 frames at 44100 Hz (5.8 ms) a cycle"),
    ],
)
def test_what_is_another_way_than_usual_is_said(changes, said):
    assert said in status_text(replace(STATUS, **changes), 140)
    assert said not in status_text(STATUS, 140)


def test_several_actuators_are_shown_each_with_its_own_figures():
    made, care = figures.ActuatorFigures, (STATUS.protection, STATUS.exposure)
    known = "left", ("0", "front-left"), "paper", -3.0, "inverted", 5.0
    left = made(*known, Level(-12.0, -20.0), *care)
    mix = made("mix", ("1",), "consumer", 0.0, "normal", 0.0, Level(), None, None)
    parts = ("tap", "transform", "delay_line", "output", "driving", "delay")
    latency = LatencyBudget.of(**{f"{part}_ms": float(n) for n, part in enumerate(parts, 1)})
    lines = status_text(replace(STATUS, actuators=(left, mix), latency=latency), 300).splitlines()
    (first,) = (number for number, line in enumerate(lines) if line.startswith("actuator 1"))
    words = "left on 0, front-left, paper, -3.0 dB, inverted, 5.0 ms later"
    assert lines[first].split(maxsplit=2)[2] == words
    assert "peak  -12.0, rms  -20.0 dBFS" in lines[first + 1]
    assert "blocks 5000, limited 12" in lines[first + 2]
    assert "A(8) 0.6" in lines[first + 3]
    assert lines[first + 4].split(maxsplit=2)[2] == "mix on 1, consumer"
    assert "silence" in lines[first + 5]
    assert sum("protection" in line for line in lines) == 1
    (told,) = (line for line in lines if line.startswith("latency"))
    assert "21.0 ms = tap 1.0 + transform 2.0 + driving 5.0 + delay line 3.0 +" in told
    assert told.endswith("+ actuator 6.0")


def test_the_meter_fits_into_a_line():
    status = replace(STATUS, principal=(Partial(440.0, 100.3, 0.3),), muted=True)
    for width in (0, 10, 40, 79, 200):
        line = meter_line(status, width)
        assert (len(line) <= width, "\n" in line) == (True, False)
        assert width < 79 or re.fullmatch("running, muted  sound ████.*440 → 100 Hz", line)
