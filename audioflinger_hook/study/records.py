"""The data of a study: preregistration, records `data/NUMBER-CODE.jsonl`, and one table of all."""

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from audioflinger_hook import __version__
from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, vibration_file
from audioflinger_hook.study.session import session
from audioflinger_hook.trials.record import TrialRecord
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

DATA, TABLE, CODEBOOK = "data", "trials.csv", "codebook.md"
PREREGISTRATION = "preregistration.json"
CODE = re.compile(r"[A-Za-z0-9_]{1,32}")


@dataclass(frozen=True)
class Record:
    """What is recorded of a participant. number: from 0. excluded: why, or ""."""

    number: int
    code: str
    path: Path
    header: Mapping[str, Any]
    rows: list[dict[str, Any]]
    is_complete: bool
    excluded: str


def now() -> str:
    """Return the time in UTC, for records."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def begun(design: Design) -> list[Path]:
    """Return the records of all participants, except files without a header."""
    files = sorted((design.folder / DATA).glob("[0-9]*-*.jsonl"))
    return [path for path in files if b"\n" in path.read_bytes()]


def register(design: Design) -> dict[str, Any]:
    """Return the preregistration: SHA-256 of all files of the design; write it if it is new.

    UsageError: a file has changed since the first participant.
    """
    path, folder = design.folder / PREREGISTRATION, design.folder
    names = {DESIGN: 0} | {name: 0 for one in design.questions.values() for name in one.stimuli}
    for question in design.questions.values():
        methods = [design.conditions[name].method for name in question.conditions]
        made = [vibration_file(folder, m, s) for m in methods for s in question.stimuli]
        names |= {str(file.relative_to(folder)): 0 for file in made if file}
    sums = {name: sha256((folder / name).read_bytes()).hexdigest() for name in names}
    try:
        found: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
        before = dict(found.get("sha256", {}))
    except (OSError, ValueError, TypeError, AttributeError):
        raise UsageError(f"{path} is damaged; restore it") from None
    changed = [name for name in sums if before.get(name) != sums[name]]
    if changed and path.exists() and begun(design):
        raise UsageError(
            f"{changed[0]} has changed since the first participant; restore it, or copy the folder "
            f"without {DATA} and {PREREGISTRATION}: a changed design is another study"
        )
    if changed:
        found = {"sha256": sums, "version": __version__, "registered": now()}
        write_bytes_atomically(path, f"{json.dumps(found, indent=2)}\n".encode())
    return found


def records(design: Design, people: str | None = None) -> list[Record]:
    """Return the records of all participants who have begun.

    people: SHA-256 of the file of simulated people, "" for real people, None for any. UsageError: a
    record is damaged, open in another process, or of another design or other people.
    """
    found = []
    for path in begun(design):
        number, _, code = path.stem.partition("-")
        with TrialRecord(path, design.digest) as record:
            rows, header = record.trials, record.header
        if people not in (None, header.get("simulated")):
            told = "is of other people, real or simulated; move the data away first"
            raise UsageError(f"{path} {told}")
        is_complete = len(rows) == len(session(design, int(number)))
        why = _exclusion(design, rows) if is_complete else "did not finish"
        found.append(Record(int(number), code, path, header, rows, is_complete, why))
    return found


def admit(design: Design, code: str, people: str) -> tuple[int, TrialRecord]:
    """Return number and record of a new participant, or of one who goes on.

    people: as for `records`. UsageError: the code is not allowed, participant or study has
    finished, or there are records of other people.
    """
    if not CODE.fullmatch(code):
        raise UsageError(f"--participant={code!r} is no code; allowed: 1 to 32 letters and digits")
    taken, most = {one.code: one for one in records(design, people)}, design.study.participants
    if code in taken and taken[code].is_complete:
        raise UsageError(f"participant {code} has finished already; give a new code")
    if code not in taken and sum(one.is_complete for one in taken.values()) >= most:
        told = f"the design ends after {most} participants, and all have finished"
        raise UsageError(f"{told}; see `cushion study report {design.folder}`")
    new = max((one.number + 1 for one in taken.values()), default=0)
    number = taken[code].number if code in taken else new
    path = design.folder / DATA / f"{number:04d}-{code}.jsonl"
    header = {"participant": code, "simulated": people, "begun": now()}
    return number, TrialRecord(path, design.digest, header=header)


def _exclusion(design: Design, rows: Sequence[Mapping[str, Any]]) -> str:
    """Return why the design's rule excludes a participant, or ""."""
    study, counted = design.study, [row for row in rows if not row["practice"]]
    median_s = float(np.median([row["answered_after_s"] for row in counted]))
    if median_s < study.fastest_s:
        return f"median answer after {median_s:.2f} s, under {study.fastest_s:g} s"
    for name, question in design.questions.items():
        if question.paradigm == "rating":
            own = [r for r in counted if (r["question"], r["tested"]) == (name, question.reference)]
            low = 100.0 * np.mean([row["answer"] < study.reference_below for row in own])
            if low > 100.0 * study.reference_share:
                told = f"rated the hidden reference under {study.reference_below:g}"
                return f"{told} in {low:.0f} % of trials, over {100 * study.reference_share:g} %"
    return ""


def columns() -> list[str]:
    """Return the names of all columns of the table, from the codebook."""
    return re.findall(r"^\| `(\w+)` \|", (BUILT_IN / CODEBOOK).read_text(), re.MULTILINE)


def write_table(design: Design) -> list[Record]:
    """Write all rows to `data/trials.csv`, and `codebook.md`; return the records."""
    found, out = records(design), io.StringIO()
    table = csv.DictWriter(out, columns(), lineterminator="\n")
    table.writeheader()
    for one in found:
        for row in one.rows:
            more = {"participant": one.code, "excluded": one.excluded}
            table.writerow({**row, **more, "choices": "|".join(row["choices"])})
    (design.folder / DATA).mkdir(exist_ok=True)
    write_bytes_atomically(design.folder / DATA / TABLE, out.getvalue().encode())
    write_bytes_atomically(design.folder / CODEBOOK, (BUILT_IN / CODEBOOK).read_bytes())
    return found
