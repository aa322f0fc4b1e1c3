"""Write the report on a dataset as one HTML file, which needs no other file and no network."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from .findings import Finding, Kind
from .measure import EpisodeReport, Report

TITLES: dict[Kind, str] = {
    Kind.DAMAGED: "Damaged",
    Kind.GAPS: "Missing frames",
    Kind.LATE: "Late data",
    Kind.SAME_MOTION: "Same motion twice",
    Kind.SAME_PICTURES: "Same pictures twice",
    Kind.STILL: "Pictures that stand still",
    Kind.REPEATED: "Repeated readings",
    Kind.MARK: "Marked",
    Kind.LENGTH: "Unusual length",
    Kind.LOW: "Unusual smallest command",
    Kind.HIGH: "Unusual largest command",
    Kind.SPEED: "Unusual speed",
    Kind.JERK: "Unusual jerk",
    Kind.BEGIN: "Unusual start",
    Kind.BRIGHTNESS: "Unusual brightness",
    Kind.UNUSED: "Unused joint",
}
MEANINGS: dict[Kind, str] = {
    Kind.DAMAGED: "The files of the episode are damaged, so it was not read. Restore them from a copy.",
    Kind.GAPS: "The recorder could not write these frames. The frames around a gap follow each other directly.",
    Kind.LATE: "The state or a picture was older than 1.5 periods when it was recorded.",
    Kind.SAME_MOTION: "Commands and readings equal those of another episode. Keep one of the two.",
    Kind.SAME_PICTURES: "The pictures equal those of another episode. Keep one of the two.",
    Kind.STILL: "The camera gave the same picture for half a second or longer while the robot moved.",
    Kind.REPEATED: "The reading did not change for half a second or longer while the command changed.",
    Kind.MARK: "`strands-actors dataset label` has marked the episode.",
    Kind.LENGTH: "The episode is much longer or shorter than the others.",
    Kind.LOW: "The range of a joint begins far from where it begins in the other episodes.",
    Kind.HIGH: "The range of a joint ends far from where it ends in the other episodes.",
    Kind.SPEED: "The largest step of a command is unusual. A jump in the data is one cause.",
    Kind.JERK: "The motion is much rougher or smoother than that of the other episodes.",
    Kind.BEGIN: "The robot began far from the position in which the other episodes begin.",
    Kind.BRIGHTNESS: "The pictures are much brighter or darker than those of the other episodes.",
    Kind.UNUSED: "The joint has the same command in every frame, so a policy cannot learn to move it.",
}
BINS = 24
CURVE_WIDTH, CURVE_HEIGHT = 240, 60
COLOURS = ("#2f6fde", "#d9480f", "#2b8a3e", "#9c36b5", "#b08900", "#0b7285", "#c2255c", "#5c677d")


def write_page(report: Report, path: Path) -> None:
    """Write the page. An older file of this name stays until the new one is complete.

    Raises:
        OSError: The file cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(page(report), encoding="utf-8")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def page(report: Report) -> str:
    """Return the report as HTML."""
    # Texts of the dataset, such as tasks, are escaped, because anybody may have written them.
    environment = Environment(
        loader=PackageLoader(__package__ or "", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters |= {"number": number, "line": line}
    return environment.get_template("page.html").render(
        report=report,
        groups=list(_groups(report)),
        titles=TITLES,
        bars=_bars([episode.seconds for episode in report.episodes]),
        curves=_curves,
        colours=COLOURS,
        curve_size=(CURVE_WIDTH, CURVE_HEIGHT),
    )


def _groups(report: Report) -> Iterator[tuple[str, str, list[Finding]]]:
    """Yield each kind of finding that there is: its title, its meaning and its findings."""
    for kind in Kind:
        if findings := [finding for finding in report.findings if finding.kind is kind]:
            yield TITLES[kind], MEANINGS[kind], findings


def line(finding: Finding) -> str:
    """Return what was found, in a few words."""
    value = "" if finding.value is None else number(finding.value)
    match finding.kind:
        case Kind.DAMAGED | Kind.MARK:
            return finding.text
        case Kind.SAME_MOTION | Kind.SAME_PICTURES:
            return " ".join(filter(None, (finding.name, f"as episode {value}")))
        case Kind.GAPS | Kind.LATE | Kind.STILL | Kind.REPEATED:
            return " ".join(filter(None, (finding.name, f"{value} frames")))
        case Kind.UNUSED:
            return f"{finding.name} is always {value}"
        case Kind.LENGTH:
            return f"{value} s, usually {number(finding.usual or 0.0)} s"
        case Kind.BEGIN:
            return f"{finding.value:.0%} of a joint's range away, usually {finding.usual:.0%}"
    return " ".join(filter(None, (finding.name, f"{value}, usually {number(finding.usual or 0.0)}")))


def number(value: float) -> str:
    """Return a number with three digits, and without an exponent for usual sizes."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:,.0f}"


def _bars(seconds: list[float]) -> list[tuple[float, float, int]]:
    """Return a histogram of lengths: begin and end of each bar in seconds, and the number of episodes."""
    if not seconds:
        return []
    low, high = min(seconds), max(seconds)
    width = (high - low) / BINS or 1.0
    counts = [0] * BINS
    for each in seconds:
        counts[min(BINS - 1, int((each - low) / width))] += 1
    return [(low + width * place, low + width * (place + 1), count) for place, count in enumerate(counts)]


def _curves(episode: EpisodeReport) -> list[str]:
    """Return the points of each joint's curve, as SVG has them."""
    return [
        " ".join(
            f"{CURVE_WIDTH * place / max(1, len(curve) - 1):.1f},{(1 - value) * (CURVE_HEIGHT - 4) + 2:.1f}"
            for place, value in enumerate(curve)
        )
        for curve in episode.curves
    ]
