"""Enforce limits of a moving simulated arm: the speed of servo targets, and collisions. No clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence

Joints = Sequence[float]

IDLE_S, SLACK_S = 0.1, 0.05
"""A servo target must be so near that the joints reach it, at their speed limit, in the time since the last new one
(at most ``IDLE_S``) and ``SLACK_S``. The real controller's threshold is not known [assumed]. Users report error 24
for streams near 140 deg/s with targets that arrive unevenly. So the real threshold is probably lower."""

SAME_RAD = 1e-6
"""A target that differs less from the last one is the same target. The wire has numbers of 32 bits."""

STILL_RAD_S, STALLED_RAD, STALLED_S = 0.02, 0.01, 0.1
"""A joint that pushes with a large torque is blocked if it is slower than this and farther from its target than
this, for so many seconds [assumed]."""

EFFORT_SHARES = (None, 1.0, 0.9, 0.8, 0.7, 0.6)
"""For each collision sensitivity, the share of a motor's highest torque that counts as a large torque [assumed]."""

DEFAULT_SENSITIVITY = 3


class StepLimit:
    """Find servo targets that are too far ahead for the joints' speed limit."""

    def __init__(self, top_rad_s: Callable[[], float]) -> None:
        """Args:
        top_rad_s: Returns the present speed limit of the joints.
        """
        self._top_rad_s = top_rad_s
        self.reset()

    def reset(self) -> None:
        """Forget the last target. The next target may be as far ahead as after a pause."""
        self._goal: Joints | None = None

    def accepts(self, goal: Joints, here: Joints, now_s: float) -> bool:
        """Return True if the joints can follow to the target in time, and remember it.

        Args:
            goal: The new target of each joint in rad.
            here: The setpoint of each joint in rad. Used if there is no last target.
            now_s: The time of the target in seconds.
        """
        if self._goal is None:
            self._goal, self._place, self._placed_s, self._moved_s = list(here), list(here), now_s, now_s - IDLE_S
        top_rad_s = self._top_rad_s()
        reach = top_rad_s * (now_s - self._placed_s)
        self._place = [
            place + max(-reach, min(reach, last - place))
            for place, last in zip(self._place, self._goal, strict=True)
        ]
        self._placed_s = now_s
        allowed = top_rad_s * (min(now_s - self._moved_s, IDLE_S) + SLACK_S)
        # The last target was accepted, so it may be repeated at once. That is no new motion.
        before = _farthest(self._goal, self._place)
        if _farthest(goal, self._goal) > SAME_RAD:
            self._moved_s = now_s
        self._goal = list(goal)
        return _farthest(goal, self._place) <= max(allowed, before + SAME_RAD)


def _farthest(goal: Joints, here: Joints) -> float:
    return max(abs(rad - place) for rad, place in zip(goal, here, strict=True))


class CollisionWatch:
    """Find joints that are blocked: their motors push, and nothing moves."""

    def __init__(self, limits_nm: Joints) -> None:
        self._limits_nm = limits_nm
        self.reset()

    def reset(self) -> None:
        self._stalled_s = [0.0] * len(self._limits_nm)

    def is_blocked(
        self,
        elapsed_s: float,
        sensitivity: int,
        target: Joints,
        position: Joints,
        velocity: Joints,
        effort_nm: Joints,
    ) -> bool:
        """Return True if a joint is blocked, by the readings of ``elapsed_s`` seconds after the last ones."""
        share = EFFORT_SHARES[max(0, min(sensitivity, len(EFFORT_SHARES) - 1))]
        rows = zip(target, position, velocity, effort_nm, self._limits_nm, strict=True)
        for joint, (goal, here, rad_s, nm, limit_nm) in enumerate(rows):
            pushes = share is not None and abs(nm) >= share * limit_nm - 1e-6
            stalled = pushes and abs(rad_s) < STILL_RAD_S and abs(goal - here) > STALLED_RAD
            self._stalled_s[joint] = self._stalled_s[joint] + elapsed_s if stalled else 0.0
        return max(self._stalled_s) >= STALLED_S
