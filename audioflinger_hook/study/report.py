"""The report of a study: one page with a figure and a table for each question."""

import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from html import escape
from importlib.metadata import version
from importlib.resources import files
from string import Template
from typing import Any

from audioflinger_hook import __version__
from audioflinger_hook.study.design import DESIGN, Design, Question
from audioflinger_hook.study.estimates import Answered, Estimate, estimate, measure, truth
from audioflinger_hook.study.figures import figure_svg
from audioflinger_hook.study.people import People
from audioflinger_hook.study.records import DATA, TABLE, Participant
from audioflinger_hook.study.session import trial_of
from audioflinger_hook.study.trials import FIRST, SECOND
from audioflinger_hook.transform import TRANSFORM_VERSION
from device.errors import UsageError
from device.values import counted

FEW = 8  # under so many people, a bootstrap is too optimistic
LIBRARIES = ("numpy", "scipy", "matplotlib")

Results = dict[str, tuple[Estimate, list[float] | None, list[Answered]]]
"""The estimate, true values if known, and answers of each question."""


def results(design: Design, people: Sequence[Participant], truths: People | None) -> Results:
    """Return each question's estimate, true values if `truths` is given, and answers.

    UsageError: nobody has finished, or all are excluded.
    """
    kept = [one for one in people if not one.excluded]
    if not kept:
        told = Counter(one.excluded.partition(",")[0] for one in people)
        why = "; ".join(f"{count} {reason}" for reason, count in told.items()) or "nobody began"
        raise UsageError(f"{design.folder} has no finished participant ({why}); run the study")
    found = {}
    for name, question in design.questions.items():
        answered = [_answers(one, name) for one in kept]
        true = None if truths is None else [float(v) for v in truth(question, truths)]
        found[name] = estimate(measure(question, answered), design.study.seed), true, answered
    return found


def _answers(participant: Participant, name: str) -> Answered:
    rows = [r for r in participant.rows if r["question"] == name and not r["practice"]]
    return [(trial_of(row), row["answer"]) for row in rows]


def as_document(found: Results) -> Any:
    """Return the estimates for JSON."""
    document = {}
    for name, (one, true, _) in found.items():
        columns = zip(one.names, one.values, one.lows, one.highs, strict=True)
        document[name] = {
            "participants": one.people,
            "unit": one.unit,
            "p": one.p,
            "tests": dict(one.p_of),
            "estimates": {
                label: {"value": float(v), "low": float(low), "high": float(high)}
                | ({} if true is None else {"true": true[i]})
                for i, (label, v, low, high) in enumerate(columns)
            },
        }
    return document


def page(
    design: Design,
    registered: dict[str, Any] | None,
    people: Sequence[Participant],
    found: Results,
) -> str:
    """Return the report as HTML. registered: the preregistration; None if there is none.

    The table `data/trials.csv` must be written before. NotFoundError: matplotlib is missing.
    """
    simulated = bool(people[0].header.get("simulated"))
    begun = min(str(one.header.get("begun")) for one in people)
    is_before = registered is not None and str(registered["registered"]) <= begun
    parts = [_question(design, name, *found[name], simulated) for name in design.questions]
    planned = [
        part
        for part, question in zip(parts, design.questions.values(), strict=True)
        if is_before and not question.exploratory
    ]
    further = [part for part in parts if part not in planned]
    further += [_closer(design.questions[name], found[name][2]) for name in design.questions]
    when = "was not registered before the first participant began"
    if registered is not None and is_before:
        when = f"was registered on {registered['registered']}, before the first participant began"
    template = (files("audioflinger_hook.study") / "built_in/report.html").read_text()
    return Template(template).substitute(
        title=escape(design.study.title),
        banner="<p class=simulated>SIMULATED: no person took part</p>" if simulated else "",
        people=_people(design, people),
        registered=f"The design {when}.",
        planned="".join(planned) or "<p>There is none.</p>",
        further="".join(further) or "<p>There is none.</p>",
        versions=_versions(design),
    )


