"""Test when the twin counts a command as missed: at once in real time, and later while no processor was free."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors.drivers.franka.controller_clock import ControllerClock
from strands_actors.drivers.franka.twin.pace import Pace, Processors, Stretches

TICK_S, LONGEST_S = 0.001, 0.01


class Computer:
    def __init__(self, busy: bool) -> None:
        self.busy = busy


def waited_ms(stretches: Stretches, busy: bool, step_s: float = 1e-4) -> float:
    """Return how long a millisecond is without a command, if the process wakes up every ``step_s``."""
    pace = Pace(LONGEST_S, stretches, Computer(busy))
    pace.begin(50.0)
    now_s = 50.0
    while not pace.is_over(now_s):
        assert 0.0 < pace.wait_s(now_s) <= TICK_S + 1e-9
        now_s += step_s
    return (now_s - 50.0) * 1e3


@pytest.mark.parametrize(
    ("stretches", "busy", "ms"),
    [
        ("busy", False, 1.0),
        ("busy", True, 10.0),
        ("always", False, 10.0),
        ("always", True, 10.0),
        ("never", False, 1.0),
        ("never", True, 1.0),
    ],
)
def test_a_command_is_waited_for_as_long_as_the_computer_is_the_reason(
    stretches: Stretches, busy: bool, ms: float
) -> None:
    assert waited_ms(stretches, busy) == pytest.approx(ms, abs=0.15)


@pytest.mark.parametrize(("stretches", "over"), [("busy", False), ("never", True)])
def test_a_pause_of_the_twin_is_not_the_clients_fault(stretches: Stretches, over: bool) -> None:
    pace = Pace(LONGEST_S, stretches, Computer(False))
    pace.begin(50.0)
    assert not pace.is_over(50.0005)
    assert pace.is_over(50.0045) is over, "nothing of this computer ran for 4 ms"
    if not over:
        assert pace.wait_s(50.0045) == pytest.approx(TICK_S)
        assert pace.is_over(50.0056)


def test_milliseconds_are_due_by_the_clock_and_the_long_ones_are_counted() -> None:
    pace = Pace(LONGEST_S, "busy", Computer(False))
    pace.begin(50.0)
    assert pace.rest_s(50.0004) == pytest.approx(0.0006)
    assert pace.end(50.00106) == pytest.approx(50.001), "a late wake-up is made up for"
    pace.begin(50.001)
    assert pace.end(50.0053) == 50.0053, "a long one is not"
    assert (pace.ticks, pace.stretched) == (2, 1)
    pace.start_motion()
    assert (pace.ticks, pace.stretched) == (0, 0)


def test_in_real_time_a_short_pause_is_made_up_for() -> None:
    pace = Pace(LONGEST_S, "never", Computer(True))
    pace.begin(50.0)
    assert pace.end(50.0053) == pytest.approx(50.001)
    pace.begin(50.001)
    assert pace.is_over(50.0053), "its command is missed, unless it is there already"
    assert pace.end(50.1) == 50.1
    assert (pace.ticks, pace.stretched) == (2, 1)


def test_the_computer_is_busy_if_more_programs_run_than_it_has_processors(tmp_path: Path) -> None:
    table = tmp_path / "loadavg"
    for running, busy in (("1", False), ("2", False), ("3", True), ("12", True)):
        table.write_text(f"0.50 0.40 0.30 {running}/345 6789\n")
        assert Processors(str(table), 2).busy is busy
    assert Processors(str(tmp_path / "none"), 2).busy, "without the table nothing is known, so it may be"


def test_the_clock_of_a_controller_is_compared_with_ours() -> None:
    clock = ControllerClock()
    assert clock.hz == 0.0
    for at in range(100):
        clock.note(at * 33_000_000, 1000 + 33 * at)
    assert clock.hz == pytest.approx(1000.0)
    for at in range(100, 160):
        clock.note(at * 33_000_000, 1000 + 33 * 99 + 10 * (at - 99))
    assert clock.hz == pytest.approx(10.0 / 0.033, rel=1e-3), "a controller that stretches its time"
    clock.note(10**10, 5)
    assert clock.hz == 0.0, "it was restarted"
