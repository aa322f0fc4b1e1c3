"""Make ``docs/benchmarks.md`` and its plots from the results in ``benchmarks/results``."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from strands_actors.testing.markdown import paragraph

from . import flames
from .house import HOUSE, OURS, RESULTS, Goal, Question, Result, Spread, Verdict

PAGE = HOUSE.parent / "docs" / "benchmarks.md"
PLOTS = HOUSE.parent / "docs" / "benchmarks"
OUR_NAME = "strands-actors"
UNITS = {
    "per_s": "1/s",
    "us": "µs",
    "ms": "ms",
    "s": "s",
    "hz": "Hz",
    "pct": "%",
    "mm": "mm",
    "deg": "°",
    "mb": "MB",
    "kb": "kB",
    "x": "×",
}
WIDE = 12
"""A table with more figures is transposed."""
LOG_FROM = 20.0
"""If values differ by more than this factor, the panel gets a logarithmic axis, and its title states this."""

PREFACE = """# Benchmarks

*Made by `python -m benchmarks --write` from `benchmarks/results/`; do not edit.*

Every table was measured in one run on one machine: each round runs all sides once, in shuffled
order. A side is one of the programs that are compared. Each cell is the median of a figure over the
rounds, with the lowest and the highest value as [lowest..highest]. If a goal is a ratio of two
sides, the ratio is computed for each round, and the median of the ratios is compared with the goal.
If the last column of a table of goals names another side, that side does only the unavoidable work.
If the side with only the unavoidable work also misses a goal, our code cannot meet that goal.
"""


def unit(figure: str) -> tuple[str, str]:
    """Return the name and the unit of a figure: ``"ask p50"`` and ``"µs"`` for ``"ask_p50_us"``. If the name
    ends with no known unit, return the whole name and an empty unit.
    """
    for suffix, name in UNITS.items():
        if figure.endswith(f"_{suffix}"):
            return figure.removesuffix(f"_{suffix}").replace("_", " "), name
    return figure.replace("_", " "), ""


def label(figure: str) -> str:
    name, its_unit = unit(figure)
    return f"{name}, {its_unit}" if its_unit else name


def number(value: float) -> str:
    """Return a number as text with three significant digits, with commas between thousands, and without an
    exponent.
    """
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{digits}f}"


def cell(spread: Spread | None, several: bool) -> str:
    if spread is None:
        return "–"
    if not several:
        return number(spread.median)
    return f"{number(spread.median)} [{number(spread.lowest)}..{number(spread.highest)}]"


def bound(goal: Goal) -> str:
    sign, value = ("≤", goal.at_most) if goal.at_most is not None else ("≥", goal.at_least)
    assert value is not None
    return f"{sign} {number(value)}" + (f" × {goal.beside}" if goal.beside else "")


def shown(side: str) -> str:
    return f"**{OUR_NAME}**" if side == OURS else side


def row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def table(result: Result) -> list[str]:
    """Return the result table in Markdown. It has one row per side (program), the one of this package first. If
    there are many figures, it has one row per figure.
    """
    sides = sorted(result.rounds[0], key=lambda side: (side != OURS, side))
    figures = result.figures()
    several = len(result.rounds) > 1
    head = ["", *(label(figure) for figure in figures)]
    rows = [[shown(side), *(cell(result.spread(side, figure), several) for figure in figures)] for side in sides]
    lines = [head, *rows] if len(figures) <= WIDE else [list(line) for line in zip(head, *rows, strict=True)]
    lines.insert(1, ["---"] * len(lines[0]))
    return [row(line) for line in lines]


def judged(question: Question, result: Result, verdict: Verdict) -> str:
    goal, several = verdict.goal, len(result.rounds) > 1
    cells = [
        label(goal.figure),
        bound(goal),
        cell(result.ratio(goal.figure, goal.beside), several),
        "met" if verdict.met else "**missed**",
    ]
    if question.ground:
        has_ground = result.spread(question.ground, goal.figure) is not None
        cells.append(cell(result.ratio(goal.figure, goal.beside, question.ground) if has_ground else None, several))
    return row(cells)


def goals(question: Question, result: Result) -> list[str]:
    if not question.goals:
        return []
    head = ["figure", "goal", "measured", "", *([f"{question.ground} alone"] if question.ground else [])]
    lines = [head, ["---"] * len(head)]
    rows = [judged(question, result, verdict) for verdict in result.verdicts(question.goals)]
    return ["", *(row(line) for line in lines), *rows]


def summary(questions: Mapping[str, Question], results: Sequence[Result]) -> list[str]:
    """Return a table in Markdown with one row per question: the number of its goals, and the number of goals that
    are met.
    """
    lines = ["| question | goals | met |", "| --- | --- | --- |"]
    for result in results:
        question = questions[result.name]
        met = [verdict.met for verdict in result.verdicts(question.goals)]
        anchor = "".join(each for each in question.title.lower() if each.isalnum() or each in " -_").replace(
            " ", "-"
        )
        if met:
            all_met = f"{sum(met)}" if all(met) else f"**{sum(met)}**"
            lines.append(f"| [{question.title}](#{anchor}) | {len(met)} | {all_met} |")
    return [*lines, ""]


def section(question: Question, result: Result) -> str:
    machine = result.machine
    conditions = (
        f"*{machine.date}, {machine.processor}, {machine.cores} cores, {machine.kernel}, Python {machine.python}, "
        f"load {machine.load_before} before; {len(result.rounds)} rounds{', short form' if result.short else ''}.*"
    )
    lines = [f"## {question.title}", "", paragraph(conditions), "", *table(result), *goals(question, result), ""]
    lines += [
        paragraph(f"**In practice.** {question.notice}"),
        "",
        "\n\n".join(paragraph(part) for part in f"**What limits it.** {question.limit}".split("\n\n")),
        "",
        f"![{question.title}](benchmarks/{question.name}.svg)",
        "",
        *time_profile(question),
    ]
    return "\n".join(lines)


def time_profile(question: Question) -> list[str]:
    """Return Markdown with the flame graph of the program with this package, if there is one, and the functions
    that take most time.
    """
    kept = flames.KEPT / f"{question.name}.txt"
    if not kept.exists():
        return []
    shares = flames.heaviest(flames.read(kept.read_text()))
    most = ", ".join(f"`{frame.partition(' (')[0]}` {share:.0%}" for frame, share in shares)
    drawing = f"![Processor time of our side](benchmarks/flames/{question.name}.svg)"
    shares_line = paragraph(f"Processor time of our side by function, including its calls in C: {most}.")
    return [shares_line, "", drawing, ""]


def plot(question: Question, result: Result, path: Path) -> None:
    """Draw one panel per figure that a goal names, or per figure if there are no goals.

    Bars begin at zero. If the values of the sides (programs) are too far apart for bars, a logarithmic axis with
    points is drawn, since the length of a bar has no meaning on it.
    """
    os.environ.setdefault("MPLBACKEND", "svg")
    import matplotlib

    # matplotlib makes random ids from this text, so equal figures give an equal file.
    matplotlib.rcParams["svg.hashsalt"] = question.name
    from matplotlib.figure import Figure

    named = list(dict.fromkeys(goal.figure for goal in question.goals)) or result.figures()
    sides = sorted(result.rounds[0], key=lambda side: (side != OURS, side))
    spreads = {figure: with_figure(result, sides, figure) for figure in named}
    drawing = Figure(figsize=(8, sum(0.32 * len(each) + 0.85 for each in spreads.values())), layout="constrained")
    panels = drawing.subplots(
        len(named), 1, squeeze=False, height_ratios=[len(each) + 2 for each in spreads.values()]
    )[:, 0]
    for panel, (figure, each) in zip(panels, spreads.items(), strict=True):
        far_apart = _draw(panel, each)
        better = "lower is better" if question.lower_is_better(figure) else "higher is better"
        axis = ", logarithmic axis" if far_apart else ""
        panel.set_title(f"{label(figure)} ({better}{axis})", fontsize=10, loc="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)


def _draw(panel: Any, spreads: dict[str, Spread]) -> bool:
    """Draw the median, lowest and highest value of each side (program) in one panel.

    Return True if the axis of the panel is logarithmic.
    """
    sides = list(spreads)[::-1]
    each = [spreads[side] for side in sides]
    medians = [spread.median for spread in each]
    far_apart = min(spread.lowest for spread in each) > 0 and max(medians) / min(medians) > LOG_FROM
    colours = ["#c2410c" if side == OURS else "#64748b" for side in sides]
    rows = range(len(sides))
    if far_apart:
        panel.set_xscale("log")
        panel.scatter(medians, rows, color=colours, s=45, zorder=3)
        panel.grid(axis="x", color="#e2e8f0", lw=0.8)
        panel.set_xlim(min(s.lowest for s in each) / 2, max(s.highest for s in each) * 4)
        panel.set_ylim(-0.6, len(sides) - 0.4)
    else:
        panel.barh(rows, medians, color=colours)
        panel.set_xlim(0, max(s.highest for s in each) * 1.15 or 1.0)
        panel.xaxis.set_major_formatter(lambda value, _: f"{value:,.10g}")
    away = [[s.median - s.lowest for s in each], [s.highest - s.median for s in each]]
    panel.errorbar(medians, rows, xerr=away, fmt="none", ecolor="#0f172a", capsize=3, lw=1, zorder=4)
    panel.set_yticks(rows, [OUR_NAME if side == OURS else side for side in sides])
    for row, spread in zip(rows, each, strict=True):
        panel.annotate(
            number(spread.median),
            (spread.highest, row),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(labelsize=9)
    return far_apart


def with_figure(result: Result, sides: list[str], figure: str) -> dict[str, Spread]:
    spreads = {side: result.spread(side, figure) for side in sides}
    return {side: spread for side, spread in spreads.items() if spread is not None}


def write(questions: Mapping[str, Question]) -> Path:
    """Write the page from all stored results of questions that still exist. Return the path of the page."""
    kept = [result for path in sorted(RESULTS.glob("*.json")) if (result := Result.read(path)).name in questions]
    sections = [section(questions[result.name], result) for result in kept]
    for samples in sorted(flames.KEPT.glob("*.txt")):
        flames.draw(flames.read(samples.read_text()), PLOTS / "flames" / f"{samples.stem}.svg")
    PAGE.write_text("\n".join([PREFACE, *summary(questions, kept), *sections]))
    return PAGE
