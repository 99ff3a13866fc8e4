"""The data of a study: `data/NUMBER-CODE.jsonl` of each participant, and one table of all."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook.study.design import BUILT_IN, Design
from audioflinger_hook.study.trials import session
from audioflinger_hook.trials.record import TrialRecord
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

DATA, TABLE, CODEBOOK = "data", "trials.csv", "codebook.md"
CODE = re.compile(r"[A-Za-z0-9_]{1,32}")
IN = re.compile(rf"\d{{4}}-{CODE.pattern}\.jsonl")


@dataclass(frozen=True)
class Participant:
    """A participant with all recorded rows. number: from 0. excluded: why, or ""."""

    number: int
    code: str
    path: Path
    header: Mapping[str, Any]
    rows: list[dict[str, Any]]
    is_complete: bool
    excluded: str


def begun(design: Design) -> list[Path]:
    """Return the records of all participants, except files without a header."""
    files = sorted((design.folder / DATA).glob("*"))
    return [path for path in files if IN.fullmatch(path.name) and b"\n" in path.read_bytes()]


def participants(design: Design) -> list[Participant]:
    """Return all participants who have begun.

    UsageError: a record is damaged, open in another process, or of another design.
    """
    found = []
    for path in begun(design):
        number, code = int(path.name[:4]), path.stem[5:]
        with TrialRecord(path, design.digest) as record:
            rows, header = record.trials, record.header
        is_complete = len(rows) == len(session(design, number))
        why = _exclusion(design, rows) if is_complete else "did not finish"
        found.append(Participant(number, code, path, header, rows, is_complete, why))
    return found


def admit(design: Design, code: str, simulated: bool) -> tuple[int, Path]:
    """Return number and record file of a new participant, or of one who goes on.

    UsageError: the code is not allowed, participant or study has finished, or the data is of real
    people and this one is simulated, or the reverse.
    """
    if not CODE.fullmatch(code):
        raise UsageError(f"--participant={code!r} is no code; allowed: 1 to 32 letters and digits")
    people = participants(design)
    if any(one.header.get("simulated") != simulated for one in people):
        kinds = ("real", "simulated") if simulated else ("simulated", "real")
        told = f"{design.folder / DATA} has data of {kinds[0]} people"
        raise UsageError(f"{told}; move it away before {kinds[1]} people take part")
    for one in people:
        if one.code == code and one.is_complete:
            raise UsageError(f"participant {code} has finished already; give a new code")
        if one.code == code:
            return one.number, one.path
    if sum(one.is_complete for one in people) >= design.study.participants:
        raise UsageError(
            f"the design ends after {design.study.participants} participants, and all have "
            f"finished; see `cushion study report {design.folder}`"
        )
    number = max([one.number for one in people], default=-1) + 1
    return number, design.folder / DATA / f"{number:04d}-{code}.jsonl"


def _exclusion(design: Design, rows: list[dict[str, Any]]) -> str:
    """Return why the design's rule excludes a participant, or ""."""
    study, counted = design.study, [row for row in rows if not row["practice"]]
    median_s = float(np.median([row["answered_after_s"] for row in counted]))
    if median_s < study.fastest_s:
        return f"median answer after {median_s:.2f} s, under {study.fastest_s:g} s"
    for question in design.questions.values():
        own = [row for row in counted if row["question"] == question.name]
        if question.paradigm == "rating":
            rated = [row["answer"] for row in own if row["condition_2"] == question.reference]
            low = float(np.mean([one < study.reference_below for one in rated]))
            if low > study.reference_share:
                return (
                    f"rated the hidden reference under {study.reference_below:g} in "
                    f"{100 * low:.0f} % of trials, over {100 * study.reference_share:g} %"
                )
    return ""


def columns() -> list[str]:
    """Return the names of all columns of the table, from the codebook."""
    return re.findall(r"^\| `(\w+)` \|", (BUILT_IN / CODEBOOK).read_text(), re.MULTILINE)


def write_table(design: Design, people: Sequence[Participant]) -> None:
    """Write all rows to `data/trials.csv`, and `codebook.md`."""
    (design.folder / DATA).mkdir(exist_ok=True)
    out = io.StringIO()
    table = csv.DictWriter(out, columns(), lineterminator="\n")
    table.writeheader()
    for one in people:
        for row in one.rows:
            choices = {"choices": " ".join(row["choices"])}
            table.writerow({"participant": one.code, **row, **choices, "excluded": one.excluded})
    write_bytes_atomically(design.folder / DATA / TABLE, out.getvalue().encode())
    write_bytes_atomically(design.folder / CODEBOOK, (BUILT_IN / CODEBOOK).read_bytes())
