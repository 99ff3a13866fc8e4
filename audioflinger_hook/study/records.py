"""The data of a study: preregistration, records `data/CODE.jsonl`, and one table of all."""

import csv
import io
import json
import re
from collections.abc import Callable, Mapping
from hashlib import sha256
from itertools import product
from os.path import relpath
from typing import Any

import numpy as np

from audioflinger_hook import __version__
from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, vibration_file
from audioflinger_hook.study.session import session
from audioflinger_hook.trials.record import TrialRecord
from device.atomic_file import write_bytes_atomically
from device.errors import UsageError

DATA, TABLE, CODEBOOK, PREREGISTRATION = "data", "trials.csv", "codebook.md", "preregistration.json"
UNFINISHED = "did not finish"


def register(design: Design, now: str, tell: Callable[[str], object]) -> dict[str, Any]:
    """Return the preregistration: SHA-256 of all files of the design; write a new one.

    now: in UTC. tell: shows a line. UsageError: a file has changed since the first participant.
    """
    folder, path = design.folder, design.folder / PREREGISTRATION
    files = {folder / DESIGN}
    for question in design.questions.values():
        for sound, name in product(question.stimuli, question.conditions):
            made = vibration_file(folder, design.conditions[name].method, sound)
            files |= {folder / sound, made or folder / sound}
    sums = {relpath(one, folder): sha256(one.read_bytes()).hexdigest() for one in sorted(files)}
    try:
        found: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {"sha256": {}}
        changed = [name for name, one in sums.items() if found["sha256"].get(name) != one]
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        raise UsageError(f"{path} is damaged; restore it") from None
    if changed and path.exists() and any((folder / DATA).glob("*.jsonl")):
        raise UsageError(
            f"{changed[0]} has changed since the first participant; restore it, or copy the folder "
            f"without {DATA} and {PREREGISTRATION}: a changed design is another study"
        )
    if changed:
        earlier = " in place of an earlier one" if path.exists() else ""
        tell(f"this design is now registered{earlier}; publish its SHA-256 to preregister")
        found = {"sha256": sums, "version": __version__, "registered": now}
        write_bytes_atomically(path, f"{json.dumps(found, indent=2)}\n".encode())
    return found


def records(design: Design) -> dict[str, TrialRecord]:
    """Return the closed records of all participants who have begun, by code.

    UsageError: a record is damaged, open in another process, or of another design.
    """
    found = {}
    for path in sorted((design.folder / DATA).glob("*.jsonl")):
        if b"\n" in path.read_bytes():  # kill -9 may leave an empty file
            with TrialRecord(path, design.digest) as record:
                found[path.stem] = record
            if not {"number", "simulated", "begun"} <= record.header.keys():
                raise UsageError(f"the record {path} is damaged (its first line); move it away")
    return found


def finished(design: Design, people: str) -> list[str]:
    """Return the codes of participants who have finished.

    people: SHA-256 of the file of simulated people, "" for real people. UsageError: as of
    `records`, or there are records of other people.
    """
    begun = records(design)
    for record in begun.values():
        if record.header["simulated"] != people:
            told = "is of other people, real or simulated; move the data away first"
            raise UsageError(f"{record.path} {told}")
    return [code for code, record in begun.items() if exclusion(design, record) != UNFINISHED]


def admit(design: Design, code: str, people: str, now: str) -> TrialRecord:
    """Return the open record of a new participant, or of one who goes on.

    Its header has the participant's "number", from 0. people: as for `finished`, as are errors.
    UsageError: the code is not allowed, or participant or study has finished.
    """
    if not re.fullmatch("[A-Za-z0-9_]{1,32}", code):
        raise UsageError(f"--participant={code!r} is no code; allowed: 1 to 32 letters and digits")
    taken, done, most = records(design), finished(design, people), design.study.participants
    if code in done:
        raise UsageError(f"participant {code} has finished already; give a new code")
    if code not in taken and len(done) >= most:
        told = f"the design ends after {most} participants, and all have finished"
        raise UsageError(f"{told}; see `cushion study report {design.folder}`")
    number = max((one.header["number"] + 1 for one in taken.values()), default=0)
    header = {"participant": code, "number": number, "simulated": people, "begun": now}
    return TrialRecord(design.folder / DATA / f"{code}.jsonl", design.digest, header=header)


def exclusion(design: Design, record: TrialRecord) -> str:
    """Return why the design's rule excludes a participant, or ""."""
    study, counted = design.study, [row for row in record.trials if not row["practice"]]
    if len(record.trials) < len(session(design, record.header["number"])):
        return UNFINISHED
    median_s = float(np.median([row["answered_after_s"] for row in counted]))
    if median_s < study.fastest_s:
        return f"median answer after {median_s:.2f} s, under {study.fastest_s:g} s"
    for name, question in design.questions.items():
        if question.paradigm == "rating":
            own = [r for r in counted if (r["question"], r["tested"]) == (name, question.reference)]
            low = np.mean([row["answer"] < study.reference_below for row in own])
            if low > study.reference_share:
                told = f"rated the hidden reference under {study.reference_below:g} in"
                return f"{told} {100 * low:.0f} % of trials, over {100 * study.reference_share:g} %"
    return ""


def columns() -> list[str]:
    """Return the names of all columns of the table, from the codebook."""
    return re.findall(r"^\| `(\w+)` \|", (BUILT_IN / CODEBOOK).read_text(), re.MULTILINE)


def write_table(design: Design) -> Mapping[str, TrialRecord]:
    """Write all rows to `data/trials.csv`, and `codebook.md`; return the records, by code."""
    found, out = records(design), io.StringIO()
    table = csv.DictWriter(out, columns(), lineterminator="\n")
    table.writeheader()
    for code, record in found.items():
        more = {"participant": code, "excluded": exclusion(design, record)}
        for row in record.trials:
            table.writerow({**row, **more, "choices": "|".join(row["choices"])})
    (design.folder / DATA).mkdir(exist_ok=True)
    write_bytes_atomically(design.folder / DATA / TABLE, out.getvalue().encode())
    write_bytes_atomically(design.folder / CODEBOOK, (BUILT_IN / CODEBOOK).read_bytes())
    return found
