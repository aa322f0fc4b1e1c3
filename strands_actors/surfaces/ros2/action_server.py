"""Serve one action of a robot.

An action is three services (send a goal, cancel it, get its result) and two topics (feedback, status). Each goal is
accepted, and its result has the reason if it is not carried out, since a rejection has no field for a reason.
"""

from __future__ import annotations

import enum
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, NamedTuple

import trio

from strands_actors.kernel.channels.ros2.definitions import CANCEL, STATUS
from strands_actors.kernel.channels.ros2.graph import Call, Node
from strands_actors.kernel.channels.ros2.names import Qos

from .readings import stamp

KEPT = 32
"""So many results are kept for clients that ask later."""
MOST_WAITING = 64
"""So many clients may wait for results at the same time."""
MOST_RUNNING = 8
"""A further goal is rejected. All goals but one are about to end with a reason."""
FEEDBACK_S = 0.1


class GoalState(enum.IntEnum):
    """The states of action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


ENDED = frozenset({GoalState.SUCCEEDED, GoalState.CANCELED, GoalState.ABORTED})


class Ending(NamedTuple):
    """The end of a goal.

    Attributes:
        reached: False if the goal was not carried out, or not to its end. A cancel is no such failure.
        result: The fields of the action's result.
    """

    reached: bool
    result: Mapping[str, Any]


class Goal:
    """A goal, from its acceptance to its result."""

    def __init__(self, goal_id: bytes) -> None:
        self.id = goal_id
        self.state = GoalState.ACCEPTED
        self.accepted_s = time.time()
        self.result: Mapping[str, Any] = {}
        self.is_canceled = False
        self.done = trio.Event()
        self.next_feedback = -FEEDBACK_S

    @property
    def info(self) -> dict[str, Any]:
        return {"goal_id": {"uuid": self.id}, "stamp": stamp(self.accepted_s)}


Execute = Callable[[Goal, Mapping[str, Any]], Awaitable[Ending]]


class ActionServer:
    """The server of one action.

    Args:
        node: The node of the robot.
        name: The full name of the action.
        type_name: The type of the action.
        execute: Carries out a goal: called with the goal and its message, returns its end.
        left: The end of a goal that is cut off, because the robot leaves the graph.
    """

    def __init__(self, node: Node, name: str, type_name: str, execute: Execute, left: Ending) -> None:
        self.name = name
        self._execute = execute
        self._left = left
        self._goals: OrderedDict[bytes, Goal] = OrderedDict()
        self._waiting = 0
        self._nursery: trio.Nursery | None = None
        self._status = node.publisher(f"{name}/_action/status", STATUS, Qos.LATCHED)
        self._feedback = node.publisher(f"{name}/_action/feedback", f"{type_name}_FeedbackMessage")
        node.serve(f"{name}/_action/send_goal", f"{type_name}_SendGoal", self._on_goal)
        node.serve(f"{name}/_action/cancel_goal", CANCEL, self._on_cancel)
        node.serve(f"{name}/_action/get_result", f"{type_name}_GetResult", self._on_result)

    async def run(self) -> None:
        """Carry out goals until cancelled."""
        async with trio.open_nursery() as self._nursery:
            await trio.sleep_forever()

    def send_feedback(self, goal: Goal, make: Callable[[], Mapping[str, Any]]) -> None:
        """Publish feedback, at most once in ``FEEDBACK_S``."""
        now = trio.current_time()
        if now >= goal.next_feedback and self._feedback.has_subscribers:
            goal.next_feedback = now + FEEDBACK_S
            self._feedback.publish({"goal_id": {"uuid": goal.id}, "feedback": make()})

    @property
    def _running(self) -> list[Goal]:
        return [goal for goal in self._goals.values() if goal.state not in ENDED]

    # -- services

    def _on_goal(self, call: Call) -> None:
        request = call.arrival.message
        goal = Goal(bytes(request["goal_id"]["uuid"]))
        accepted = goal.id not in self._goals and len(self._running) < MOST_RUNNING and self._nursery is not None
        call.reply({"accepted": accepted, "stamp": stamp(goal.accepted_s)})
        if accepted and self._nursery is not None:
            self._goals[goal.id] = goal
            ended = [each.id for each in self._goals.values() if each.state in ENDED]
            for goal_id in ended[: max(0, len(self._goals) - KEPT)]:
                del self._goals[goal_id]
            self._nursery.start_soon(self._carry_out, goal, request["goal"])

    def _on_cancel(self, call: Call) -> None:
        requested_id = bytes(call.arrival.message["goal_info"]["goal_id"]["uuid"])
        goals = [goal for goal in self._running if requested_id == goal.id or not any(requested_id)]
        for goal in goals:
            goal.is_canceled = True
            self._set_state(goal, GoalState.CANCELING)
        # 2: the goal is unknown, 3: it has ended. A request without an id is for all goals.
        code = 0 if goals or not any(requested_id) else 3 if requested_id in self._goals else 2
        call.reply({"return_code": code, "goals_canceling": [goal.info for goal in goals]})

    def _on_result(self, call: Call) -> None:
        goal = self._goals.get(bytes(call.arrival.message["goal_id"]["uuid"]))
        if goal is None or self._waiting >= MOST_WAITING or self._nursery is None:
            call.reply({"status": int(GoalState.UNKNOWN)})
        else:
            self._nursery.start_soon(self._send_result, goal, call)

    async def _send_result(self, goal: Goal, call: Call) -> None:
        self._waiting += 1
        try:
            await goal.done.wait()
        finally:
            self._waiting -= 1
        call.reply({"status": int(goal.state), "result": goal.result})

    # -- a goal

    async def _carry_out(self, goal: Goal, message: Mapping[str, Any]) -> None:
        ending = self._left
        try:
            self._set_state(goal, GoalState.EXECUTING)
            ending = await self._execute(goal, message)
        finally:
            goal.result = ending.result
            ended = GoalState.CANCELED if goal.is_canceled else GoalState.SUCCEEDED
            self._set_state(goal, ended if ending.reached else GoalState.ABORTED)
            goal.done.set()

    def _set_state(self, goal: Goal, state: GoalState) -> None:
        goal.state = state
        listed = [{"goal_info": each.info, "status": int(each.state)} for each in self._goals.values()]
        self._status.publish({"status_list": listed})
