"""Test how the wire process evaluates samples. The test controls the clock."""

from __future__ import annotations

from typing import Any

import pytest
import trio
import trio.testing

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.ur import plain
from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.config import URConfig
from strands_actors.drivers.ur.wire import OUTPUTS, URSession
from strands_actors.kernel.clock import NS

SIX = (0.0,) * 6


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def now_ns(self) -> int:
        return round(self.now_s * NS)


class Commands:
    """A stand-in that sends no commands."""

    def take(self) -> None:
        pass


def session_at(clock: Clock, rtde_hz: float | None = None) -> URSession:
    config = URConfig("ur5e", "192.0.2.10", 0.3, rtde_hz)
    session = URSession(Commands(), None, config, clock)  # type: ignore[arg-type]
    session.take(sample(1.0))
    return session


def sample(time_s: float, **others: Any) -> dict[str, Any]:
    told: dict[str, Any] = dict.fromkeys(OUTPUTS, SIX)
    modes = {"robot_mode": p.RobotMode.RUNNING, "safety_mode": p.SafetyMode.NORMAL}
    scaling = {"speed_scaling": 1.0, "target_speed_fraction": 0.5}
    return told | modes | scaling | {"timestamp": time_s, "runtime_state": p.RuntimeState.PLAYING} | others


@pytest.mark.parametrize(("rtde_hz", "longest_s"), [(None, 0.04), (50.0, 0.04), (25.0, 0.08)])
def test_saf_012_a_clock_stands_still_when_two_samples_are_missing_and_not_before(
    rtde_hz: float | None, longest_s: float
) -> None:
    clock = Clock()
    session = session_at(clock, rtde_hz)
    clock.now_s += longest_s - 0.001
    assert not session.is_still
    clock.now_s += 0.002
    assert session.is_still
    session.take(sample(1.0))
    assert session.is_still, "the same sample arrived again"
    session.take(sample(1.1))
    assert not session.is_still


@pytest.mark.parametrize("time_s", [0.9, 0.0, float("nan"), float("inf")])
def test_saf_022_a_sample_that_is_older_than_the_newest_is_ignored(time_s: float) -> None:
    clock = Clock()
    session = session_at(clock)
    ordered_ns = clock.now_ns()
    clock.now_s += 0.01
    session.take(sample(1.1, actual_qd=(1.0,) * 6))
    session.take(sample(time_s))
    assert not session.stands_since(ordered_ns), "the newest sample shows motion"
    session.take(sample(1.2))
    assert session.stands_since(ordered_ns)


def test_saf_012_a_clock_that_stands_still_for_longer_is_a_lost_link() -> None:
    clock = Clock()
    session = session_at(clock)
    clock.now_s += 0.29
    session.check_alive()
    clock.now_s += 0.02
    with pytest.raises(WireDown, match="the clock of ur5e has not advanced for 310 ms"):
        session.check_alive()


def test_an_arm_is_energised_only_with_a_running_controller_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample from before the arming does not show whether the clock is frozen."""
    monkeypatch.setattr(plain, "ANSWER_S", 0.1)
    clock = Clock()
    session = session_at(clock)

    async def run() -> None:
        with pytest.raises(WireDown, match="clock does not advance"):
            await session.see_advance()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(session.see_advance)
            await trio.testing.wait_all_tasks_blocked()
            clock.now_s += 0.1
            session.take(sample(1.1))

    trio.run(run)


def test_saf_005_an_arm_stands_by_a_sample_that_is_newer_than_the_order() -> None:
    clock = Clock()
    session = session_at(clock)
    ordered_ns = clock.now_ns()
    clock.now_s += 0.01
    assert not session.stands_since(ordered_ns), "the sample shows the arm before the order"
    session.take(sample(1.01, actual_qd=(0.0, 0.0, 0.3, 0.0, 0.0, 0.0)))
    assert not session.stands_since(ordered_ns)
    session.take(sample(1.02, actual_qd=(0.0, 0.0, float("nan"), 0.0, 0.0, 0.0)))
    assert not session.stands_since(ordered_ns)
    session.take(sample(1.03))
    assert session.stands_since(ordered_ns)
    clock.now_s += 0.05
    assert not session.stands_since(ordered_ns), "the sample is too old by now"


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ({"safety_mode": p.SafetyMode.PROTECTIVE_STOP}, "PROTECTIVE_STOP (3)"),
        ({"robot_mode": p.RobotMode.IDLE}, "IDLE (5)"),
        ({"runtime_state": p.RuntimeState.PAUSED}, "the control script was paused on the pendant"),
        ({"runtime_state": p.RuntimeState.STOPPED}, "the controller has stopped the control script"),
    ],
)
def test_saf_010_the_end_of_our_program_ends_control_until_the_next_arming(told: dict[str, Any], why: str) -> None:
    session = session_at(Clock())
    session.controls = session.servoing = True
    session.take(sample(1.1, **told))
    assert (session.controls, session.servoing, session.lost) == (False, False, why)
    session.take(sample(1.2))
    assert not session.controls, "the operator's unlock ended our program"
    assert session.observation().faults == {"controller": why}


def test_an_observation_has_the_controllers_values() -> None:
    session = session_at(Clock())
    seen = session.observation()
    assert seen.position == seen.velocity == SIX
    assert seen.sensors["robot_mode"] == (7,)
    assert seen.sensors["speed_scaling"] == (0.5,)
    assert seen.sensors["wrench_n_nm"] == SIX
    assert (seen.sensors["control"], seen.sensors["watchdog_hz"], seen.faults) == ((0.0,), (0.0,), {})
