"""Find joint positions that put the tool of an arm at a pose.

A pose has six numbers. An arm with five joints cannot reach every pose near it. For such an arm, and for the
nearest pose that can be reached, the position counts first. The orientation is brought as near as the position
allows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from strands_actors.kernel.messages import Refused

from .arm import Arm, Array, Pose, turn_between

NEAR_M, NEAR_RAD = 1e-5, 1e-4
"""A solution may differ from the requested pose by this much."""
M_OF_RAD = 0.3
"""A turn by one rad weighs as much as this distance."""
WEIGHTS = np.array((1.0, 1.0, 1.0, M_OF_RAD, M_OF_RAD, M_OF_RAD))
PLACE_WEIGHTS = np.array((1.0, 1.0, 1.0, 0.0, 0.0, 0.0))
"""Weights of distances and turns: of a whole pose, and of its position alone."""
DAMPING, LEAST_DAMPING = 0.05, 1e-6
"""The damping of a step is this share of the squared error, and at least the second number. So steps far from the
goal are short near singular positions, and the last steps converge quadratically."""
STEPS = 40
"""Most steps of a search."""
NEXT_STEPS = 20
"""Most steps of a search that starts at the neighbour on a path."""
STALLED, PROGRESS = 6, 0.97
"""A search ends without a solution if so many steps in turn did not reduce the error to this share."""
STARTS = 40
"""Further starts of a search, after the present and the home position."""
NEAREST_STARTS = 12
"""Further starts of a search for the nearest pose."""
LONGEST_RAD = 0.6
"""Longest step of a joint."""
POSITION_STEPS = 120
"""Most steps of a search for a position."""
FOLLOW_DAMPING_M, FOLLOW_DAMPING, EXACT_DAMPING = 3e-3, 0.05, 1e-6
"""Damping of the steps to a position, of those that turn the tool there, and of the null space."""
FIRST_DAMPING, MOST_DAMPING = 1e-3, 1e3
"""Damping of the first step, and the damping at which a search ends because no step is a gain."""
EDGE_M, EDGE_RAD = 3e-4, 2e-3
"""A pose at the edge of the reach counts as reached within this distance, since there a search ends slowly."""
BLOCKED_M = 10.0
"""A position in which the arm touches something is as bad as one that is so far away."""
ORIENTATION_SHARE = 1e-3
"""An orientation counts only between positions that are equally near."""
SETTLED_RAD = 2e-5
"""A search for the nearest orientation ends when its steps are shorter."""
BLOCKED_TRIES = 20
"""Solutions that are blocked, before the pose counts as blocked."""


def solve(arm: Arm, goal: Pose, rad: Array, steps: int = STEPS) -> Array | None:
    """Return joint positions for a pose by damped least squares, or None if this start leads to no solution.

    A joint that pushes against the end of its range stays there, so that the others do its part.
    """
    joints, least, stalled = np.clip(rad, arm.low, arm.high), np.inf, 0
    unit = np.eye(len(joints))
    for _ in range(steps):
        error, jacobian = _error(arm, goal, joints)
        if error[:3] @ error[:3] < NEAR_M**2 and error[3:] @ error[3:] < NEAR_RAD**2:
            return joints
        weighted, rows = error * WEIGHTS, jacobian * WEIGHTS[:, None]
        size = float(weighted @ weighted)
        stalled = 0 if size < PROGRESS * least else stalled + 1
        if stalled > STALLED:
            return None
        least = min(least, size)
        pull = rows.T @ weighted
        free = ~(((joints <= arm.low) & (pull < 0)) | ((joints >= arm.high) & (pull > 0)))
        rows = rows * free
        step = np.linalg.solve(rows.T @ rows + (DAMPING * size + LEAST_DAMPING) * unit, pull * free)
        longest = float(np.abs(step).max())
        joints = np.clip(joints + step * min(1.0, LONGEST_RAD / max(longest, 1e-12)), arm.low, arm.high)
    return None


def find(arm: Arm, goal: Pose, rad: Array, blocked: Callable[[Array], Refused | None]) -> Array | Refused | None:
    """Return joint positions for a pose, to which the arm can move without touching anything.

    The search starts at ``rad``, at the home position, and then at random positions, the same in each call.

    Args:
        arm: The arm.
        goal: The pose.
        rad: The present joint positions.
        blocked: Returns why the arm cannot move to joint positions, or None.

    Returns:
        The joint positions; the refusal of the last solution if all are blocked; None without a solution.
    """
    refusal, tries = None, 0
    for start in _starts(arm, goal, rad, STARTS):
        solution = solve(arm, goal, start)
        if solution is None:
            continue
        solution = unwound(arm, solution, rad)
        refusal = blocked(solution)
        if refusal is None:
            return solution
        tries += 1
        if tries >= BLOCKED_TRIES:
            break
    return refusal


def nearest(arm: Arm, goal: Pose, rad: Array, any_turn: bool = False) -> Array:
    """Return joint positions that bring the tool nearest to a position, and then to the orientation there.

    Args:
        arm: The arm.
        goal: The pose.
        rad: The present joint positions.
        any_turn: True if the position alone counts. The orientation is then the nearest that this start leads to.
    """
    best, least = rad, np.inf
    for start in _starts(arm, goal, rad, NEAREST_STARTS):
        at_place = approach(arm, goal, start, PLACE_WEIGHTS)
        solutions = [at_place]
        if float(np.linalg.norm(goal.xyz - arm.pose(at_place).xyz)) < EDGE_M:
            solutions = [approach(arm, goal, at_place, WEIGHTS), follow(arm, goal, at_place), at_place]
        for solution in solutions:
            pose = arm.pose(solution)
            far = float(np.linalg.norm(goal.xyz - pose.xyz))
            turned = float(np.linalg.norm(turn_between(pose.quat, goal.quat)))
            blocked = arm.touch(solution) is not None
            cost = max(far, EDGE_M) + ORIENTATION_SHARE * M_OF_RAD * turned + BLOCKED_M * blocked
            if cost < least:
                best, least = unwound(arm, solution, rad), cost
            if far < EDGE_M and (any_turn or turned < EDGE_RAD) and not blocked:
                return best
    return best


def approach(arm: Arm, goal: Pose, rad: Array, weights: Array) -> Array:
    """Return joint positions that bring the tool as near to a pose as this start leads to.

    The damping follows the success of the steps (Levenberg and Marquardt), so that the search also ends at the edge
    of the reach, where the arm is stretched and its derivative is singular.

    Args:
        arm: The arm.
        goal: The pose.
        rad: The start.
        weights: The weights of the three distances and of the three turns.
    """
    joints, damping, unit = np.clip(rad, arm.low, arm.high), FIRST_DAMPING, np.eye(len(rad))
    error, jacobian = _error(arm, goal, joints)
    error = error * weights
    for _ in range(POSITION_STEPS):
        if error @ error < NEAR_M**2 or damping > MOST_DAMPING:
            break
        rows = jacobian * weights[:, None]
        pull = rows.T @ error
        free = ~(((joints <= arm.low) & (pull < 0)) | ((joints >= arm.high) & (pull > 0)))
        rows = rows * free
        step = np.linalg.solve(rows.T @ rows + damping * unit, pull * free)
        longest = float(np.abs(step).max())
        then = np.clip(joints + step * min(1.0, LONGEST_RAD / max(longest, 1e-12)), arm.low, arm.high)
        after, derivative = _error(arm, goal, then)
        after = after * weights
        if after @ after < error @ error:
            joints, error, jacobian, damping = then, after, derivative, max(damping / 3, LEAST_DAMPING)
        else:
            damping *= 4
    return joints


def follow(arm: Arm, goal: Pose, rad: Array) -> Array:
    """Return joint positions for a position, with the orientation as near as the position allows.

    The orientation is changed only by motions of the joints that keep the position (its null space).
    """
    joints = np.clip(np.array(rad, dtype=float), arm.low, arm.high)
    free = np.ones(len(joints), dtype=bool)
    for _ in range(POSITION_STEPS):
        error, jacobian = _error(arm, goal, joints)
        place, turn = jacobian[:3] * free, jacobian[3:] * free
        back = _inverse(place, FOLLOW_DAMPING_M)
        step = back @ error[:3]
        within = np.eye(len(joints)) - _inverse(place, EXACT_DAMPING) @ place
        side = turn @ within
        step = step + within @ (_inverse(side, FOLLOW_DAMPING) @ (error[3:] - turn @ step))
        step = step * min(1.0, LONGEST_RAD / max(float(np.abs(step).max()), 1e-12))
        then = np.clip(joints + step, arm.low, arm.high)
        # A joint that pushes against the end of its range stays there, so that the others do its part.
        pushes = (np.abs(then - joints) < 1e-12) & (np.abs(step) > 1e-9)
        moved = float(np.abs(then - joints).max())
        joints = then
        free = ~pushes if pushes.any() else np.ones(len(joints), dtype=bool)
        if moved < SETTLED_RAD:
            break
    return joints


def unwound(arm: Arm, solution: Array, rad: Array) -> Array:
    """Return the same positions, with the whole turns of each joint that bring it nearest to ``rad``."""
    turns = np.round((rad - solution) / (2 * np.pi)) * 2 * np.pi
    nearer = solution + turns
    return np.where((nearer >= arm.low) & (nearer <= arm.high), nearer, solution)


def _error(arm: Arm, goal: Pose, joints: Array) -> tuple[Array, Array]:
    pose, jacobian = arm.jacobian(joints)
    return np.concatenate((goal.xyz - pose.xyz, turn_between(pose.quat, goal.quat))), jacobian


def _inverse(matrix: Array, damping: float) -> Array:
    square = matrix @ matrix.T + damping**2 * np.eye(len(matrix))
    return matrix.T @ np.linalg.inv(square)


def _starts(arm: Arm, goal: Pose, rad: Array, count: int) -> Iterator[Array]:
    yield np.clip(rad, arm.low, arm.high)
    yield arm.home
    yield from arm.starts(goal, M_OF_RAD, count)


__all__ = ["NEXT_STEPS", "find", "follow", "nearest", "solve"]
