import base64
import doctest
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.commands import RATE, sound
from tests.support.data import table
from tests.support.signals import tone

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
SHOWN = {name: rest for name, *rest in table("examples-show.toml")["shown"]}


def test_every_program_of_the_examples_is_tested_and_in_the_table_of_the_page() -> None:
    programs = {path.stem for path in EXAMPLES.glob("*.py")}
    assert programs == set(SHOWN)
    page = (ROOT / "docs/examples.md").read_text()
    assert programs == set(re.findall(r"^\| `(\w+)\.py", page, re.MULTILINE))


@pytest.mark.parametrize("program", SHOWN)
def test_an_example_is_short_and_shows_what_it_should(program: str, tmp_path: Path) -> None:
    arguments, shown = SHOWN[program]
    sound(tmp_path / "sound.wav", tone(300.0, 1.0, RATE, 0.3))
    path = EXAMPLES / f"{program}.py"
    command = [sys.executable, "-W", "error", str(path), *arguments.split()]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert re.search(shown, ran.stdout, re.DOTALL), ran.stdout
    assert len(path.read_text().splitlines()) <= 40  # fits on a screen


def test_the_examples_in_the_reference_give_what_stands_there(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs/api.md").read_text()
    examples = doctest.DocTestParser().get_doctest(page, {}, "api.md", "docs/api.md", 0)
    assert len(examples.examples) > 15
    assert doctest.DocTestRunner(verbose=False).run(examples).failed == 0


@pytest.mark.parametrize(
    ("page", "said", "shape"),
    [
        ("README.md", "7.3 ms late, peak 0.46\n", None),
        ("docs/get-started/developer.md", "", (512, 1)),
    ],
)
def test_the_first_example_of_a_page_runs(page, said, shape, capsys):
    found = re.search(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert found
    names: dict[str, Any] = {}
    exec(found[1], names)
    assert capsys.readouterr().out == said
    assert shape is None or names["vibration"].shape == shape


PATH = EXAMPLES / "first_steps.ipynb"
END_OF_CELL = "--- end of the cell"

Cell = dict[str, Any]
NOTEBOOK: Cell = json.loads(PATH.read_text())
CODE: list[Cell] = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]


def printed(cell: Cell) -> str:
    streams = [one for one in cell["outputs"] if one["output_type"] == "stream"]
    assert {one["name"] for one in streams} <= {"stdout"}
    return "".join("".join(one["text"]) for one in streams)


def pictures(cell: Cell) -> list[bytes]:
    shown = [one["data"] for one in cell["outputs"] if one["output_type"] == "display_data"]
    return [base64.b64decode("".join(data["image/png"])) for data in shown]


def test_the_notebook_has_the_format_4_names_no_machine_and_is_linked_to() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"] >= 5) == (4, True)
    assert NOTEBOOK["metadata"] == {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    assert all(cell["metadata"] == {} for cell in NOTEBOOK["cells"])
    identities = [cell["id"] for cell in NOTEBOOK["cells"]]
    assert len(set(identities)) == len(identities)
    assert all(re.fullmatch(r"[a-zA-Z0-9_-]{1,64}", identity) for identity in identities)
    assert not re.search(r"/(home|root|tmp|work|opt|usr|Users)/", PATH.read_text())
    for page in ("docs/examples.md", "docs/get-started/researcher.md"):
        assert "examples/first_steps.ipynb" in (ROOT / page).read_text()


def test_its_cells_are_short_and_were_run_once_in_order_and_its_pictures_are_small() -> None:
    assert [cell["execution_count"] for cell in CODE] == [*range(1, len(CODE) + 1)]
    kinds = {output["output_type"] for cell in CODE for output in cell["outputs"]}
    assert kinds == {"stream", "display_data"}
    assert all("".join(cell["source"]).count("\n") < 30 for cell in NOTEBOOK["cells"])
    shown = [picture for cell in CODE for picture in pictures(cell)]
    assert len(shown) == 4
    assert all(picture.startswith(b"\x89PNG\r\n\x1a\n") for picture in shown)
    assert sum(map(len, shown)) < 400_000


def test_each_cell_prints_what_it_printed_and_draws_where_it_drew(tmp_path: Path) -> None:
    parts = []
    for cell in CODE:
        # the ";" of a last line hides its value in Jupyter
        parts += ["".join(cell["source"]), f"print(len(plt.get_fignums()), {END_OF_CELL!r})"]
        parts.append("plt.close('all')")
    program = tmp_path / "cells.py"
    program.write_text("\n".join(parts))
    command, env = [sys.executable, "-W", "error", program.name], os.environ | {"MPLBACKEND": "agg"}
    env["PYTHONPATH"] = str(ROOT)
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=env)
    assert (ran.returncode, ran.stderr) == (0, "")
    found = ran.stdout.split(f" {END_OF_CELL}\n")
    assert found == [*[f"{printed(cell)}{len(pictures(cell))}" for cell in CODE], ""]
    assert [path.name for path in tmp_path.iterdir()] == ["cells.py"], "it writes no file"
