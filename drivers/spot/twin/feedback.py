"""The progress of commands to the simulated Spot, as ``RobotCommandFeedback`` reports it."""

from __future__ import annotations

import math
from typing import NamedTuple

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Motors

from .geometry import distance, gaze_and_roll
from .hand import AT_GOAL_M, AT_GOAL_RAD, Follow, Velocity
from .mechanism import CLAW_INDEX, Mechanism
from .stance import Stance
from .walking import Trajectory

PROCESSING, OVERRIDDEN, TIMED_OUT, INCOMPATIBLE_HARDWARE = 1, 2, 3, 5
"""Statuses of each part (``RobotCommandFeedbackStatus``)."""
DONE, IN_PROGRESS, STALLED = 1, 2, 3
"""Statuses of a stand, a sit, a move of the arm and a safe power off. Only a move of the arm can stall."""
STOPPED, ON_THE_WAY, STOPPING = 1, 2, 3
"""Statuses of ``SE2TrajectoryCommand.Feedback``."""
BODY_MOVING, BODY_SETTLED = 1, 2
GOAL_IN_PROGRESS, GOAL_ACHIEVABLE = 1, 2
PLANNER_SUCCESS, PLANNER_MODIFIED = 1, 2
CLAW_IN_PROGRESS, CLAW_AT_GOAL = 1, 2
STANCED, GOING_TO_STANCE, TOO_FAR_AWAY = 1, 2, 3
CANCELLED, HAND_STALLED = 3, 4
"""Statuses of ``ArmCartesianCommand.Feedback``, beside ``DONE`` and ``IN_PROGRESS``."""
CONTROLLED = 1
"""The robot stands and balances (``StandingState``)."""
KEPT = 100
"""The feedback of so many of the latest commands is kept."""


class WholeMove(NamedTuple):
    """A command to the whole body: ``stop`` or ``safe_power_off``."""

    kind: str


class BaseMove(NamedTuple):
    """A command to the base: ``stop``, ``sit``, ``stand``, ``velocity``, ``trajectory``, ``stance``,
    ``follow_arm``, or ``none`` if it needs an arm that the robot lacks."""

    kind: str
    ends_s: float = 0.0
    trajectory: Trajectory | None = None
    request: Message = {}  # noqa: RUF012
    stance: Stance | None = None
    """None for a stance that is too far away."""


class ArmMove(NamedTuple):
    """A command to the arm: ``joint_move``, ``named``, ``cartesian``, ``gaze``, ``velocity``, ``arm_stop``, or
    ``none`` without an arm."""

    kind: str
    is_limited: bool = False
    """True if the robot cannot reach the requested joints."""
    motion: Follow | Velocity | None = None
    """The motion of the hand."""


class ClawMove(NamedTuple):
    """A command to the claw: ``claw``, or ``none`` without an arm."""

    kind: str


class _Entry(NamedTuple):
    whole: WholeMove | None
    base: BaseMove | None
    arm: ArmMove | None
    claw: ClawMove | None


