"""Links that PipeWire leaves paused: found beside an active one, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest

from device.server.paused_links import paused_links


def node(number: int, name: str) -> dict[str, Any]:
    return {"id": number, "type": "PipeWire:Interface:Node", "info": {"props": {"node.name": name}}}


def link(number: int, output: int, put: int, state: str) -> dict[str, Any]:
    info = {"output-node-id": output, "input-node-id": put, "state": state}
    return {"id": number, "type": "PipeWire:Interface:Link", "info": info}


NODES = [node(1, "vibration"), node(2, "haptic"), node(3, "player"), node(4, "tap")]


@pytest.mark.parametrize(
    ("states", "found"),
    [
        (("active", "paused"), ["11"]),
        (("paused", "active"), ["10"]),
        (("active", "active"), []),
        (("paused", "paused"), []),  # both rest
        (("active", "negotiating"), []),
    ],
)
def test_a_link_is_forgotten_if_it_is_paused_beside_an_active_one(
    states: tuple[str, str], found: list[str]
) -> None:
    links = [link(10 + n, 1, 2, state) for n, state in enumerate(states)]
    assert paused_links([*NODES, *links], {"vibration"}) == found


def test_links_of_others_and_other_pairs_do_not_count() -> None:
    links = [link(10, 3, 2, "active"), link(11, 3, 2, "paused"), link(12, 1, 2, "active")]
    assert paused_links([*NODES, *links, link(13, 4, 1, "paused")], {"vibration"}) == []


@pytest.mark.parametrize("answer", [None, {}, 3, [], [{}], [{"type": "x:Link", "info": None}]])
def test_an_answer_of_another_form_has_no_links(answer: object) -> None:
    assert paused_links(answer, {"vibration"}) == []
