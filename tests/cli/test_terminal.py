"""What the commands tell the user to type."""

from __future__ import annotations

import shutil

import pytest

from audioflinger_hook.cli.terminal import as_typed


@pytest.mark.parametrize(
    ("started", "found", "expected"),
    [
        (".venv/bin/cushion", None, ".venv/bin/cushion setup"),
        ("/home/a b/cushion", None, "'/home/a b/cushion' setup"),
        (".venv/bin/cushion", "/usr/bin/cushion", "cushion setup"),
        ("/usr/lib/audioflinger_hook/__main__.py", None, "cushion setup"),
    ],
)
def test_a_command_to_type_has_the_path_that_the_shell_needs(
    monkeypatch: pytest.MonkeyPatch, started: str, found: str | None, expected: str
) -> None:
    monkeypatch.setattr("sys.argv", [started])
    monkeypatch.setattr(shutil, "which", lambda _: found)
    assert as_typed("setup") == expected
