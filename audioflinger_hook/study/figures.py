"""Figures of the report, as SVG: estimates with their intervals, and the answers themselves."""

import io
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from audioflinger_hook.study.curves import LAPSES, probability
from audioflinger_hook.study.design import Question
from audioflinger_hook.study.estimates import Answered, Estimate, measure
from audioflinger_hook.study.trials import counted
from device.errors import NotFoundError, not_installed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WIDTH_IN, ROW_IN, DETAIL_IN = 4.9, 0.3, 2.6


def figure_svg(
    question: Question,
    estimate: Estimate,
    true: list[float] | None,
    answered: list[Answered],
    simulated: bool,
) -> str:
    """Return the figure of a question. true: true values, drawn as crosses; None if unknown.

    NotFoundError: matplotlib is missing.
    """
    try:
        from matplotlib.figure import Figure

        from audioflinger_hook.figures import palette
    except ImportError as error:
        raise NotFoundError(not_installed("matplotlib", "study")) from error
    groups = _groups(question, estimate)
    heights = [0.9 + ROW_IN * len(rows) for rows, _ in groups]
    details = {"synchrony": 1, "identification": len(question.conditions)}.get(question.paradigm, 0)
    heights += [DETAIL_IN] * details
    figure = Figure(figsize=(WIDTH_IN, sum(heights)), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(heights), 1, height_ratios=heights))
    features = measure(question, answered).features
    for ax, (rows, unit) in zip(axes, groups, strict=False):
        for y, i in enumerate(rows):
            if features.ndim == 2:
                own = np.full(len(features), y) + np.linspace(-0.16, 0.16, len(features))
                ax.plot(features[:, i], own, ".", color=palette.HEARD_LIGHT, ms=4)
            span = [estimate.lows[i], estimate.highs[i]]
            ax.plot(span, [y, y], color=palette.INK, lw=2.2, solid_capstyle="butt")
            ax.plot(estimate.values[i], y, "o", color=palette.INK, ms=6)
            if true is not None:
                ax.plot(true[i], y, "x", color=palette.FELT, ms=8, mew=2)
        ax.set_yticks(range(len(rows)), [_shown(estimate.names[i]) for i in rows])
        ax.set(ylim=(len(rows) - 0.5, -0.5), xlabel=unit)
        if unit == "log odds" or unit == "dB":
            ax.axvline(0.0, color=palette.GREY, lw=0.8, ls=":")
        _plain(ax)
    for ax, condition in zip(axes[len(groups) :], question.conditions, strict=False):
        if question.paradigm == "identification":
            _draw_confusion(ax, question, condition, answered)
        else:
            _draw_curves(ax, question, estimate, answered)
    if simulated:
        figure.text(
            0.5, 0.5, "SIMULATED", color=palette.FELT, alpha=0.16, fontsize=40, weight="bold",
            ha="center", va="center", rotation=16,
        )  # fmt: skip
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()
    what = f"{'SIMULATED ' * simulated}estimates of {question.name}; the table has the numbers"
    label = f'role="img" aria-label="{escape(what)}"'
    return svg[svg.index("<svg") :].replace("<svg", f"<svg {label}", 1)


def _groups(question: Question, estimate: Estimate) -> list[tuple[list[int], str]]:
    """Return the rows of each panel, and its unit."""
    places = list(range(len(estimate.names)))
    half = len(places) // 2
    if question.paradigm == "identification":
        return [(places[:half], "share of right answers"), (places[half:], "bits")]
    return [(places, estimate.unit)]


def _shown(name: str) -> str:
    return name.replace("$", r"\$")  # else matplotlib sets it as a formula


def _plain(ax: "Axes") -> None:
    for side in ("top", "right", "left"):
        ax.spines[side].set_visible(False)
    ax.tick_params(axis="y", length=0)


def _draw_confusion(
    ax: "Axes", question: Question, condition: str, answered: list[Answered]
) -> None:
    from audioflinger_hook.figures import palette

    names = list(question.stimuli)
    table = np.zeros((len(names), len(names)))
    for trial, answer in (row for rows in answered for row in rows):
        if trial.conditions[0] == condition:
            table[names.index(trial.stimulus), names.index(answer)] += 1.0
    table /= np.maximum(table.sum(axis=1, keepdims=True), 1.0)
    ax.imshow(table, cmap=palette.level_map(), vmin=0.0, vmax=1.0, aspect="auto")
    for (i, j), share in np.ndenumerate(table):
        colour = palette.WHITE if share > 0.45 else palette.INK
        ax.text(j, i, f"{100 * share:.0f} %", ha="center", va="center", color=colour)
    ax.set_xticks(range(len(names)), [*map(_shown, names)])
    ax.set_yticks(range(len(names)), [*map(_shown, names)])
    ax.set(xlabel="answer", ylabel="sound", title=_shown(condition))


def _draw_curves(
    ax: "Axes", question: Question, estimate: Estimate, answered: list[Answered]
) -> None:
    from audioflinger_hook.figures import palette

    rows = [row for person in answered for row in person]
    xs = np.array(sorted(question.offsets_ms))
    fine = np.linspace(xs[0], xs[-1], 200)
    for c, name in enumerate(question.conditions):
        of = [(t.offset_ms, counted(t, question, a)) for t, a in rows if t.conditions[0] == name]
        shares = np.array([np.mean([yes for at, yes in of if at == x]) for x in xs])
        colour = (palette.HEARD, palette.FELT, palette.INK, palette.GREY)[c % 4]
        ax.plot(xs, shares, "o", color=colour, label=_shown(name))
        values = np.array(estimate.values)
        place, jnd = values[c], values[len(question.conditions) + c]
        p = probability(question, fine, place, jnd)
        ax.plot(fine, 0.5 * LAPSES[1] + (1.0 - LAPSES[1]) * p, color=colour, lw=1.5)
    yes = "simultaneous" if question.judgement == "simultaneity" else '"sound first"'
    ax.set(xlabel="vibration after the sound (ms)", ylabel=f"share {yes}", ylim=(-0.03, 1.03))
    if len(question.conditions) > 1:
        ax.legend(frameon=False)
    _plain(ax)
