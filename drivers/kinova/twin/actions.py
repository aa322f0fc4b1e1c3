"""Carry out actions: one at a time, with an event at each start and end.

A new command aborts the running action. A planned action has events of its planning, too. A gripper's action has no
event at its end, as in the vendor's own simulator.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import SubError

from . import messages as m
from .arm import Arm, Ended
from .commands import decode_speeds, decode_twist
from .errors import CallFailed
from .functions import ACTIONS, ActionKind, Function
from .gripper import Gripper
from .kinematics import pose_of
from .messages import Action
from .paths import Leg, Planner
from .stores import Changed, Store
from .topics import Topics, timestamp
from .waypoints import WaypointPlanner

HANDLE_FIELD = 5

PREDEFINED: Mapping[str, Sequence[float]] = {
    "Retract": (0.0, 340.0, 180.0, 214.0, 0.0, 310.0, 90.0),
    "Home": (0.0, 15.0, 180.0, 230.0, 0.0, 55.0, 90.0),
    "Zero": (0.0,) * 7,
}
"""Angles in degrees of the actions that the base has, with the numbers 1, 2 and 3: the named poses of the vendor's
ROS packages."""

PLANNED = (ActionKind.REACH_POSE, ActionKind.REACH_JOINT_ANGLES, ActionKind.EXECUTE_WAYPOINT_LIST)
AT_ONCE = (ActionKind.APPLY_EMERGENCY_STOP, ActionKind.CLEAR_FAULTS, ActionKind.STOP_ACTION)

DURATION, SPEED = 1, 2
"""Types of the constraint of a joint motion."""


class Event(enum.IntEnum):
    """``ActionEvent`` of the vendor."""

    END = 1
    ABORT = 2
    START = 4
    PREPROCESS_START = 5
    PREPROCESS_ABORT = 6
    PREPROCESS_END = 7


class Running(NamedTuple):
    action: Action
    ended: Ended
    ends_s: float = math.inf  # the time at which a delay ends


def _ignore(sub_error: SubError) -> None:
    """Report the end of an action only by its event."""


class Actions:
    def __init__(
        self,
        arm: Arm,
        planner: Callable[[], tuple[Planner, WaypointPlanner]],
        gripper: Gripper | None,
        topics: Topics,
        at_once: Mapping[int, Callable[[], None]],
        now_s: Callable[[], float],
        changed: Changed,
    ) -> None:
        """Args:
        arm: The arm.
        planner: Returns the planners, which are made when they are first used.
        gripper: The gripper, if there is one.
        topics: Gets the events.
        at_once: Carries out the actions that take no time.
        now_s: Returns the present time.
        changed: See ``Store``.
        """
        self._arm = arm
        self._planner = planner
        self._gripper = gripper
        self._topics = topics
        self._at_once = at_once
        self._now_s = now_s
        self._running: Running | None = None
        self.store: Store[Action] = Store(HANDLE_FIELD, changed)
        self.reset()

    def reset(self) -> None:
        """Keep only the predefined actions. The running action ends without an event."""
        self._running = None
        kind = ActionKind.REACH_JOINT_ANGLES
        self.store.reset(
            {
                number: Action(kind, pb.bytes_field(1, m.encode_angles(angles)), name, "", number, m.READ)
                for number, (name, angles) in enumerate(PREDEFINED.items(), 1)
            }
        )

    # -- stored actions

    def create(self, payload: bytes) -> bytes:
        action = m.decode_action(payload)
        self._prepare(action)
        number = self.store.add(action)
        return self._numbered(number, action).encode_handle()

    def read(self, payload: bytes) -> bytes:
        number = m.identifier_of(payload)
        return self._numbered(number, self.store.get(number)).encode()

    def read_all(self, payload: bytes) -> bytes:
        kind = pb.last_int(pb.message(payload), 1)
        return b"".join(
            pb.bytes_field(1, self._numbered(number, action).encode())
            for number, action in self.store.items()
            if kind in (0, action.kind)
        )

    @staticmethod
    def _numbered(number: int, action: Action) -> Action:
        return action._replace(identifier=number, permission=action.permission or m.READ | m.DELETE)

    # -- carrying out

    @property
    def runs(self) -> bool:
        return self._running is not None

    def execute(self, action: Action, ended: Ended = _ignore) -> None:
        """Abort the running action, and begin this one.

        Args:
            action: The action.
            ended: Called at its end, with ``NONE`` if it was carried out.

        Raises:
            CallFailed: The base does not have this type of action, or its parameters are invalid.
        """
        while action.kind == ActionKind.EXECUTE_ACTION:
            number = m.identifier_of(action.parameters)
            action = self._numbered(number, self.store.get(number))
        begin = self._prepare(action)
        self.abort(SubError.MANUAL_STOP)
        self._running = running = Running(action, ended)
        planned = action.kind in PLANNED
        if planned:
            self._publish(action, Event.PREPROCESS_START)
        try:
            begin()
        except CallFailed as failed:
            if planned:
                self._publish(action, Event.PREPROCESS_ABORT, failed.sub_error)
            self._end(running, failed.sub_error)
            return
        if planned:
            self._publish(action, Event.PREPROCESS_END)
        self._publish(action, Event.START)
        if action.kind in AT_ONCE:
            self._running = None
            self._at_once[action.kind]()
            self._end(running, SubError.NONE)

    def abort(self, sub_error: SubError) -> None:
        """Abort the running action, if there is one. The arm brakes."""
        running = self._running
        if running is not None:
            self._arm.hold()
            self._end(running, sub_error)

    def pass_time(self) -> None:
        """End a delay, and an action of the gripper, when they are over."""
        running = self._running
        if running is None:
            return
        is_gripper = running.action.kind == ActionKind.SEND_GRIPPER_COMMAND
        if self._now_s() >= running.ends_s or (is_gripper and not (self._gripper and self._gripper.moves)):
            self._end(running, SubError.NONE)

    def _end(self, running: Running, sub_error: SubError) -> None:
        if self._running is running:
            self._running = None
        is_gripper = running.action.kind == ActionKind.SEND_GRIPPER_COMMAND
        if sub_error is not SubError.NONE:
            self._publish(running.action, Event.ABORT, sub_error)
        elif not is_gripper:
            self._publish(running.action, Event.END)
        running.ended(sub_error)

    def _publish(self, action: Action, event: Event, sub_error: SubError = SubError.NONE) -> None:
        payload = (
            pb.varint_field(1, event)
            + pb.bytes_field(2, action.encode_handle())
            + pb.bytes_field(3, timestamp())
            + pb.varint_field(5, sub_error)
        )
        self._topics.publish(Function.ACTION_TOPIC, payload)

    # -- types of actions

    def _prepare(self, action: Action) -> Callable[[], None]:
        """Decode the parameters of an action.

        Returns:
            The function that begins it. It raises ``CallFailed`` if the arm cannot do it.
        """
        if action.kind not in ACTIONS:
            raise CallFailed(SubError.UNSUPPORTED_ACTION, f"action type {action.kind}")
        data = action.parameters
        match action.kind:
            case ActionKind.REACH_JOINT_ANGLES:
                return self._joint_angles(pb.message(data))
            case ActionKind.REACH_POSE:
                return self._pose(pb.message(data))
            case ActionKind.EXECUTE_WAYPOINT_LIST:
                pb.message(data)
                return lambda: self._play(self._planner()[1].plan(self._arm.rest(), data))
            case ActionKind.SEND_TWIST_COMMAND:
                twist = decode_twist(data)
                return lambda: self._arm.set_twist(twist.values, twist.in_tool)
            case ActionKind.SEND_JOINT_SPEEDS:
                speeds = decode_speeds(data, self._planner()[0].hard_rad_s)
                return lambda: self._arm.set_speeds(speeds)
            case ActionKind.TIME_DELAY:
                ends_s = self._now_s() + pb.last_int(pb.message(data), 1)
                return lambda: self._wait(ends_s)
            case ActionKind.SEND_GRIPPER_COMMAND:
                gripper = self._gripper
                if gripper is None:
                    raise CallFailed(SubError.DEVICE_DISCONNECTED, "the arm has no gripper")
                return lambda: gripper.obey(data)
            case ActionKind.EXECUTE_ACTION:
                number = m.identifier_of(data)
                self.store.get(number)
        return lambda: None

    def _joint_angles(self, fields: m.Fields) -> Callable[[], None]:
        degrees = m.decode_angles(m.sub_message(fields, 1))
        constraint = m.sub_message(fields, 2)
        kind, value = pb.last_int(constraint, 1), m.finite(constraint, 2)
        if kind in (DURATION, SPEED) and value <= 0.0:
            reason = SubError.INVALID_DURATION if kind == DURATION else SubError.INVALID_SPEED
            raise CallFailed(reason, f"the constraint is {value}")
        duration_s = value if kind == DURATION else 0.0
        rad_s = math.radians(value) if kind == SPEED else 0.0
        return lambda: self._play([self._planner()[0].joints(self._arm.rest(), degrees, duration_s, rad_s)])

    def _pose(self, fields: m.Fields) -> Callable[[], None]:
        pose = pose_of(m.decode_pose(m.sub_message(fields, 1)))
        speed = m.sub_message(m.sub_message(fields, 2), 1)
        m_s, rad_s = m.finite(speed, 1), math.radians(m.finite(speed, 2))
        return lambda: self._play([self._planner()[0].line(self._arm.rest(), pose, m_s, rad_s)])

    def _play(self, legs: Sequence[Leg]) -> None:
        running = self._running
        assert running is not None
        self._arm.play(legs, lambda sub_error: self._end(running, sub_error))

    def _wait(self, ends_s: float) -> None:
        if self._running is not None:
            self._running = self._running._replace(ends_s=ends_s)