def _question(
    design: Design,
    name: str,
    one: Estimate,
    true: list[float] | None,
    answered: list[Answered],
    simulated: bool,
) -> str:
    question = design.questions[name]
    figure = figure_svg(question, one, true, answered, simulated)
    tests = "".join(f"<tr><td>{escape(label)}<td>{_p(p)}" for label, p in one.p_of.items())
    if tests:
        together = f"All comparisons together: {_p(one.p)} (Hotelling's T²)."
        tests = (
            f"<p>{together}</p><div class=wide><table><tr><th>comparison<th>p after Holm{tests}"
            "</table></div>"
        )
    legend = (
        "Dot: estimate. Line: 95 % interval. Small dots: participants, if each has an estimate."
    )
    legend += " Cross: true value." if true else ""
    legend += " With so few people, the intervals are too short." if one.people < FEW else ""
    figure = f"<figure>{figure}<figcaption>{legend}</figcaption></figure>"
    heading = f"{escape(name)} <small>{question.paradigm}, {counted(one.people, 'people')}</small>"
    return f"<section><h3>{heading}</h3>{figure}{_table(one, true)}{tests}</section>"


def _table(one: Estimate, true: list[float] | None) -> str:
    head = f"<tr><th>{escape(one.unit)}<th>estimate<th>95 % interval"
    rows = [head + ("<th>true" if true else "")]
    for i, label in enumerate(one.names):
        value, low, high = (_number(x[i], one.unit) for x in (one.values, one.lows, one.highs))
        cells = f"<tr><td>{escape(label)}<td>{value}<td>{low} to {high}"
        rows.append(cells + (f"<td>{_number(true[i], one.unit)}" if true else ""))
    return f"<div class=wide><table>{''.join(rows)}</table></div>"


def _number(value: float, unit: str) -> str:
    return f"{value:.{1 if unit in ('ms', 'dB', 'of 100') else 2}f}".replace("-", "−")


def _closer(question: Question, answered: list[Answered]) -> str:
    """Return exploratory tables: each sound alone, and how often the first interval was chosen."""
    parts = []
    sounds = question.stimuli if question.paradigm != "identification" else ()
    for sound in sounds if len(sounds) > 1 else ():
        alone = [[(t, a) for t, a in rows if t.stimulus == sound] for rows in answered]
        one = estimate(measure(replace(question, stimuli=(sound,)), alone), 1)
        parts.append(f"<h4>{escape(sound)} only</h4>{_table(one, None)}")
    chosen = [a for rows in answered for t, a in rows if set(t.choices) == {FIRST, SECOND}]
    if chosen:
        share = 100.0 * chosen.count(FIRST) / len(chosen)
        parts.append(f"<p>The first interval was chosen in {share:.1f} % of trials.</p>")
    name = f"<summary>{escape(question.name)}, in more detail</summary>"
    return f"<details>{name}{''.join(parts)}</details>" if parts else ""


def _people(design: Design, people: Sequence[Participant]) -> str:
    out = [one for one in people if one.excluded]
    text = (
        f"<p>{counted(len(people), 'participants')} began, {len(people) - len(out)} are analysed. "
        f"The design ends after {design.study.participants}.</p>"
    )
    if out:
        rows = "".join(f"<tr><td>{escape(p.code)}<td>{escape(p.excluded)}" for p in out)
        text += f"<div class=wide><table><tr><th>excluded<th>reason{rows}</table></div>"
    return text


def _versions(design: Design) -> str:
    table = (design.folder / DATA / TABLE).read_bytes()
    of = {"haptic-cushion": __version__, "transform": TRANSFORM_VERSION}
    of["Python"] = platform.python_version()
    of |= {name: version(name) for name in LIBRARIES}
    rows = [
        (f"SHA-256 of {DESIGN}", design.digest),
        (f"SHA-256 of {TABLE}", sha256(table).hexdigest()),
    ]
    rows += [(name, str(one)) for name, one in of.items()]
    return "".join(f"<tr><td>{name}<td><code>{escape(one)}</code>" for name, one in rows)


def _p(p: float | None) -> str:
    if p is None:
        return "p is unknown: too few participants"
    return "p &lt; 0.001" if p < 0.001 else f"p = {p:.3f}"
