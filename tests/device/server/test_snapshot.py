"""What a snapshot says about its sinks."""

from tests.support.snapshots import sink, snapshot, stream


def test_what_plays_to_a_sink_is_neither_paused_nor_on_another_sink() -> None:
    playing, paused = stream(5, 1, "dac"), stream(6, 1, "dac", corked=True)
    seen = snapshot(sinks=(sink(1, "dac"),), sink_inputs=(playing, paused, stream(7, 2, "tv")))
    assert seen.playing_to("dac") == [playing]
    assert seen.playing_to(None) == []
