"""Test when a report counts as new, by the robot's own time stamps."""

from __future__ import annotations

from strands_actors.drivers.common.kit.stamps import Stamps

WRAP = 1 << 24


def taken(stamps: Stamps, *reports: float) -> list[bool]:
    """Take one report per millisecond. Return which of them were new."""
    began_ns = stamps.new_ns
    return [stamps.take(stamp, began_ns + at * 1_000_000) for at, stamp in enumerate(reports, 1)]


def test_saf_012_a_report_with_a_repeated_stamp_is_not_new() -> None:
    stamps = Stamps()
    assert taken(stamps, 5.0, 5.0, 5.0) == [True, False, False]
    assert (stamps.new_ns, stamps.goes_on, stamps.repeats(3_000_000)) == (1_000_000, False, True)
    assert taken(stamps, 5.1) == [True]
    assert (stamps.goes_on, stamps.repeats(stamps.new_ns)) == (True, False)


def test_a_robot_that_has_restarted_is_new_where_stamps_do_not_wrap() -> None:
    assert taken(Stamps(), 500.0, 0.0, 0.1) == [True, True, True]


def test_a_new_connection_goes_on_when_its_own_stamps_do() -> None:
    stamps = Stamps()
    taken(stamps, 1.0, 2.0)
    stamps.connected()
    assert not stamps.goes_on
    assert (taken(stamps, 3.0), stamps.goes_on) == ([True], False)
    assert (taken(stamps, 4.0), stamps.goes_on) == ([True], True)


def test_stamps_that_wrap_go_on_where_they_do() -> None:
    stamps = Stamps(WRAP)
    assert taken(stamps, WRAP - 10, WRAP - 1, 0, 0, 20) == [True, True, True, False, True]
    assert stamps.passed == 30


def test_saf_012_a_late_report_is_not_new_and_changes_nothing() -> None:
    stamps = Stamps(WRAP)
    assert taken(stamps, 100, 90, 95, 100) == [True, False, False, False]
    assert taken(stamps, 5, WRAP - 5, 99, 101) == [False, False, False, True]
    assert stamps.passed == 1
