"""The reports of a robot that prove that it stands still, and those that prove nothing."""

from __future__ import annotations

import math

from strands_actors.drivers.common.kit.rest_watch import Rest, RestWatch


def test_saf_022_the_first_report_is_only_the_reference() -> None:
    watch = RestWatch()
    assert not watch.report(1.0)
    assert watch.rest is Rest.NOTHING_SINCE
    assert watch.report(2.0)
    assert watch.rest is Rest.RESTS


def test_saf_022_a_report_with_an_old_stamp_does_not_count() -> None:
    watch = RestWatch()
    watch.report(5.0)
    for stamp in (5.0, 4.0, math.nan):
        assert not watch.report(stamp)
        assert watch.rest is Rest.NOTHING_SINCE
        assert watch.repeats
    watch.report(5.1, moving=[0])
    watch.report(5.1)
    assert watch.rest is Rest.MOVES
    assert watch.report(5.2)
    assert watch.rest is Rest.RESTS


def test_an_axis_rests_after_a_steady_time_without_motion() -> None:
    watch = RestWatch(steady=0.05)
    watch.report(0.0)
    watch.report(1.0, moving=[0])
    assert watch.rest is Rest.MOVES
    watch.report(2.0)
    assert watch.rest is Rest.TOO_SHORT
    watch.report(2.03)
    assert watch.rest is Rest.TOO_SHORT
    watch.report(2.06)
    assert watch.rest is Rest.RESTS


def test_motion_restarts_the_steady_time() -> None:
    watch = RestWatch(steady=1.0)
    for stamp, moving in ((0.0, ()), (1.0, ()), (1.9, (0,)), (2.5, ()), (3.4, ())):
        watch.report(stamp, moving)
        assert watch.rest is not Rest.RESTS
    watch.report(3.5)
    assert watch.rest is Rest.RESTS


def test_each_axis_rests_for_itself() -> None:
    watch = RestWatch(axes=3, steady=1.0)
    watch.report(0.0)
    assert watch.unsteady == {0, 1, 2}
    watch.report(1.0, moving=[1])
    watch.report(2.0, moving=[2])
    assert watch.unsteady == {1, 2}
    assert watch.rest is Rest.MOVES
    watch.report(3.0)
    assert watch.unsteady == {2}
    assert watch.rest is Rest.TOO_SHORT
    watch.report(4.0)
    assert watch.unsteady == frozenset()


def test_the_steady_time_is_measured_by_the_given_times() -> None:
    """The stamp may be a number of a frame, which has no unit of time."""
    watch = RestWatch(steady=0.05)
    for number, time in ((7, 10.0), (8, 10.01), (9, 10.05)):
        watch.report(number, time=time)
        assert watch.rest is not Rest.RESTS
    watch.report(10, time=10.06)
    assert watch.rest is Rest.RESTS


def test_saf_022_an_earlier_command_that_may_still_come_undoes_the_proof() -> None:
    watch = RestWatch()
    watch.report(1.0)
    watch.report(2.0)
    watch.restart()
    assert watch.rest is Rest.NOTHING_SINCE
    watch.report(3.0)
    assert watch.rest is Rest.NOTHING_SINCE
    watch.report(4.0)
    assert watch.rest is Rest.RESTS
