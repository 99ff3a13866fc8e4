"""The report of a study: one document, and a page that draws its figures and tables."""

import json
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from hashlib import sha256
from html import escape
from importlib.metadata import version
from string import Template
from typing import Any

import numpy as np

from audioflinger_hook import __version__
from audioflinger_hook.study.curves import LAPSES, Curve, probability
from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, Question
from audioflinger_hook.study.estimates import estimate, p_values
from audioflinger_hook.study.paradigms import Answered, measure
from audioflinger_hook.study.records import DATA, TABLE, Participant
from audioflinger_hook.transform import TRANSFORM_VERSION
from device.errors import UsageError
from device.units import FloatArray

LIBRARIES = ("numpy", "scipy")


def as_document(
    design: Design, registered: Mapping[str, Any], people: Sequence[Participant]
) -> dict[str, Any]:
    """Return all results, for JSON. The table `data/trials.csv` must be written before.

    registered: the preregistration. UsageError: nobody has finished, or all are excluded.
    """
    kept = [one for one in people if not one.excluded]
    if not kept:
        told = Counter(one.excluded.partition(",")[0] for one in people)
        why = "; ".join(f"{count} {reason}" for reason, count in told.items()) or "nobody began"
        raise UsageError(f"{design.folder} has no finished participant ({why}); run the study")
    begun = min(str(one.header.get("begun")) for one in people)
    when = str(registered.get("registered", "unknown"))
    table = (design.folder / DATA / TABLE).read_bytes()
    versions = {f"SHA-256 of {DESIGN}": design.digest, f"SHA-256 of {TABLE}": _sha256(table)}
    versions |= {"haptic-cushion": __version__, "transform": str(TRANSFORM_VERSION)}
    versions |= {"Python": platform.python_version()} | {name: version(name) for name in LIBRARIES}
    return {
        "title": design.study.title,
        "simulated": bool(people[0].header.get("simulated")),
        "registered": when if when <= begun else None,
        "participants": {"wanted": design.study.participants, "began": len(people)},
        "excluded": {one.code: one.excluded for one in people if one.excluded},
        "versions": versions,
        "questions": {name: _results(design, one, kept) for name, one in design.questions.items()},
    }


def page(document: Mapping[str, Any]) -> str:
    """Return the report as HTML, which needs no network. document: of `as_document`."""
    template = Template((BUILT_IN / "report.html").read_text())
    data = json.dumps(document).replace("<", "\\u003c")  # so that no name ends the script
    script = (BUILT_IN / "report.js").read_text()
    return template.substitute(title=escape(document["title"]), document=data, script=script)


def _sha256(content: bytes) -> str:
    return sha256(content).hexdigest()


def _results(design: Design, question: Question, people: Sequence[Participant]) -> dict[str, Any]:
    answered = [
        [row for row in one.rows if row["question"] == question.name and not row["practice"]]
        for one in people
    ]
    measured = measure(question, answered)
    values = estimate(measured, design.study.seed)
    (p, p_of), each = p_values(measured), measured.features
    own = each.T if each.ndim == 2 else np.empty((len(measured.names), 0))
    ends = [[None if np.isnan(one) else one for one in row] for row in values.tolist()]
    found: dict[str, Any] = {
        "paradigm": question.paradigm,
        "exploratory": question.exploratory,
        "participants": len(people),
        "unit": question.kind["unit"],
        "p": p,
        "tests": p_of,
        "estimates": {
            name: {"value": value, "low": low, "high": high, "people": points.tolist()}
            for name, value, low, high, points in zip(measured.names, *ends, own, strict=True)
        },
    }
    if question.paradigm == "identification":
        shares = each.sum(axis=0) / np.maximum(each.sum(axis=(0, 3))[..., None], 1.0)
        found["sounds"] = list(question.stimuli)
        found["confusion"] = dict(zip(question.conditions, shares.tolist(), strict=True))
    elif question.paradigm == "synchrony":
        found["curves"] = _curves(question, values[0], answered)
    return found


def _curves(question: Question, values: FloatArray, answered: Sequence[Answered]) -> dict[str, Any]:
    """Return shares of counted answers at each delay, and the fitted curve, by condition."""
    curve, found = Curve(question), {}
    fine = np.linspace(curve.xs[0], curve.xs[-1], 81)
    counts = curve.counts(row for rows in answered for row in rows)
    for c, name in enumerate(question.conditions):
        yes, no = np.sum([one for key, one in counts.items() if key[0] == name], axis=0)
        p = probability(question, fine, values[c], values[len(question.conditions) + c])
        fitted = 0.5 * LAPSES[1] + (1.0 - LAPSES[1]) * p
        shares = [curve.xs, yes / np.maximum(yes + no, 1.0)]
        columns = {"x": shares[0], "share": shares[1], "fit_x": fine, "fit": fitted}
        found[name] = {key: column.round(4).tolist() for key, column in columns.items()}
    return found
