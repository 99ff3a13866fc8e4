"""The report of a study: one document, and a page that draws its figures and tables."""

import json
import platform
from collections.abc import Mapping, Sequence
from hashlib import sha256
from html import escape
from importlib.metadata import version
from string import Template
from typing import Any

import numpy as np

from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, Question
from audioflinger_hook.study.measure import Answered, Curve, count, estimate, measure, p_value
from audioflinger_hook.study.records import DATA, TABLE, exclusion, write_table
from audioflinger_hook.transform import TRANSFORM_VERSION
from device.errors import UsageError


def as_document(design: Design, registered: str) -> dict[str, Any]:
    """Return all results, for JSON, and write the table.

    registered: time of the preregistration. UsageError: no participant can be analysed.
    """
    people = write_table(design)
    why = {code: exclusion(design, one) for code, one in people.items()}
    kept = [one.trials for code, one in people.items() if not why[code]]
    if not kept:
        told = "; ".join(sorted({*why.values()})) or "nobody began"
        raise UsageError(f"{design.folder} has no finished participant ({told}); run the study")
    begun = min(one.header["begun"] for one in people.values())
    versions = {"transform": str(TRANSFORM_VERSION), "Python": platform.python_version()}
    versions |= {name: version(name) for name in ("haptic-cushion", "numpy", "scipy")}
    for path in (design.folder / DESIGN, design.folder / DATA / TABLE):
        versions[f"SHA-256 of {path.name}"] = sha256(path.read_bytes()).hexdigest()
    questions = {}
    for name, question in design.questions.items():
        own = [[r for r in rows if r["question"] == name and not r["practice"]] for rows in kept]
        questions[name] = _results(question, own, design.study.seed)
    return {
        "title": design.study.title,
        "simulated": any(one.header["simulated"] for one in people.values()),
        "registered": registered if registered <= begun else None,
        "participants": {"wanted": design.study.participants, "began": len(people)},
        "excluded": {code: one for code, one in why.items() if one},
        "versions": versions,
        "questions": questions,
    }


def page(document: Mapping[str, Any]) -> str:
    """Return the report as HTML, which needs no network. document: of `as_document`."""
    template = Template((BUILT_IN / "report.html").read_text())
    data = json.dumps(document).replace("<", "\\u003c")  # so that no name ends the script
    script = (BUILT_IN / "report.js").read_text()
    return template.substitute(title=escape(document["title"]), document=data, script=script)


def _results(question: Question, answered: Sequence[Answered], seed: int) -> dict[str, Any]:
    measured = measure(question, answered)
    each, ends = measured.features, estimate(measured, seed).T.tolist()
    own = each.T.tolist() if each.ndim == 2 else [[]] * len(ends)
    found: dict[str, Any] = {
        "paradigm": question.paradigm,
        "exploratory": question.exploratory,
        "participants": len(answered),
        "unit": question.kind["unit"],
        "p": p_value(measured),
        "estimates": {},
    }
    for name, (value, *interval), points in zip(measured.names, ends, own, strict=True):
        low, high = (None if np.isnan(one) else one for one in interval)
        found["estimates"][name] = {"value": value, "low": low, "high": high, "people": points}
    if question.paradigm == "identification":
        shares = each.sum(axis=0) / np.maximum(each.sum(axis=(0, 3))[..., None], 1.0)
        found["sounds"] = list(question.stimuli)
        found["confusion"] = dict(zip(question.conditions, shares.tolist(), strict=True))
    elif question.kind["varies"] != "nothing":
        curve = Curve(question)
        counts = count((row for rows in answered for row in rows), curve.axes).sum(axis=1)
        found["curves"] = {
            name: [[x, a / (a + b)] for x, (a, b) in zip(curve.xs, row, strict=True) if a + b]
            for name, row in zip(curve.tested, counts.tolist(), strict=True)
        }
    return found