class Progress:
    """The commands that were accepted, by number."""

    def __init__(self, mechanism: Mechanism) -> None:
        self._mechanism = mechanism
        self._entries: dict[int, _Entry] = {}
        self._newest = dict.fromkeys(("base", "arm", "claw"), 0)
        self._count = 0

    def add(
        self,
        whole: WholeMove | None = None,
        base: BaseMove | None = None,
        arm: ArmMove | None = None,
        claw: ClawMove | None = None,
    ) -> int:
        """Add a command that was accepted. Return its number."""
        self._count += 1
        self._entries[self._count] = _Entry(whole, base, arm, claw)
        self._entries.pop(self._count - KEPT, None)
        for part, move in (("base", base), ("arm", arm), ("claw", claw)):
            if whole or move:
                self._newest[part] = self._count
        return self._count

    def feedback(self, number: int) -> Message:
        """Return the feedback of a command; empty for a number that is not known."""
        entry = self._entries.get(number)
        if entry is None:
            return {}
        if entry.whole is not None:
            newer = any(newest > number for newest in self._newest.values())
            status = OVERRIDDEN if newer else PROCESSING
            return {"full_body_feedback": {**self._whole(entry.whole), "status": status}}
        parts: Message = {}
        if entry.base is not None:
            parts["mobility_command_feedback"] = self._base(entry.base, self._newest["base"] > number)
        if entry.arm is not None:
            parts["arm_command_feedback"] = self._arm(entry.arm, self._newest["arm"] > number)
        if entry.claw is not None:
            parts["gripper_command_feedback"] = self._claw(entry.claw, self._newest["claw"] > number)
        return {"synchronized_feedback": parts}

    def _whole(self, move: WholeMove) -> Message:
        if move.kind == "stop":
            return {"stop_feedback": {}}
        is_off = self._mechanism.motors is Motors.OFF
        return {"safe_power_off_feedback": {"status": DONE if is_off else IN_PROGRESS}}

    def _base(self, move: BaseMove, overridden: bool) -> Message:
        mechanism = self._mechanism
        status = OVERRIDDEN if overridden else PROCESSING
        match move.kind:
            case "stand":
                is_done = mechanism.is_posed and mechanism.wants_up and not mechanism.walks
                stand = {"status": DONE if is_done else IN_PROGRESS, "standing_state": CONTROLLED}
                return {"status": status, "stand_feedback": stand}
            case "sit":
                return {"status": status, "sit_feedback": {"status": DONE if mechanism.up == 0 else IN_PROGRESS}}
            case "stop":
                return {"status": status, "stop_feedback": {}}
            case "none":
                return {"status": INCOMPATIBLE_HARDWARE}
            case "follow_arm":
                return {"status": status, "follow_arm_feedback": {}}
            case "stance":
                return self._stance(move, status)
        trajectory = move.trajectory
        has_arrived = trajectory is not None and trajectory.has_arrived
        if not overridden and mechanism.time_s >= move.ends_s and not has_arrived:
            status = TIMED_OUT
        if trajectory is None:
            return {"status": status, "se2_velocity_feedback": {"request_information": move.request}}
        return {"status": status, "se2_trajectory_feedback": self._trajectory(trajectory, move.request)}

    def _stance(self, move: BaseMove, status: int) -> Message:
        mechanism, stance = self._mechanism, move.stance
        if stance is None:
            return {"status": status, "stance_feedback": {"status": TOO_FAR_AWAY}}
        is_done = stance.has_ended(mechanism.time_s) and mechanism.stands
        if not is_done and status == PROCESSING and mechanism.time_s >= move.ends_s:
            status = TIMED_OUT
        return {"status": status, "stance_feedback": {"status": STANCED if is_done else GOING_TO_STANCE}}

    def _trajectory(self, trajectory: Trajectory, request: Message) -> Message:
        is_over = trajectory.has_arrived or trajectory.is_over
        is_still = not any(abs(speed) > _STILL for speed in self._mechanism.present_twist)
        return {
            "status": STOPPED if is_over else STOPPING if trajectory.is_near else ON_THE_WAY,
            "body_movement_status": BODY_SETTLED if is_over and is_still else BODY_MOVING,
            "final_goal_status": GOAL_ACHIEVABLE if trajectory.has_arrived else GOAL_IN_PROGRESS,
            "request_information": request,
        }

    def _arm(self, move: ArmMove, overridden: bool) -> Message:
        if move.kind == "none":
            return {"status": INCOMPATIBLE_HARDWARE}
        mechanism = self._mechanism
        status = OVERRIDDEN if overridden else PROCESSING
        match move.motion:
            case Follow() if move.kind == "gaze":
                return {"status": status, "arm_gaze_feedback": self._gaze(move.motion, overridden)}
            case Follow():
                return {"status": status, "arm_cartesian_feedback": self._cartesian(move.motion, overridden)}
            case Velocity():
                has_ended = mechanism.time_s >= move.motion.ends_s and not overridden
                return {"status": TIMED_OUT if has_ended else status, "arm_velocity_feedback": {}}
        if move.kind == "arm_stop":
            return {"status": status, "arm_stop_feedback": {}}
        progress = IN_PROGRESS
        if mechanism.arm_arrived and not overridden:
            progress = STALLED if move.is_limited else DONE
        if move.kind == "named":
            return {"status": status, "named_arm_position_feedback": {"status": progress}}
        return {
            "status": status,
            "arm_joint_move_feedback": {
                "status": progress,
                "planner_status": PLANNER_MODIFIED if move.is_limited else PLANNER_SUCCESS,
                "time_to_goal": p.duration(mechanism.arm_left_s),
            },
        }

    def _cartesian(self, motion: Follow, overridden: bool) -> Message:
        now_s, at_end = self._mechanism.time_s, self._off(motion, math.inf)
        error_m, error_rad = self._off(motion, now_s)
        return {
            "status": self._progress(motion, overridden),
            "measured_pos_tracking_error": error_m,
            "measured_rot_tracking_error": error_rad,
            "measured_pos_distance_to_goal": at_end[0],
            "measured_rot_distance_to_goal": at_end[1],
        }

    def _gaze(self, motion: Follow, overridden: bool) -> Message:
        progress = self._progress(motion, overridden)
        far_m, _ = self._off(motion, math.inf)
        tool = motion.tool_now(self._mechanism.body_pose, self._mechanism.joints[:CLAW_INDEX])
        # The rotation between two gazes has two parts: the direction, and the roll about it.
        look_rad, roll_rad = gaze_and_roll(tool.rotation, motion.desired(math.inf).rotation)
        return {
            "status": STALLED if progress in (CANCELLED, HAND_STALLED) else progress,
            "gazing_at_target": look_rad <= AT_GOAL_RAD,
            "gaze_to_target_rotation_measured": look_rad,
            "hand_position_at_goal": far_m <= AT_GOAL_M,
            "hand_distance_to_goal_measured": far_m,
            "hand_roll_at_goal": roll_rad <= AT_GOAL_RAD,
            "hand_roll_to_target_roll_measured": roll_rad,
        }

    def _off(self, motion: Follow, time_s: float) -> tuple[float, float]:
        """Return how far the tool is from where the command wants it at a time: metres and radians."""
        mechanism = self._mechanism
        return distance(motion.tool_now(mechanism.body_pose, mechanism.joints[:CLAW_INDEX]), motion.desired(time_s))

    def _progress(self, motion: Follow, overridden: bool) -> int:
        mechanism = self._mechanism
        if motion.is_cancelled:
            return CANCELLED
        if overridden:
            return IN_PROGRESS
        if motion.has_arrived(mechanism.time_s, mechanism.body_pose, mechanism.joints[:CLAW_INDEX]):
            return DONE
        return HAND_STALLED if motion.is_stalled else IN_PROGRESS

    def _claw(self, move: ClawMove, overridden: bool) -> Message:
        if move.kind == "none":
            return {"status": INCOMPATIBLE_HARDWARE}
        at_goal = self._mechanism.claw_arrived and not overridden
        return {
            "status": OVERRIDDEN if overridden else PROCESSING,
            "claw_gripper_feedback": {"status": CLAW_AT_GOAL if at_goal else CLAW_IN_PROGRESS},
        }


_STILL = 0.01
