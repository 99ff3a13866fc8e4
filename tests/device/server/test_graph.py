"""PipeWire's graph from its own programs: `pw-dump`, `pw-cli`, `pw-top`; how our links are kept."""

import json
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from device.server.graph import Graph, LinkPair
from device.server.graph_watch import Announcements, Documents
from device.server.link_keeper import HOLDS_S, PAUSED_S, RETRY_S, LinkKeeper
from device.server.node_errors import INTERVAL_S, NodeErrors, errors_in
from tests.support.data import text
from tests.support.graphs import Item, desktop, gone, link, node, play, port


def one_link(*pairs: LinkPair, made: Mapping[str, str] | None = None) -> Any:
    known = {"links": lambda _: frozenset(pairs or ((13, 41),)), "made_nodes": lambda: made or {}}
    return SimpleNamespace(nodes=lambda _: {40}, **known)


def kept(*pairs: LinkPair) -> tuple[Graph, LinkKeeper, list[str]]:
    graph, sent = desktop(), list[str]()
    keeper = LinkKeeper(graph, sent.append)
    keeper.wiring = one_link(*pairs)
    return graph, keeper, sent


def later(keeper: LinkKeeper, now_s: float, *items: Item) -> None:
    keeper._graph.apply(items)
    keeper.update(now_s)


def test_an_object_that_has_gone_is_out_of_every_index_even_if_its_id_is_used_again():
    graph = desktop()
    play(graph, 60, "player", 10)
    assert {one.id for one in graph.links_of(10)} == {63, 64}
    graph.apply([gone(63), gone(61)])
    assert [one.id for one in graph.links_of(10)] == [64]
    assert graph.ports_of(60, "output_") == {"FR": 62}
    graph = desktop()
    play(graph, 60, "player", 10)
    graph.apply([node(63, "another", "Audio/Sink")])  # was a link
    assert [one.id for one in graph.links_of(10)] == [64]
    assert graph.sink("another")
    graph.apply([port(63, 60, "output_FC")])  # was a node
    assert graph.sink("another") is None


def test_properties_of_the_client_count_where_the_node_has_none_of_that_name():
    graph = Graph()
    client = {"application.name": "Music", "media.role": "music"}
    graph.apply([{"id": 5, "type": "PipeWire:Interface:Client", "info": {"props": client}}])
    own: dict[str, Any] = {"client.id": 5, "media.role": "game"}
    graph.apply([node(6, "jack", **own)])
    known = graph.properties_of(graph.nodes[6])
    assert (known["application.name"], known["media.role"]) == ("Music", "game")


def test_the_rate_is_the_forced_one_where_one_is_forced():
    graph = Graph()
    settings = {"id": 9, "type": "PipeWire:Interface:Metadata"}
    settings["props"] = {"metadata.name": "settings"}
    for forced, rate in ((0, 48_000), (44_100, 44_100)):
        pairs = (("clock.rate", 48_000), ("clock.force-rate", forced))
        metadata = [{"key": key, "value": value} for key, value in pairs]
        graph.apply([{**settings, "metadata": metadata}])
        assert graph.clock_hz == rate


@given(st.lists(st.one_of(st.none(), st.integers(), st.dictionaries(st.text(), st.integers()))))
def test_objects_of_unknown_form_change_nothing(items):
    graph = desktop()
    graph.apply(item for item in items if not isinstance(item, dict) or "id" not in item)
    assert len(graph.ports) == 15


@given(st.integers(1, 40))
def test_documents_are_whole_however_the_pipe_cuts_them(piece):
    text = b'[\n  {\n    "id": 1,\n    "info": null\n  }\n]\n[\n]\n[\n  {\n    "id": 2\n  }\n]\n'
    ends = os.pipe()
    documents, found = Documents(ends[0]), []
    for at in range(0, len(text), piece):
        os.write(ends[1], text[at : at + piece])
        found += documents.read()
    os.close(ends[1])
    while not documents.ended:
        found += documents.read()
    os.close(ends[0])
    assert found == [[{"id": 1, "info": None}], [], [{"id": 2}]]


PRINTED = text("pw-cli.txt").encode()


def announced(printed: bytes = PRINTED, graph: Graph | None = None, piece: int = 1 << 16) -> Graph:
    graph, ends = graph or desktop(), os.pipe()
    announcements = Announcements(ends[0])
    for at in range(0, len(printed), piece):
        os.write(ends[1], printed[at : at + piece])
        graph.announce(announcements.read())
    for end in ends:
        os.close(end)
    return graph


