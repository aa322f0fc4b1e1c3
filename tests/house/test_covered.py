"""The figure of the coverage on the page is the recorded one."""

from __future__ import annotations

import json
from datetime import date
from typing import Any

import pytest

from tests import covered

SUITES = '<testsuites><testsuite tests="1204" failures="2" errors="1" skipped="0"/></testsuites>'


def summary(lines: int, run: int) -> dict[str, Any]:
    return {"num_statements": lines, "covered_lines": run, "percent_covered": 0.0}


REPORT = {
    "files": {
        "supervisors/wire/transport.py": {"summary": summary(420, 400)},
        "supervisors/refusals.py": {"summary": summary(80, 80)},
        "strands_actors/kernel/actor.py": {"summary": summary(1000, 990)},
        "strands_actors/version.py": {"summary": summary(0, 0)},
    },
    "totals": summary(1500, 1470),
}


def test_the_figures_are_summed_by_folder_and_are_those_of_the_report() -> None:
    found = covered.figures(REPORT, SUITES, date(2026, 11, 3))
    assert found["folders"] == {
        "kernel": {"lines": 1000, "run": 990},
        "other modules": {"lines": 0, "run": 0},
        "supervisors": {"lines": 500, "run": 480},
    }
    assert (found["tests"], found["failed"], found["date"]) == (1204, 3, "2026-11-03")
    assert covered.percent(found["total"]) == pytest.approx(98.0)
    assert json.loads(json.dumps(found)) == found


def test_the_page_shows_the_figures_with_their_day_and_the_failed_tests() -> None:
    text = covered.paragraph(covered.figures(REPORT, SUITES, date(2026, 11, 3)))
    assert text.startswith("On 3 November 2026 the ordinary tests ran **98.0 %** of the code:\n")
    assert "1 470 of 1 500 lines\n" in text
    assert "1 204 tests: 3 of them failed in this run)" in text
    assert "| `supervisors` | 96.0 % | 500 |\n" in text
    assert "| other modules | 100.0 % | 0 |\n" in text
    page = f"before\n{covered.BEGIN}\nold\n{covered.END}\nafter\n"
    assert covered.page_with(page, None) == page.replace("old\n", covered.paragraph(None))
    with pytest.raises(ValueError, match="once"):
        covered.page_with("before", None)


def test_the_page_has_the_recorded_figures() -> None:
    page = covered.PAGE.read_text()
    assert page == covered.page_with(page, covered.read()), "run python -m tests.covered"
