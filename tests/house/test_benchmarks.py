"""The short form of the benchmarks runs with the peers that the tests install. No test asserts a speed. The
figures are in docs/benchmarks.md."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import house, page
from benchmarks.house import Goal, Machine, Question, Result

INSTALLED = ("trio", "pykka")
FAST = ("tell", "ask", "urgent", "virtual")


@pytest.mark.long
@pytest.mark.parametrize("name", FAST)
def test_a_short_form_gives_the_figures_that_its_goals_judge(name: str) -> None:
    """The benchmark must run and give its figures. Speeds are measured on a quiet machine only."""
    question = house.questions()[name].among(*INSTALLED)
    assert question.goals and question.short
    verdicts = house.run(question, rounds=1, short=True).verdicts(question.goals)
    assert len(verdicts) == len(question.goals) and all(verdict.value > 0 for verdict in verdicts)
    assert all(verdict.met for verdict in verdicts if verdict.goal.figure == "same_trace")


def test_every_result_that_is_kept_has_its_question_and_stands_on_the_page() -> None:
    asked, written = house.questions(), page.PAGE.read_text() if page.PAGE.exists() else ""
    for path in house.RESULTS.glob("*.json"):
        result = Result.read(path)
        assert page.section(asked[result.name], result) in written, "run python -m benchmarks --page"


def test_rounds_are_interleaved_and_ratios_are_taken_within_a_round() -> None:
    calls: list[str] = []

    def side(name: str, *values: float) -> house.Side:
        given = iter(values)

        def run(short: bool) -> house.Figures:
            calls.append(name)
            return {"took_us": next(given)}

        return run

    question = Question(
        "q",
        "?",
        {"ours": side("ours", 1.0, 10.0, 3.0), "theirs": side("theirs", 2.0, 100.0, 6.0)},
        (Goal("took_us", "theirs", at_most=0.5), Goal("took_us", "", at_most=2.0)),
        "",
        "",
    )
    result = house.run(question, rounds=3, short=True)
    assert [sorted(calls[at : at + 2]) for at in (0, 2, 4)] == [["ours", "theirs"]] * 3
    beside, alone = result.verdicts(question.goals)
    assert (beside.value, beside.met) == (0.5, True)
    assert (alone.value, alone.met) == (3.0, False)
    assert result.spread("theirs", "took_us") == house.Spread(6.0, 2.0, 100.0)


def test_a_failed_side_raises_an_error_with_its_output() -> None:
    with pytest.raises(RuntimeError, match=r"No module named benchmarks.*nobody"):
        house.beside("benchmarks.sides.nobody")


def test_a_goal_has_one_bound_and_a_side_that_exists() -> None:
    with pytest.raises(ValueError, match="Give one"):
        Goal("took_us", "")
    with pytest.raises(ValueError, match="its goals name theirs"):
        Question("q", "?", {"ours": lambda short: {}}, (Goal("took_us", "theirs", at_most=1.0),), "", "")


def test_a_result_reads_back_and_its_section_names_missed_goals(tmp_path: Path) -> None:
    question = Question(
        "q", "How?", {"ours": lambda short: {}}, (Goal("took_us", "", at_most=1.0),), "A *limit*.", "Nothing."
    )
    rounds = ({"ours": {"took_us": 2.0}}, {"ours": {"took_us": 4.0}})
    result = Result("q", False, Machine("cpu", 2, "Linux", "3.11", "2026-01-01T00:00+00:00", 0.1), rounds)
    kept = tmp_path / "q.json"
    kept.write_text(json.dumps(result, default=vars))
    assert Result.read(kept) == result
    section = page.section(question, result)
    assert "| took, µs | ≤ 1.00 | 3.00 [2.00..4.00] | **missed** |" in section
    assert "A *limit*." in section and "**In practice.** Nothing." in section
    page.plot(question, result, tmp_path / "q.svg")
    assert (tmp_path / "q.svg").stat().st_size > 1000


def test_a_chart_names_the_better_direction() -> None:
    goals = (Goal("lost", "", at_most=0.0), Goal("robots", "", at_least=1.0))
    question = Question("q", "?", {"ours": lambda short: {}}, goals, "", "")
    assert question.lower_is_better("lost") and not question.lower_is_better("robots")
    assert question.lower_is_better("cpu_pct") and not question.lower_is_better("tell_per_s")
