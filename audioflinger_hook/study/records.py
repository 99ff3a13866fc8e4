"""The data of a study: `data/NUMBER-CODE.jsonl` of each participant, and one table of all."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.study.design import Design
from audioflinger_hook.study.trials import session
from audioflinger_hook.trials.record import TrialRecord
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

DATA, TABLE = "data", "trials.csv"
CODE = re.compile(r"[A-Za-z0-9_]{1,32}")
IN = re.compile(r"(\d{4})-([A-Za-z0-9_]{1,32})\.jsonl")


@dataclass(frozen=True)
class Participant:
    """A participant with all recorded rows. number: from 0. excluded: why, or ""."""

    number: int
    code: str
    header: Mapping[str, Any]
    rows: list[dict[str, Any]]
    is_complete: bool
    excluded: str = ""


def record_files(design: Design) -> dict[str, tuple[int, Path]]:
    """Return number and record file of each participant by code, except files without a header."""
    found = [(IN.fullmatch(path.name), path) for path in sorted((design.folder / DATA).glob("*"))]
    begun = [(match, path) for match, path in found if match and b"\n" in path.read_bytes()]
    return {match[2]: (int(match[1]), path) for match, path in begun}


def admit(design: Design, code: str, simulated: bool) -> tuple[int, Path]:
    """Return number and record file of a new participant, or of one who goes on.

    UsageError: the code is not allowed, participant or study has finished, or the data is of real
    people and this one is simulated, or the reverse.
    """
    if not CODE.fullmatch(code):
        raise UsageError(f"--participant={code!r} is no code; allowed: 1 to 32 letters and digits")
    known, people = record_files(design), participants(design)
    if any(one.header.get("simulated") != simulated for one in people):
        kinds = ("real", "simulated") if simulated else ("simulated", "real")
        told = f"{design.folder / DATA} has data of {kinds[0]} people"
        raise UsageError(f"{told}; move it away before {kinds[1]} people take part")
    finished = [one.code for one in people if one.is_complete]
    if code in finished:
        raise UsageError(f"participant {code} has finished already; give a new code")
    if code in known:
        return known[code]
    if len(finished) >= design.study.participants:
        raise UsageError(
            f"the design ends after {design.study.participants} participants, and all have "
            f"finished; see `cushion study report {design.folder}`"
        )
    number = max([number for number, _ in known.values()], default=-1) + 1
    return number, design.folder / DATA / f"{number:04d}-{code}.jsonl"


def participants(design: Design) -> list[Participant]:
    """Return all participants. UsageError: a record is damaged, or of another design."""
    found = []
    for code, (number, path) in record_files(design).items():
        with TrialRecord(path, design.digest) as record:
            rows, header = record.trials, record.header
        is_complete = len(rows) == len(session(design, number))
        why = _exclusion(design, rows) if is_complete else "did not finish"
        found.append(Participant(number, code, header, rows, is_complete, why))
    return found


def _exclusion(design: Design, rows: list[dict[str, Any]]) -> str:
    """Return why the design's rule excludes a participant, or ""."""
    study, counted = design.study, [row for row in rows if not row["practice"]]
    median_s = float(np.median([row["answered_after_s"] for row in counted]))
    if median_s < study.fastest_s:
        return f"median answer after {median_s:.2f} s, under {study.fastest_s:g} s"
    for question in design.questions.values():
        if question.paradigm == "rating":
            own = [row for row in counted if row["question"] == question.name]
            rated = [row["answer"] for row in own if row["condition_2"] == question.reference]
            low = float(np.mean([one < study.reference_below for one in rated]))
            if low > study.reference_share:
                return (
                    f"rated the hidden reference under {study.reference_below:g} in "
                    f"{100 * low:.0f} % of trials, over {100 * study.reference_share:g} %"
                )
    return ""


def columns() -> dict[str, str]:
    """Return all columns of the table, and their meaning, from the codebook."""
    text = (files("audioflinger_hook.study") / "built_in/codebook.md").read_text()
    return dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", text, re.MULTILINE))


def write_table(design: Design, people: Sequence[Participant]) -> None:
    """Write all rows to `data/trials.csv`, and `codebook.md`."""
    out = io.StringIO()
    table = csv.DictWriter(out, list(columns()), lineterminator="\n")
    table.writeheader()
    for one in people:
        for row in one.rows:
            choices = {"choices": " ".join(row["choices"])}
            table.writerow({"participant": one.code, **row, **choices, "excluded": one.excluded})
    write_bytes_atomically(design.folder / DATA / TABLE, out.getvalue().encode())
    text = (files("audioflinger_hook.study") / "built_in/codebook.md").read_bytes()
    write_bytes_atomically(design.folder / "codebook.md", text)