def late_link(number: int, serial: int, graph: Graph) -> Item:
    item = link(number, 71, 11, graph)
    item["info"]["props"] = {"object.serial": serial}
    return item


def latency(direction: str, **units: float) -> Item:
    """A parameter of a port, with the same least and largest value but for `units`."""
    names = (f"{end}{unit}" for end in ("min", "max") for unit in ("Quantum", "Rate", "Ns"))
    return {"direction": direction, **dict.fromkeys(names, 0), **units}


def declaring(*latencies: Item) -> Graph:
    graph, left = desktop(), port(11, 10, "playback_FL")
    left["info"]["params"] = {"Latency": list(latencies)}
    graph.apply([left])
    return graph


def test_a_sinks_delay_is_the_sum_of_cycles_frames_and_time_of_its_latest_port():
    graph = declaring(
        latency("Output", maxNs=9e9),
        latency("Input", minQuantum=1, maxQuantum=1, minRate=480, maxRate=480, maxNs=200_000_000),
    )
    assert graph.declared_s("desk", 960, 48_000) == pytest.approx(0.02 + 0.01 + 0.1)
    assert graph.declared_s("dac", 960, 48_000) == 0.0
    assert graph.declared_s("nowhere", 960, 48_000) is None
    assert declaring(latency("Input", minNs=-5e7, maxNs=-5e7)).declared_s("desk", 1, 1) == -0.05
    graph, left = declaring(), port(11, 10, "playback_FL")
    left["info"]["params"] = {"Latency": [latency("Input", minNs=1e6, maxNs=1e6)]}
    assert not graph.apply([left])  # no change of the wiring
    assert graph.declared_s("desk", 1, 1) == 1e-3


def test_of_all_parameters_only_the_latencies_are_read():
    one = port(11, 10, "playback_FL")
    others = {"EnumFormat": [{"mediaType": "audio"}], "ProcessLatency": []}
    one["info"]["params"] = {"Latency": [latency("Input", maxNs=5)], **others}
    reading, writing = os.pipe()
    os.write(writing, (json.dumps([one], indent=2) + "\n").encode())
    os.close(writing)
    ((found,),) = Documents(reading).read()
    os.close(reading)
    assert found["info"]["params"] == {"Latency": [latency("Input", maxNs=5)]}


@given(st.integers(1, 80))
def test_a_link_is_known_with_its_last_announced_line_however_the_pipe_cuts_it(piece):
    graph = announced(piece=piece)
    assert [one.pair for one in graph.links_of(10)] == [(71, 11)]
    assert graph.ports_of(70, "output_") == {"FL": 71}
    assert (graph.nodes[70].name, graph.is_described(70)) == ('a "name" = ', False)


def test_what_is_described_late_does_not_undo_what_was_announced():
    graph = announced()
    graph.apply([late_link(72, 650, graph)])  # of an earlier link with this id
    graph.apply([gone(72)])  # the end of that one
    assert graph.links[72].state == ""
    graph.apply([late_link(72, 702, graph)])
    assert graph.links[72].state == "active"
    graph.apply([gone(72)])
    assert 72 not in graph.links


def test_an_announced_end_counts_at_once_and_an_unannounced_one_of_another_pw_cli():
    graph = announced()
    graph.apply([late_link(72, 702, graph)])
    announced(PRINTED, graph)
    assert graph.links[72].state == "active"
    announced(b"remote 0 removed global: \tid 72, type PipeWire:Interface:Link/3\n", graph)
    assert 72 not in graph.links
    graph = announced()
    announced(b"remote 0 added global: \tid 0, type PipeWire:Interface:Core/4\nremote 0 x\n", graph)
    graph.apply([gone(72)])
    assert 72 not in graph.links


@given(st.binary())
def test_nothing_that_is_printed_breaks_the_graph(printed):
    graph = announced(PRINTED + printed + b"\n" + PRINTED)
    assert (71, 11) in {one.pair for one in graph.links_of(10)}


def test_a_missing_link_is_asked_for_until_it_comes_and_any_other_of_our_nodes_removed():
    graph, keeper, sent = kept()
    for now_s in (1.0, 1.01, 1.0 + RETRY_S):
        keeper.update(now_s)
    assert sent == ["create-link -1 13 -1 41 { link.passive=true object.linger=false }"] * 2
    graph.apply([link(70, 13, 41, graph)])
    for now_s in (1.2, 1.4):
        keeper.update(now_s)
    assert (len(sent), keeper.missing({(13, 41)})) == (2, set())
    graph, keeper, sent = kept()
    later(keeper, 1.0, link(70, 13, 41, graph), link(71, 14, 41, graph), link(72, 13, 21, graph))
    assert sent == ["destroy 71"]


