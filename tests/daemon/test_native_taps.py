"""What the native engine taps, and how its chains are linked; on graphs that need no server."""

from dataclasses import replace

import pytest

from audioflinger_hook.daemon.inputs.applications import Applications
from audioflinger_hook.daemon.native import taps
from device.server import AppRules
from device.server.snapshot import Source
from tests.support.graphs import desktop, gone, link, node, play, port

INPUTS = (41, 42)
DESK = taps.Tap("desk.monitor", ("FL", "FR"), "desk")


def test_each_link_to_the_sink_has_its_mirror_whoever_made_it():
    graph = desktop()
    play(graph, 60, "player", 10)
    play(graph, 70, "player", 10)  # of the same name
    play(graph, 80, "player", 30)  # to another sink
    assert set(DESK.mirrored(graph, "dac", INPUTS)) == {(61, 41), (62, 42), (71, 41), (72, 42)}


def test_neither_the_devices_monitor_nor_what_plays_to_it_is_tapped():
    graph = desktop()
    graph.apply([link(90, 23, 11, graph), link(91, 33, 11, graph)])  # monitors of dac and tv
    assert set(DESK.mirrored(graph, "dac", INPUTS)) == {(33, 41)}
    graph = desktop()
    play(graph, 60, "player", 20)
    graph.apply([link(90, 51, 21, graph)])  # the chain's own vibration
    anywhere = taps.Tap("any", ("FL", "FR"), "", AppRules(("*",)))
    for tap in (anywhere, taps.Tap("dac.monitor", ("FL", "FR"), "dac")):
        assert not set(tap.mirrored(graph, "dac", INPUTS))


def test_rules_choose_among_the_streams_of_the_sink_by_program_and_client():
    graph = desktop()
    play(graph, 60, "a", 10, **{"application.name": "Game"})
    play(graph, 70, "b", 10, **{"application.process.binary": "mpv"})
    play(graph, 80, "Game", 30)  # by its node's name, as a JACK client has it
    every = Applications((), 48_000, 2, channel_map="front-left,front-right")
    one = replace(every, sink="desk")
    for rules, outputs in (
        *((AppRules(("game",)), {61, 62}), (AppRules(exclude=("game",)), {71, 72})),
        (AppRules(("*",), ("binary:mpv",)), {61, 62}),
    ):
        mirrored = taps.tap_of(one, rules).mirrored(graph, "dac", INPUTS)
        assert {output for output, _ in mirrored} == outputs
    anywhere = taps.tap_of(every, AppRules(("game",)))
    assert {out for out, _ in anywhere.mirrored(graph, "dac", INPUTS)} == {61, 62, 81, 82}
    assert not anywhere.has_monitor


@pytest.mark.parametrize(
    ("position", "channels"),
    [("FR", (1,)), ("RL", (0,)), ("SR", (1,)), ("FC", (0, 1)), ("MONO", (0, 1)), ("", (0, 1))],
)
def test_a_position_that_the_tap_lacks_goes_to_its_side_or_everywhere(position, channels):
    assert taps.channels_of(position, ("FL", "FR")) == channels


def test_the_monitor_is_tapped_channel_by_channel_in_the_mixers_order():
    graph = desktop()
    source = Source(2, "desk.monitor", "", "desk", 48_000, 2, {}, "front-right,front-left")
    tap = taps.tap_of(source, None)
    assert tap.positions == ("FL", "FR")
    assert list(tap.monitored(graph, INPUTS)) == [(13, 41), (14, 42)]


def chain(*, linked: bool = True) -> taps.ChainEnds:
    return taps.ChainEnds("chain.tap", "chain.vibration", 2, (0, None), linked)


def test_a_chain_is_linked_from_the_streams_to_the_devices_channels_unless_it_leaves():
    graph = desktop()
    play(graph, 60, "player", 10)
    wiring = taps.ChainWiring((chain(),), DESK, "dac", ("FL", "FR"))
    assert (wiring.links(graph), wiring.nodes(graph)) == ({(61, 41), (62, 42), (51, 21)}, {40, 50})
    assert wiring.is_fed(graph)
    by_monitor = taps.ChainWiring((chain(),), DESK, "dac", ("FL", "FR"), by_monitor=True)
    assert by_monitor.links(graph) == {(13, 41), (14, 42), (51, 21)}
    leaving = taps.ChainWiring((chain(linked=False),), DESK, "dac", ("FL", "FR"))
    assert (leaving.links(graph), leaving.nodes(graph)) == (set(), {40, 50})  # it is ours
    assert not leaving.is_fed(desktop())
    graph.apply([port(43, 40, "input_AUX2")])
    surround = taps.ChainEnds("chain.tap", "chain.vibration", 3, (0, None), linked=True)
    assert taps.ChainWiring((surround,), DESK, "dac", ("FL", "FR")).links(graph) == {(51, 21)}


def test_silence_keeps_the_formats_before_the_first_link_and_after_the_last():
    graph = desktop()
    graph.apply([node(90, "silence"), port(91, 90, "playback_MONO"), port(92, 90, "monitor_MONO")])
    wiring = taps.ChainWiring((chain(),), DESK, "dac", ("FL", "FR"), silence="silence")
    assert wiring.links(graph) == {(92, 41), (92, 42), (51, 21)}
    assert not wiring.is_fed(graph)
    assert not wiring.tap_links(graph, chain())  # is never waited for
    by_monitor = taps.ChainWiring((chain(),), DESK, "dac", ("FL", "FR"), True, "silence")
    assert (92, 41) not in by_monitor.links(graph)
    waiting = taps.ChainWiring((chain(linked=False),), silence="silence")
    assert list(waiting.made_nodes()) == ["silence"]
    assert "node.name=silence " in waiting.made_nodes()["silence"]
    assert not taps.ChainWiring(silence="silence").made_nodes()


def test_a_sink_that_is_not_in_the_graph_or_has_no_ports_is_named():
    graph = desktop()
    assert taps.why_unlinkable(graph, DESK, "dac") == ""
    assert "no node 'amp': it is of another server" in taps.why_unlinkable(graph, DESK, "amp")
    graph.apply([node(95, "amp", "Audio/Sink")])
    assert "the sink 'amp' has no ports" in taps.why_unlinkable(graph, DESK, "amp")
    graph.apply([gone(number) for number in (11, 12)])
    assert taps.why_unlinkable(graph, DESK, "dac") == ""  # its monitor can be tapped
    assert "the sink 'desk' has no ports" in taps.why_unlinkable(graph, DESK, "desk")
