"""A smooth curve through joint positions. Pure."""

from __future__ import annotations

from .bodies import Array


def along(waypoints: Array, share: float) -> Array:
    """Return the joint positions at a share (0 to 1) of the way, along a smooth curve through the waypoints.

    Between two waypoints it is a cubic curve (Catmull-Rom), so that the speed of no joint jumps at a waypoint.
    """
    last = len(waypoints) - 1
    place = min(max(share, 0.0), 1.0) * last
    row = min(int(place), last - 1)
    part = place - row
    start, end = waypoints[row], waypoints[row + 1]
    before = waypoints[row - 1] if row > 0 else 2 * start - end
    after = waypoints[row + 2] if row + 2 <= last else 2 * end - start
    rate_start, rate_end = (end - before) / 2, (after - start) / 2
    square, cube = part * part, part * part * part
    return (
        (2 * cube - 3 * square + 1) * start
        + (cube - 2 * square + part) * rate_start
        + (3 * square - 2 * cube) * end
        + (cube - square) * rate_end
    )


__all__ = ["along"]
