"""Intervals are counted within a stream, and not between two of them."""

from __future__ import annotations

from strands_actors.supervisors.gate.intervals import BOUNDS_S, Intervals

MS = 1_000_000


def noted(*setpoints: tuple[int, bool, float]) -> Intervals:
    intervals = Intervals()
    for lease, is_streamed, at_ms in setpoints:
        intervals.note(lease, is_streamed, round(at_ms * MS))
    return intervals


def test_each_interval_has_its_bucket() -> None:
    intervals = noted((1, True, 0.0), (1, True, 20.0), (1, True, 41.0), (1, True, 2041.0))
    assert dict(zip((*BOUNDS_S, None), intervals.counts, strict=True)) | {0.02: 1, 0.025: 1, None: 1} == {
        **dict.fromkeys(BOUNDS_S, 0),
        0.02: 1,
        0.025: 1,
        None: 1,
    }
    assert round(intervals.total_s, 6) == 2.041


def test_a_single_command_or_another_lease_begins_anew() -> None:
    assert sum(noted((1, True, 0.0), (1, False, 5.0), (1, True, 9.0)).counts) == 0
    assert sum(noted((1, True, 0.0), (2, True, 20.0)).counts) == 0
    assert sum(noted((1, False, 0.0), (1, False, 20.0)).counts) == 0
