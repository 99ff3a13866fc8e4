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

from audioflinger_hook import __version__
from audioflinger_hook.study.curves import Curve, count
from audioflinger_hook.study.design import BUILT_IN, DESIGN, Design, Question
from audioflinger_hook.study.measure import Answered, estimate, measure, p_value
from audioflinger_hook.study.records import DATA, TABLE, Record
from audioflinger_hook.transform import TRANSFORM_VERSION
from device.errors import UsageError


def as_document(
    design: Design, registered: Mapping[str, Any], people: Sequence[Record]
) -> dict[str, Any]:
    """Return all results, for JSON. The table `data/trials.csv` must be written before.

    registered: the preregistration. UsageError: nobody has finished, or all are excluded.
    """
    excluded = {one.code: one.excluded for one in people if one.excluded}
    kept = [one.rows for one in people if not one.excluded]
    if not kept:
        why = "; ".join(sorted({*excluded.values()})) or "nobody began"
        raise UsageError(f"{design.folder} has no finished participant ({why}); run the study")
    begun, when = min(str(one.header["begun"]) for one in people), str(registered["registered"])
    table = sha256((design.folder / DATA / TABLE).read_bytes()).hexdigest()
    return {
        "title": design.study.title,
        "simulated": bool(people[0].header["simulated"]),
        "registered": when if when <= begun else None,
        "participants": {"wanted": design.study.participants, "began": len(people)},
        "excluded": excluded,
        "versions": {
            f"SHA-256 of {DESIGN}": design.digest,
            f"SHA-256 of {TABLE}": table,
            "haptic-cushion": __version__,
            "transform": str(TRANSFORM_VERSION),
            "Python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "scipy")},
        },
        "questions": {
            name: _results(
                question,
                [
                    [row for row in rows if row["question"] == name and not row["practice"]]
                    for rows in kept
                ],
                design.study.seed,
            )
            for name, question in design.questions.items()
        },
    }


def page(document: Mapping[str, Any]) -> str:
    """Return the report as HTML, which needs no network. document: of `as_document`."""
    template = Template((BUILT_IN / "report.html").read_text())
    data = json.dumps(document).replace("<", "\\u003c")  # so that no name ends the script
    script = (BUILT_IN / "report.js").read_text()
    return template.substitute(title=escape(document["title"]), document=data, script=script)


def _results(question: Question, answered: Sequence[Answered], seed: int) -> dict[str, Any]:
    measured = measure(question, answered)
    each, values = measured.features, estimate(measured, seed)
    ends = [[None if np.isnan(one) else one for one in row] for row in values.tolist()]
    own = each.T.tolist() if each.ndim == 2 else [[]] * len(measured.names)
    columns = zip(*ends, own, strict=True)
    found: dict[str, Any] = {
        "paradigm": question.paradigm,
        "exploratory": question.exploratory,
        "participants": len(answered),
        "unit": question.kind["unit"],
        "p": p_value(measured),
        "estimates": {
            name: dict(zip(("value", "low", "high", "people"), one, strict=True))
            for name, one in zip(measured.names, columns, strict=True)
        },
    }
    if question.paradigm == "identification":
        shares = each.sum(axis=0) / np.maximum(each.sum(axis=(0, 3))[..., None], 1.0)
        found["sounds"] = list(question.stimuli)
        found["confusion"] = dict(zip(question.conditions, shares.tolist(), strict=True))
    elif question.kind["varies"] != "nothing":
        curve = Curve(question)
        counts = count((row for rows in answered for row in rows), curve.axes).sum(axis=1)
        found["curves"] = {
            name: [
                [x, yes / (yes + no)]
                for x, (yes, no) in zip(curve.axes["varied"], row, strict=True)
                if yes + no
            ]
            for name, row in zip(curve.tested, counts.tolist(), strict=True)
        }
    return found
