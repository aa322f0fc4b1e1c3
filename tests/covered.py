"""Record how much of the code the tests run: ``docs/coverage.json``, and the figure in ``docs/testing.md``.

``python -m tests coverage`` calls ``record`` at the end of a whole run. ``python -m tests.covered`` writes the
recorded figure into the page again, for example after a change of its words.
"""

from __future__ import annotations

import json
import os
import platform
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build" / "coverage"
MEASURED = BUILD / "report.json"
"""The report of coverage.py."""
TESTS = BUILD / "tests.xml"
"""The results of the tests, in the format of JUnit."""
RECORD = ROOT / "docs" / "coverage.json"
PAGE = ROOT / "docs" / "testing.md"
BEGIN, END = "<!-- coverage: begin -->", "<!-- coverage: end -->"
PLACE = re.compile(rf"(?<={re.escape(BEGIN)}\n).*?(?={re.escape(END)})", re.DOTALL)
OTHERS = "other modules"
PACKAGE = "strands_actors"


def unmeasured() -> dict[str, str]:
    """Return the environment for a program that is not measured, such as mypy. It would take many times as long."""
    return {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE_")}


def figures(report: Mapping[str, Any], tests: str, day: date) -> dict[str, Any]:
    """Return the figures that are recorded.

    Args:
        report: The JSON report of coverage.py.
        tests: The results of the tests, in the format of JUnit.
        day: The day of the run.
    """
    suites = list(ElementTree.fromstring(tests).iter("testsuite"))

    def count(*names: str) -> int:
        return sum(int(suite.get(name, 0)) for suite in suites for name in names)

    folders: dict[str, dict[str, int]] = {}
    for path, file in report["files"].items():
        sums = folders.setdefault(_folder(path), {"lines": 0, "run": 0})
        for name, value in _counts(file["summary"]).items():
            sums[name] += value
    return {
        "date": day.isoformat(),
        "python": ".".join(platform.python_version_tuple()[:2]),
        "machine": f"{platform.system()} {platform.machine()}",
        "tests": count("tests"),
        "failed": count("failures", "errors"),
        "total": _counts(report["totals"]),
        "folders": dict(sorted(folders.items())),
    }


def _counts(summary: Mapping[str, Any]) -> dict[str, int]:
    return {"lines": summary["num_statements"], "run": summary["covered_lines"]}


def _folder(path: str) -> str:
    parts = path.split("/")
    parts = parts[1:] if parts[0] == PACKAGE else parts  # drivers and supervisors are links in the package
    return parts[0] if len(parts) > 1 else OTHERS


def percent(counts: Mapping[str, int]) -> float:
    """Return the share of the lines that were run; 100 for a folder without code."""
    return 100.0 * counts["run"] / counts["lines"] if counts["lines"] else 100.0


def paragraph(recorded: Mapping[str, Any] | None) -> str:
    """Return the text of the page, with the recorded figures; without a record it says that there is none."""
    if recorded is None:
        return "The share of the code that the tests run has not been recorded yet.\n"
    total = recorded["total"]
    day = date.fromisoformat(recorded["date"])
    failed = f"{recorded['failed']} of them failed in this run" if recorded["failed"] else "all passed"
    lines = [
        f"On {day.day} {day:%B %Y} the ordinary tests ran **{percent(total):.1f} %** of the code:",
        f"{_thousands(total['run'])} of {_thousands(total['lines'])} lines",
        f"(Python {recorded['python']}, {recorded['machine']}, {_thousands(recorded['tests'])} tests: {failed}).",
        "",
        "| folder | run | lines |",
        "|---|---:|---:|",
    ]
    lines += [
        f"| {name if name == OTHERS else f'`{name}`'} | {percent(counts):.1f} % | {_thousands(counts['lines'])} |"
        for name, counts in recorded["folders"].items()
    ]
    return "\n".join(lines) + "\n"


def _thousands(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def page_with(page: str, recorded: Mapping[str, Any] | None) -> str:
    """Return the page with the figures.

    Raises:
        ValueError: The page does not have the two marks exactly once.
    """
    if len(PLACE.findall(page)) != 1:
        raise ValueError(f"{PAGE.name} must have {BEGIN} and {END} once")
    text = paragraph(recorded)
    return PLACE.sub(lambda _: text, page)


def read() -> dict[str, Any] | None:
    return json.loads(RECORD.read_text()) if RECORD.exists() else None


def record() -> None:
    """Record the figures of the last whole run, and write them into the page."""
    found = figures(json.loads(MEASURED.read_text()), TESTS.read_text(), date.today())
    RECORD.write_text(json.dumps(found, indent=2) + "\n")
    write()
    print(f"{RECORD.relative_to(ROOT)}: {percent(found['total']):.1f} %")


def write() -> None:
    PAGE.write_text(page_with(PAGE.read_text(), read()))


if __name__ == "__main__":
    write()
    sys.exit(0)
