"""The loop around the steps of a stop, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
import trio

from strands_actors.contract.wire import ProcessSpent, WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.stop_steps import always, repeat_until_safe
from strands_actors.testing import run_virtual


class Steps:
    """A stop whose steps have the given results, one after the other, and then hang."""

    def __init__(self, *results: str | Exception) -> None:
        self._results: Iterator[str | Exception] = iter(results)
        self.written = self.acknowledged = False
        self.times_s: list[float] = []

    async def step(self) -> str:
        self.times_s.append(trio.current_time())
        self.written = True
        result = next(self._results, None)
        if result is None:
            await trio.sleep_forever()
        if isinstance(result, Exception):
            raise result
        self.acknowledged = True
        assert result is not None
        return result


def outcome_of(steps: Steps, within_s: float = 1.0, goes_on: Callable[[], bool] = always) -> Outcome:
    """Run the steps in virtual time, with pauses of 0.1 s."""
    outcomes: list[Outcome] = []

    async def run() -> None:
        outcomes.append(await repeat_until_safe(steps, within_s, 0.1, goes_on))
        steps.times_s.append(trio.current_time())

    run_virtual(run)
    began_s = steps.times_s[0]
    steps.times_s = [round(time_s - began_s, 6) for time_s in steps.times_s]
    return outcomes[0]


def test_the_loop_ends_with_the_step_that_finds_the_robot_safe() -> None:
    steps = Steps("")
    assert outcome_of(steps) == Outcome(True, True, "")
    assert steps.times_s == [0.0, 0.0]


def test_steps_are_repeated_until_the_robot_is_safe() -> None:
    steps = Steps("it moves", "it moves", "")
    assert outcome_of(steps) == Outcome(True, True, "")
    assert steps.times_s == [0.0, 0.1, 0.2, 0.2]


@pytest.mark.parametrize("failure", [WireDown("lost"), ProcessSpent("hangs"), MalformedFrame("no number")])
def test_saf_022_a_failed_step_is_followed_by_another(failure: Exception) -> None:
    assert outcome_of(Steps(failure, "")) == Outcome(True, True, "")


def test_a_failed_step_is_the_last_if_no_other_can_succeed() -> None:
    steps = Steps(WireDown("lost"), "")
    assert outcome_of(steps, goes_on=lambda: False) == Outcome(True, False, "not confirmed: lost")
    assert steps.times_s == [0.0, 0.0]


def test_saf_023_a_robot_that_does_not_answer_is_not_safe() -> None:
    steps = Steps()
    assert outcome_of(steps, within_s=0.5) == Outcome(True, False, "not confirmed: the robot is silent")
    assert steps.times_s == [0.0, 0.5]


def test_the_last_reason_is_reported_when_the_time_is_over() -> None:
    assert outcome_of(Steps("it moves", WireDown("lost"), "it turns"), 0.5) == Outcome(True, True, "it turns")
