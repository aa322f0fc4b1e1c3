"""Serve the action FollowJointTrajectory of one robot.

An action is three services (send a goal, cancel it, get its result) and two topics (feedback, status). One goal at
a time is carried out, as a stream of setpoints under the lease. At its end the robot holds and the lease is given
back, so that the next goal needs no resume. A stop, or the loss of the lease, aborts the goal.
"""

from __future__ import annotations

import enum
import time
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

import trio

from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.remote import RemoteRobot

from .definitions import CANCEL, FEEDBACK, GET_RESULT, SEND_GOAL, STATUS
from .graph import Call, Node
from .joints import Layout
from .names import Qos
from .readings import header, stamp
from .trajectory import Error, Problem, Trajectory, read_trajectory
from .writer import Writer

KEPT = 32
"""So many results are kept for clients that ask later."""
MOST_WAITING = 64
"""So many clients may wait for results at the same time."""
FEEDBACK_S = 0.1
FRESH_S = 1.0


class GoalState(enum.IntEnum):
    """The states of action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class Goal:
    """A goal, from its acceptance to its result."""

    def __init__(self, goal_id: bytes) -> None:
        self.id = goal_id
        self.state = GoalState.ACCEPTED
        self.accepted_s = time.time()
        self.error, self.text = Error.SUCCESSFUL, ""
        self.is_canceled = False
        self.done = trio.Event()

    @property
    def info(self) -> dict[str, Any]:
        return {"goal_id": {"uuid": self.id}, "stamp": stamp(self.accepted_s)}


class TrajectoryAction:
    """The action server of one robot.

    Args:
        node: The node of the robot.
        name: The full name of the action.
        mesh: The mesh.
        robot: The name of the robot.
        layout: Its joints.
        writer: The writer of the robot's command topics, which is suspended during a goal.
        report: Called with each refusal of the robot.
        log: Called with each line for the user.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        mesh: MeshClient,
        robot: str,
        layout: Layout,
        writer: Writer,
        report: Callable[[Refused], None],
        log: Callable[[str], None],
    ) -> None:
        self.name = name
        self._mesh = mesh
        self._robot = robot
        self._layout = layout
        self._writer = writer
        self._report = report
        self._log = log
        self._goals: OrderedDict[bytes, Goal] = OrderedDict()
        self._active: Goal | None = None
        self._waiting = 0
        self._measured: dict[str, float] = {}
        self._measured_at = -FRESH_S
        self._nursery: trio.Nursery | None = None
        self._status = node.publisher(f"{name}/_action/status", STATUS, Qos.LATCHED)
        self._feedback = node.publisher(f"{name}/_action/feedback", FEEDBACK)
        node.serve(f"{name}/_action/send_goal", SEND_GOAL, lambda call: self._start(self._on_goal, call))
        node.serve(f"{name}/_action/cancel_goal", CANCEL, self._on_cancel)
        node.serve(f"{name}/_action/get_result", GET_RESULT, lambda call: self._start(self._on_result, call))

    def on_positions(self, message: Mapping[str, Any], age_s: float) -> None:
        """Take the newest joint state of the robot, and its age in seconds."""
        self._measured = dict(zip(message["name"], message["position"], strict=True))
        self._measured_at = trio.current_time() - age_s

    async def run(self) -> None:
        """Carry out goals until cancelled."""
        async with trio.open_nursery() as self._nursery:
            await trio.sleep_forever()

    def _start(self, task: Callable[[Call], Any], call: Call) -> None:
        if self._nursery is not None:
            self._nursery.start_soon(task, call)

    # -- services

    async def _on_goal(self, call: Call) -> None:
        request = call.arrival.message
        goal = Goal(bytes(request["goal_id"]["uuid"]))
        accepted = await self._accept(goal, request["goal"])
        call.reply({"accepted": accepted is not None, "stamp": stamp(goal.accepted_s)})
        if accepted is not None and self._nursery is not None:
            self._nursery.start_soon(self._carry_out, goal, *accepted)

    async def _accept(self, goal: Goal, message: Mapping[str, Any]) -> tuple[Trajectory, RemoteRobot] | None:
        """Take the lease for a goal. None if the goal is rejected. The action has no field for the reason, so it
        is printed."""
        fresh = trio.current_time() - self._measured_at < FRESH_S
        trajectory = read_trajectory(message, self._layout, self._measured if fresh else {})
        if isinstance(trajectory, Problem):
            self._log(f"{self.name}: the goal is rejected: {trajectory.text}")
            return None
        holder = self._writer.holder or (f"the goal {self._active.id.hex()[:8]}" if self._active else "")
        if holder or goal.id in self._goals:
            self._log(f"{self.name}: the goal is rejected: {holder or 'this goal'} commands the robot already")
            return None
        # From here on no other goal and no stream begins, although the robot has not answered yet.
        self._active = self._goals[goal.id] = goal
        self._writer.suspend(f"{self.name}, goal {goal.id.hex()[:8]}")
        remote = RemoteRobot(self._mesh, self._robot)
        refused = await remote.acquire()
        if refused is None:
            while len(self._goals) > KEPT:
                self._goals.popitem(last=False)
            return trajectory, remote
        self._report(refused)
        del self._goals[goal.id]
        self._free()
        return None

    def _on_cancel(self, call: Call) -> None:
        requested_id = bytes(call.arrival.message["goal_info"]["goal_id"]["uuid"])
        goal = self._active
        if goal is not None and (requested_id == goal.id or not any(requested_id)):
            goal.is_canceled = True
            self._set_state(goal, GoalState.CANCELING)
            call.reply({"return_code": 0, "goals_canceling": [goal.info]})
        else:
            # 2: the goal is unknown, 3: it has ended. A request without an id is for all goals.
            code = 0 if not any(requested_id) else 3 if requested_id in self._goals else 2
            call.reply({"return_code": code, "goals_canceling": []})

    async def _on_result(self, call: Call) -> None:
        goal = self._goals.get(bytes(call.arrival.message["goal_id"]["uuid"]))
        if goal is None or self._waiting >= MOST_WAITING:
            call.reply({"status": int(GoalState.UNKNOWN)})
            return
        self._waiting += 1
        await goal.done.wait()
        self._waiting -= 1
        result = {"error_code": int(goal.error), "error_string": goal.text}
        call.reply({"status": int(goal.state), "result": result})

    # -- a goal

    async def _carry_out(self, goal: Goal, trajectory: Trajectory, remote: RemoteRobot) -> None:
        problem: Problem | None = Problem(Error.INVALID_GOAL, "the robot has left the graph")
        try:
            self._set_state(goal, GoalState.EXECUTING)
            problem = await self._follow(goal, trajectory, remote)
        finally:
            with trio.move_on_after(2.0, shield=True):
                await remote.release()
            self._free()
            if problem is not None:
                goal.error, goal.text = problem
            ended = GoalState.CANCELED if goal.is_canceled else GoalState.SUCCEEDED
            self._set_state(goal, ended if problem is None else GoalState.ABORTED)
            goal.done.set()

    async def _follow(self, goal: Goal, trajectory: Trajectory, remote: RemoteRobot) -> Problem | None:
        """Send setpoints until the goal is reached or canceled. Return why it was not reached."""
        began, lifetime_s = trio.current_time(), self._layout.lifetime_s
        period_s = lifetime_s / 3
        next_feedback = began
        while not goal.is_canceled:
            elapsed_s = trio.current_time() - began
            positions = trajectory.positions(elapsed_s)
            pairs = zip(trajectory.joints, positions, strict=True)
            targets = {joint.key: joint.value(position) for joint, position in pairs}
            answer = await remote.send_action(targets, lifetime_s, period_s)
            if isinstance(answer, Refused):
                self._report(answer)
                return Problem(Error.INVALID_GOAL, answer.text)
            if trio.current_time() >= next_feedback:
                next_feedback += FEEDBACK_S
                self._send_feedback(goal, trajectory, positions)
            over_s = elapsed_s - trajectory.duration_s
            if over_s >= 0.0 and self._measured_at >= began + trajectory.duration_s:
                farthest = trajectory.farthest(self._measured)
                if not farthest:
                    return None
                if over_s >= trajectory.settle_s:
                    return Problem(Error.GOAL_TOLERANCE_VIOLATED, farthest)
            elif over_s >= trajectory.settle_s + FRESH_S:
                return Problem(Error.GOAL_TOLERANCE_VIOLATED, "the robot does not report its positions")
            await trio.sleep_until(began + elapsed_s + period_s)
        return None

    def _free(self) -> None:
        self._active = None
        self._writer.suspend("")

    def _set_state(self, goal: Goal, state: GoalState) -> None:
        goal.state = state
        listed = [{"goal_info": each.info, "status": int(each.state)} for each in self._goals.values()]
        self._status.publish({"status_list": listed})

    def _send_feedback(self, goal: Goal, trajectory: Trajectory, desired: tuple[float, ...]) -> None:
        if not self._feedback.has_subscribers:
            return
        actual = [self._measured.get(joint.key, 0.0) for joint in trajectory.joints]
        feedback = {
            "header": header(time.time()),
            "joint_names": [joint.key for joint in trajectory.joints],
            "desired": {"positions": desired},
            "actual": {"positions": actual},
            "error": {"positions": [goal - is_ for goal, is_ in zip(desired, actual, strict=True)]},
        }
        self._feedback.publish({"goal_id": {"uuid": goal.id}, "feedback": feedback})
