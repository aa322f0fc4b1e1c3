"""The actions of one robot: FollowJointTrajectory and GripperCommand, and the topic with trajectories."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import trio

from strands_actors.kernel.channels.ros2.definitions import FOLLOW, GRIPPER
from strands_actors.kernel.channels.ros2.graph import Arrival, Node
from strands_actors.kernel.messages import Refused

from . import refusals
from .action_server import ActionServer, Ending, Goal
from .joints import Gripper, Layout
from .motion import Mover
from .readings import header
from .streams import PAUSE_S
from .trajectory import SETTLE_S, Error, Problem, Row, Trajectory, goal_of_topic, read_trajectory

LEFT = "the robot has left the graph"
STALLED_S = 0.6
"""A gripper that has not moved for so long has closed on something, or cannot move."""
STALLED_PART = 0.01
"""A smaller motion than this part of a gripper's range counts as no motion."""
REACHED_PART = 0.03
"""A gripper has reached its goal within this part of its range."""


class TrajectoryAction:
    """The action FollowJointTrajectory.

    Args:
        node: The node of the robot.
        name: The full name of the action.
        layout: The joints of the robot.
        mover: Moves the robot.
        log: Called with each line for the user.
    """

    def __init__(self, node: Node, name: str, layout: Layout, mover: Mover, log: Callable[[str], None]) -> None:
        self._name = name
        self._layout = layout
        self._mover = mover
        self._log = log
        left = _result(Problem(Error.INVALID_GOAL, LEFT))
        self._server = ActionServer(node, name, FOLLOW, self._execute, left)
        self.run = self._server.run

    async def _execute(self, goal: Goal, message: Mapping[str, Any]) -> Ending:
        trajectory = read_trajectory(message, self._layout, await self._mover.read())
        if isinstance(trajectory, Problem):
            problem: Problem | None = trajectory
        else:

            def on_step(desired: Row) -> None:
                self._server.send_feedback(goal, lambda: self._feedback(trajectory, desired))

            holder = f"{self._name}, goal {goal.id.hex()[:8]}"
            problem = await self._mover.move(holder, trajectory, lambda: goal.is_canceled, on_step)
        if problem is not None:
            self._log(f"{self._name}: goal {goal.id.hex()[:8]} is not reached: {problem.text}")
        return _result(problem)

    def _feedback(self, trajectory: Trajectory, desired: Row) -> dict[str, Any]:
        measured = self._mover.measured
        actual = [measured.get(joint.key, math.nan) for joint in trajectory.joints]
        return {
            "header": header(time.time()),
            "joint_names": [joint.key for joint in trajectory.joints],
            "desired": {"positions": desired},
            "actual": {"positions": actual},
            "error": {"positions": [goal - is_ for goal, is_ in zip(desired, actual, strict=True)]},
        }


def _result(problem: Problem | None) -> Ending:
    error, text = problem or Problem(Error.SUCCESSFUL, "")
    return Ending(problem is None, {"error_code": int(error), "error_string": text})


