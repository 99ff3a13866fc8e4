"""`cushion status --json` is for programs: one document, or one line each second."""

import json
import time
from unittest.mock import Mock

from audioflinger_hook.cli import status
from tests.service.test_status_server import STATUS
from tests.support.commands import call, refused


def test_watched_json_is_one_line_each_second_until_it_is_interrupted(monkeypatch):
    monkeypatch.setattr(status, "ask_status", lambda *_: STATUS)
    sleeps = Mock(side_effect=[None, None, KeyboardInterrupt])
    monkeypatch.setattr(status, "time", Mock(monotonic=time.monotonic, sleep=sleeps))
    lines = call("status", "--watch", "--json").stdout.splitlines()
    assert len(lines) == 3
    assert {json.loads(line)["state"] for line in lines} == {STATUS.state.value}
    assert [one.args for one in sleeps.call_args_list] == [(status.JSON_EVERY_S,)] * 3
    assert len(call("status", "--json").stdout.splitlines()) == 1


def test_the_shortest_test_tone_is_as_long_as_the_message_says():
    for seconds in ("0.19", "60.1"):
        said = refused(call("test-tone", "--device", "hw:x", "--seconds", seconds))
        assert "allowed: 0.2 to 60 s" in said
    for seconds in ("0.2", "60"):
        said = refused(call("test-tone", "--device", "hw:x", "--seconds", seconds))
        assert "cannot play a test tone" in said
