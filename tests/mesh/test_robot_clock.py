"""A robot's clock is read over a network. A deadline that is sent to the robot is never later than intended."""

from __future__ import annotations

from typing import NamedTuple

from hypothesis import given
from hypothesis import strategies as st

from strands_actors.surfaces.mesh.robot_clock import GOOD_NS, RobotClock

MS = 1_000_000
SECOND = 1_000 * MS


class Reading(NamedTuple):
    after_ns: int  # since the previous reading
    there_ns: int  # time of the request from the reader to the robot
    back_ns: int


readings = st.lists(
    st.builds(Reading, st.integers(0, 5 * SECOND), st.integers(0, SECOND), st.integers(0, SECOND)),
    min_size=1,
    max_size=30,
)


@given(st.integers(-(10**18), 10**18), readings, st.integers(0, 40 * SECOND))
def test_saf_001_no_deadline_is_later_than_intended_and_a_deadline_needs_a_reading(
    offset_ns: int, made: list[Reading], later_ns: int
) -> None:
    clock, now_ns = RobotClock(), 10**18
    assert clock.deadline(now_ns, now_ns) is None
    for reading in made:
        now_ns += reading.after_ns
        asked_ns, now_ns = now_ns, now_ns + reading.there_ns + reading.back_ns
        clock.read(asked_ns + reading.there_ns + offset_ns, asked_ns, now_ns)
    bounds = clock.bounds(now_ns)
    assert bounds is not None
    assert bounds.lowest_ns <= offset_ns <= bounds.highest_ns
    theirs_ns = clock.deadline(now_ns + 100 * MS, now_ns)
    assert theirs_ns is not None and theirs_ns <= now_ns + 100 * MS + offset_ns
    slowest_ns = min(reading.back_ns for reading in made[-1:])
    assert theirs_ns >= now_ns + 100 * MS + offset_ns - slowest_ns - 1, "at least as tight as the last reading"
    known = clock.bounds(now_ns + later_ns)
    assert (known is None) == (later_ns >= GOOD_NS)


def test_the_tightest_of_several_readings_counts_and_ages() -> None:
    clock = RobotClock()
    clock.read(50 * MS, 0, 100 * MS)
    clock.read(201 * MS, 200 * MS, 202 * MS)
    clock.read(450 * MS, 400 * MS, 500 * MS)
    soon, late = clock.bounds(500 * MS), clock.bounds(20 * SECOND)
    assert soon is not None and late is not None
    assert soon.highest_ns - soon.lowest_ns < 3 * MS
    assert late.highest_ns - late.lowest_ns > soon.highest_ns - soon.lowest_ns


def test_saf_001_readings_that_contradict_newer_ones_are_dropped() -> None:
    """The robot's computer slept for five seconds. With the older readings every deadline would be five seconds
    too late."""
    clock, ahead_ns = RobotClock(), 1000 * SECOND
    for at_ms in (0, 100, 2_200, 4_200):
        clock.read(at_ms * MS + ahead_ns + 2 * MS, at_ms * MS, at_ms * MS + 4 * MS)
    ahead_ns -= 5 * SECOND
    for at_ms in (11_200, 13_200):
        clock.read(at_ms * MS + ahead_ns + 2 * MS, at_ms * MS, at_ms * MS + 4 * MS)
        bounds = clock.bounds(at_ms * MS + 4 * MS)
        assert bounds is not None and bounds.lowest_ns <= ahead_ns <= bounds.highest_ns
        deadline_ns = clock.deadline(at_ms * MS + 100 * MS, at_ms * MS + 4 * MS)
        assert deadline_ns is not None and deadline_ns <= at_ms * MS + 100 * MS + ahead_ns


def test_a_forgotten_clock_has_no_bounds() -> None:
    clock = RobotClock()
    clock.read(0, 0, 1)
    clock.forget()
    assert clock.bounds(1) is None