def test_a_node_is_made_while_it_is_wanted_and_only_once():
    graph, keeper, sent = kept()
    graph.apply([link(70, 13, 41, graph)])
    keeper.wiring = one_link(made={"quiet": "create-node adapter"})
    later(keeper, 1.0)
    later(keeper, 1.05)
    assert sent == ["create-node adapter"]
    later(keeper, 1.3, node(80, "quiet"), node(81, "quiet"))
    assert sent[1:] == ["destroy 81"]
    keeper.wiring = one_link()
    keeper.update(1.6)
    assert sorted(sent[2:]) == ["destroy 80", "destroy 81"]


def test_a_link_that_does_not_last_or_stays_paused_beside_an_active_one_is_made_again():
    graph, keeper, _ = kept()
    keeper.update(1.0)
    for at in range(1, 8):
        later(keeper, 1.0 + 0.1 * at, link(70, 13, 41, graph))
        later(keeper, 1.05 + 0.1 * at, gone(70))
    assert keeper.missing_for_s({(13, 41)}, 1.8) > 0.7
    later(keeper, 1.9, link(70, 13, 41, graph))
    later(keeper, 1.91 + HOLDS_S)
    assert keeper.missing_for_s({(13, 41)}, 3.0) == 0.0
    graph, keeper, sent = kept((13, 41), (14, 42))
    later(keeper, 1.0, link(70, 13, 41, graph), link(71, 14, 42, graph, "paused"))
    later(keeper, 1.2, link(71, 14, 42, graph, "active"))
    later(keeper, 1.3, link(71, 14, 42, graph, "paused"))
    later(keeper, 1.25 + PAUSED_S)
    assert sent == []
    later(keeper, 1.4 + PAUSED_S)
    assert sent == ["destroy 71"]


def test_another_session_manager_is_known_by_its_serial_number_as_ids_come_back():
    graph = desktop()
    assert graph.session_manager is None
    for serial, which in ((81, ""), (97, ""), (99, " (main-alone)")):
        props = {"application.name": f"WirePlumber{which}", "object.serial": serial}
        graph.apply([{"id": 5, "type": "PipeWire:Interface:Client", "info": {"props": props}}])
        assert graph.session_manager == serial
    graph.apply([gone(5)])
    assert graph.session_manager is None


LISTING = text("pw-top.txt")
NAMES = ("cushion-9-1.tap", "cushion-9-1.vibration")


def looked(errors: NodeErrors, *times_s: float, names: tuple[str, ...] = NAMES) -> None:
    for now_s in times_s:
        errors.update(names, now_s)
        end_s = time.monotonic() + 10.0
        while errors.process is not None and time.monotonic() < end_s:
            os.sched_yield()
            errors.update(names, now_s)


@pytest.fixture
def pw_top(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make a program of that name that runs this text."""
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)

    def make(text: str) -> None:
        (tmp_path / "pw-top").write_text(f"#!/bin/sh\n{text}\n")
        (tmp_path / "pw-top").chmod(0o755)

    return make


def test_each_stream_has_its_count_and_that_of_a_chain_that_has_gone_is_kept(pw_top):
    assert errors_in(LISTING, NAMES) == dict(zip(NAMES, (18, 2), strict=True))
    assert errors_in("", NAMES) == {}
    errors = NodeErrors()
    assert errors.count(".tap") is None
    pw_top(f"cat <<'END'\n{LISTING}END")
    looked(errors, 0.0)
    pw_top(f"cat <<'END'\n{LISTING.replace('-9-1', '-9-2')}END")
    looked(errors, INTERVAL_S, names=tuple(name.replace("-9-1", "-9-2") for name in NAMES))
    assert (errors.count(".tap"), errors.count(".vibration")) == (36, 4)


def test_a_program_without_a_batch_mode_is_asked_once_and_the_counts_stay_unknown(pw_top, tmp_path):
    pw_top(f"echo asked >> {tmp_path / 'log'}; exit 255")
    errors = NodeErrors()
    looked(errors, 0.0, INTERVAL_S, 2.0 * INTERVAL_S)
    assert errors.count(".tap") is None
    assert (tmp_path / "log").read_text() == "asked\n"