class GripperAction:
    """The action GripperCommand. ``max_effort`` is not used, because no driver takes one.

    Args:
        node: The node of the robot.
        name: The full name of the action.
        gripper: The gripper.
        mover: Moves the robot.
        log: Called with each line for the user, since the result of this action has no text.
    """

    def __init__(self, node: Node, name: str, gripper: Gripper, mover: Mover, log: Callable[[str], None]) -> None:
        self._name = name
        self._gripper = gripper
        self._mover = mover
        self._log = log
        left = Ending(False, {"position": math.nan, "effort": math.nan})
        self._server = ActionServer(node, name, GRIPPER, self._execute, left)
        self.run = self._server.run

    async def _execute(self, goal: Goal, message: Mapping[str, Any]) -> Ending:
        gripper, key = self._gripper, self._gripper.joint.key
        position, start = message["command"]["position"], (await self._mover.read()).get(key)
        if start is None or not math.isfinite(position):
            self._log(f"{self._name}: the position of {key} is not known, or that of the goal is not a number")
            return self._ending(Problem(Error.INVALID_GOAL, ""), False, math.nan)
        stall = Stall(gripper.span * STALLED_PART)
        duration_s = max(abs(position - start) / gripper.speed, gripper.least_s)
        reached = (gripper.span * REACHED_PART,)
        trajectory = Trajectory((gripper.joint,), (0.0, duration_s), ((start,), (position,)), reached, SETTLE_S)

        def on_step(_: Row) -> None:
            measured = self._mover.measured.get(key)
            if measured is not None:
                stall.take(measured, trio.current_time())
                self._server.send_feedback(goal, lambda: self._state(stall.is_stalled, position))

        holder = f"{self._name}, goal {goal.id.hex()[:8]}"
        problem = await self._mover.move(holder, trajectory, lambda: goal.is_canceled or stall.is_stalled, on_step)
        if problem is not None:
            self._log(f"{self._name}: goal {goal.id.hex()[:8]} is not reached: {problem.text}")
        return self._ending(problem, stall.is_stalled, position)

    def _ending(self, problem: Problem | None, stalled: bool, goal: float) -> Ending:
        return Ending(problem is None, self._state(stalled, goal))

    def _state(self, stalled: bool, goal: float) -> dict[str, Any]:
        position = self._mover.measured.get(self._gripper.joint.key, math.nan)
        reached = abs(position - goal) <= self._gripper.span * REACHED_PART
        return {
            "position": position,
            "effort": math.nan,
            "stalled": stalled and not reached,
            "reached_goal": reached,
        }


class Stall:
    """Notices that a gripper no longer moves.

    Args:
        least: A smaller motion counts as none.
    """

    def __init__(self, least: float) -> None:
        self.is_stalled = False
        self._least = least
        self._position = math.inf
        self._moved_at = 0.0

    def take(self, position: float, now_s: float) -> None:
        """Take a measured position, and the time."""
        if abs(position - self._position) >= self._least:
            self._position, self._moved_at = position, now_s
        self.is_stalled = now_s - self._moved_at >= STALLED_S


class TrajectoryTopic:
    """The topic ``joint_trajectory``: trajectories without goal, feedback and result.

    A newer trajectory of the same publisher replaces the present one, and one without points ends it. Refusals are
    reported as those of the other topics.

    Args:
        topic: The full name of the topic.
        layout: The joints of the robot.
        mover: Moves the robot.
        report: Called with each refusal.
    """

    def __init__(self, topic: str, layout: Layout, mover: Mover, report: Callable[[Refused], None]) -> None:
        self._topic = topic
        self._layout = layout
        self._mover = mover
        self._report = report
        self._gid = b""
        self._sender = ""
        self._newest: Mapping[str, Any] | None = None
        self._came = trio.Event()

    def on_message(self, arrival: Arrival, sender: str) -> None:
        """Take a trajectory. ``sender`` is the name of its sender, to show to people."""
        gid = arrival.attachment.gid
        if self._gid not in (b"", gid):
            self._report(refusals.second_writer(self._topic, sender, self._sender, PAUSE_S))
            return
        self._gid, self._sender, self._newest = gid, sender, arrival.message
        self._came.set()

    async def run(self) -> None:
        """Carry out trajectories until cancelled."""
        while True:
            await self._came.wait()
            self._came = trio.Event()
            while self._newest is not None:
                message, self._newest = self._newest, None
                await self._carry_out(message)
            self._gid = b""

    async def _carry_out(self, message: Mapping[str, Any]) -> None:
        if not message["points"]:
            return
        trajectory = read_trajectory(goal_of_topic(message), self._layout, await self._mover.read())
        if not isinstance(trajectory, Problem):
            is_over = lambda: self._newest is not None  # noqa: E731
            problem = await self._mover.move(f"{self._topic}, {self._sender}", trajectory, is_over)
        else:
            problem = trajectory
        if problem is not None:
            self._report(refusals.trajectory_not_followed(self._topic, problem.text))
