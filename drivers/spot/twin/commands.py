"""Carry out the commands to the body of the simulated Spot, and report their progress.

Each accepted command has a number. A later command replaces an earlier one part by part: a command to the arm alone
does not end a walk. The feedback of a replaced part reads "overridden".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Motors

from . import targets as t
from .arm import ArmCommands
from .feedback import ArmMove, BaseMove, ClawMove, Progress, WholeMove
from .frames import frames_of
from .geometry import Pose, pose_at, turned
from .mechanism import Mechanism
from .paths import Path
from .requests import COMMANDS, names_of
from .stance import accuracy_of
from .walking import ArmFollow, SpeedLimits, Trajectory

TOO_DISTANT_S = 600.0
CLOCK = "twin-clock"
PARAMS_TYPE = "bosdyn.api.spot.MobilityParams"
_ARM_PARTS = ("arm_command", "gripper_command")
BEHIND_HAND_M = 0.75
"""How far the body stays behind the hand that it follows, by default [assumed]."""


class Walk(NamedTuple):
    """A command to the base that was read and found valid."""

    seconds: float
    frame: str
    limits: SpeedLimits


class Commands:
    """The robot-command service.

    Args:
        mechanism: The body.
        table: The robot's row in ``robots.toml``.
        has_arm: True if the robot has an arm.
        robot_ns: The robot's clock.
    """

    def __init__(
        self, mechanism: Mechanism, table: Mapping[str, Any], has_arm: bool, robot_ns: Callable[[], int]
    ) -> None:
        self._mechanism = mechanism
        self._table = table
        self._has_arm = has_arm
        self._robot_ns = robot_ns
        self._arm = ArmCommands(mechanism, table, has_arm, robot_ns)
        self._progress = Progress(mechanism)

    def feedback(self, number: int) -> Message:
        return self._progress.feedback(number)

    def carry_out(self, command: Message, clock: str, is_estopped: bool) -> tuple[p.Command, int]:
        """Carry out a command, or refuse it. A refused command changes nothing.

        Returns:
            The status of the reply, and the number of the command; 0 if it was refused.
        """
        status = self._refusal(command, is_estopped)
        if status is not None:
            return status, 0
        whole, parts = command.get("full_body_command", {}), command.get("synchronized_command", {})
        if "safe_power_off_request" in whole:
            self._mechanism.settle()
            return p.Command.OK, self._progress.add(whole=WholeMove("safe_power_off"))
        if "stop_request" in whole:
            self._mechanism.halt()
            return p.Command.OK, self._progress.add(whole=WholeMove("stop"))
        return self._move(parts, clock)

    # -- refusals

    def _refusal(self, command: Message, is_estopped: bool) -> p.Command | None:
        """Return why every command of this kind is refused now; None if it is not refused."""
        names = list(names_of(command))
        if any(name not in COMMANDS and not self._is_ignored(name) for name in names):
            return p.Command.UNSUPPORTED
        if not names or not t.is_finite(command) or len(names) != len({name.partition(".")[0] for name in names}):
            return p.Command.INVALID_REQUEST
        if "full_body_command.safe_power_off_request" in names:
            return None
        return p.Command.NOT_POWERED_ON if self._mechanism.motors is not Motors.ON or is_estopped else None

    def _is_ignored(self, name: str) -> bool:
        """Return True for a command to an arm that this robot lacks: its feedback reports that."""
        return not self._has_arm and name.partition(".")[0] in _ARM_PARTS

    # -- synchronized commands

    def _move(self, parts: Message, clock: str) -> tuple[p.Command, int]:
        """Check all parts of a command, then carry all of them out."""
        base = self._base(parts.get("mobility_command", {}), clock)

        def left(request: Message) -> float | p.Command:
            return self._seconds_left(request, clock)

        arm = self._arm.arm(parts["arm_command"], left) if "arm_command" in parts else None
        claw = self._arm.claw(parts["gripper_command"]) if "gripper_command" in parts else None
        for plan in (base, arm, claw):
            if isinstance(plan, p.Command):
                return plan, 0
        moves = [plan() for plan in (base, arm, claw) if callable(plan)]
        return p.Command.OK, self._progress.add(
            base=next((move for move in moves if isinstance(move, BaseMove)), None),
            arm=next((move for move in moves if isinstance(move, ArmMove)), None),
            claw=next((move for move in moves if isinstance(move, ClawMove)), None),
        )

    # -- base

    def _base(self, base: Message, clock: str) -> Callable[[], BaseMove] | p.Command | None:
        names = [name for name in base if name != "params"]
        if not names:
            return None
        mechanism, content = self._mechanism, base[names[0]]
        if base.get("params", {}).get("type_url", PARAMS_TYPE).rpartition("/")[2] != PARAMS_TYPE:
            return p.Command.INVALID_REQUEST
        params = base.get("params", {}).get("value", {})
        if names[0] == "stop_request":
            return lambda: self._do(mechanism.halt_base, BaseMove("stop"))
        if names[0] == "sit_request":
            return lambda: self._do(mechanism.sit, BaseMove("sit"))
        if names[0] == "follow_arm_request" and not self._has_arm:
            return lambda: BaseMove("none")
        posture = self._posture(params.get("body_control", {}), stands=names[0] == "stand_request")
        if isinstance(posture, p.Command):
            return posture
        if names[0] == "stand_request":

            def stand() -> BaseMove:
                mechanism.stand(Commander.WIRE)
                mechanism.posture.follow(posture)
                return BaseMove("stand")

            return stand
        start = self._start(names[0], content, params, clock)
        if isinstance(start, p.Command):
            return start

        def go() -> BaseMove:
            move = start()
            mechanism.posture.follow(posture)
            return move

        return go

    @staticmethod
    def _do(action: Callable[[], None], move: BaseMove) -> BaseMove:
        action()
        return move

    def _start(
        self, name: str, content: Message, params: Message, clock: str
    ) -> Callable[[], BaseMove] | p.Command:
        """Check a command that moves the feet. Return the function that begins it."""
        if name == "follow_arm_request":
            return self._follow_arm(content, params)
        if name == "stance_request":
            return self._stance(content, clock)
        walk = self._walk(content, params, clock, name)
        if isinstance(walk, p.Command):
            return walk
        is_velocity = name == "se2_velocity_request"
        return self._velocity(content, walk) if is_velocity else self._trajectory(content, walk)

    def _seconds_left(self, request: Message, clock: str) -> float | p.Command:
        """Return the time until the end time of a command, seconds, or why that is refused."""
        if clock != CLOCK:
            return p.Command.NO_TIMESYNC
        seconds = (p.stamp_ns(request.get("end_time", {})) - self._robot_ns()) / p.NS
        if seconds <= 0:
            return p.Command.EXPIRED
        return p.Command.TOO_DISTANT if seconds > TOO_DISTANT_S else seconds

    def _walk(self, request: Message, params: Message, clock: str, name: str) -> Walk | p.Command:
        """Check the end time and the frame of a command to walk."""
        seconds = self._seconds_left(request, clock)
        if isinstance(seconds, p.Command):
            return seconds
        frames = t.VELOCITY_FRAMES if name == "se2_velocity_request" else t.TRAJECTORY_FRAMES
        frame = request.get("se2_frame_name", "")
        if frame not in frames:
            return p.Command.UNKNOWN_FRAME
        return Walk(seconds, frame, t.limits_of(params, self._table))

    def _velocity(self, request: Message, walk: Walk) -> Callable[[], BaseMove]:
        twist = walk.limits.limit(t.twist_of(request.get("velocity", {})))
        in_world, slew = walk.frame in t.WORLD_FRAMES, t.slew_of(request)

        def start() -> BaseMove:
            self._mechanism.walk(twist, walk.seconds, Commander.WIRE, slew=slew, in_world=in_world)
            return BaseMove("velocity", ends_s=self._mechanism.time_s + walk.seconds, request=request)

        return start

    def _trajectory(self, request: Message, walk: Walk) -> Callable[[], BaseMove] | p.Command:
        mechanism, points = self._mechanism, request.get("trajectory", {})
        frame = Pose() if walk.frame in t.WORLD_FRAMES else mechanism.footprint
        places = t.places_of(points, frame, mechanism.yaw_rad)
        path = t.path_of(mechanism.time_s, mechanism.place, t.times_of(points, self._robot_ns()), places)
        if path is None:
            return p.Command.INVALID_REQUEST
        trajectory = Trajectory(path, walk.limits, float(self._table["ramp_m_s2"]))

        def start() -> BaseMove:
            mechanism.go(trajectory, walk.seconds, Commander.WIRE)
            return BaseMove("trajectory", mechanism.time_s + walk.seconds, trajectory, request)

        return start

    def _follow_arm(self, request: Message, params: Message) -> Callable[[], BaseMove] | p.Command:
        """Check a command to stay behind the hand. Only a hand with a goal in the world is followed [assumed]."""
        mechanism = self._mechanism
        offset = request.get("body_offset_from_hand", {"x": BEHIND_HAND_M})

        def hand() -> tuple[float, float] | None:
            goal = None if mechanism.hand is None else mechanism.hand.goal_in_world()
            return None if goal is None else (goal.xyz[0], goal.xyz[1])

        ahead = float(offset.get("x", 0.0)), float(offset.get("y", 0.0))
        limits = t.limits_of(params, self._table)
        follow = ArmFollow(hand, ahead, limits, float(self._table["ramp_m_s2"]))

        def start() -> BaseMove:
            mechanism.go(follow, math.inf, Commander.WIRE)
            return BaseMove("follow_arm")

        return start

    def _stance(self, request: Message, clock: str) -> Callable[[], BaseMove] | p.Command:
        """Check a command to put the feet to places. A stance that is too far away is accepted; its feedback
        reports that, and the robot does not move (``StanceCommand``)."""
        mechanism, stance = self._mechanism, request.get("stance", {})
        seconds = self._seconds_left(request, clock)
        if isinstance(seconds, p.Command):
            return seconds
        name, feet = stance.get("se2_frame_name", ""), t.feet_of(stance)
        if name not in t.VELOCITY_FRAMES:
            return p.Command.UNKNOWN_FRAME
        if feet is None:
            return p.Command.INVALID_REQUEST
        frame = self.frame(name)
        x, y, yaw = *frame.xyz[:2], frame.roll_pitch_yaw[2]
        places = [(x + ahead, y + aside) for ahead, aside in (turned(yaw, *foot) for foot in feet)]
        motion = mechanism.stance_at(places, accuracy_of(stance))
        is_near = motion.is_near(mechanism.posture.default_feet[0][2])

        def start() -> BaseMove:
            if not is_near:
                mechanism.halt_base()
                return BaseMove("stance", mechanism.time_s + seconds)
            mechanism.stand_at(motion, seconds, Commander.WIRE)
            return BaseMove("stance", mechanism.time_s + seconds, stance=motion)

        return start

    def _posture(self, control: Message, stands: bool) -> Path | p.Command:
        """Return the path of the body's posture. ``body_pose`` counts only for a robot that stands."""
        mechanism = self._mechanism
        trajectory, frame = control.get("base_offset_rt_footprint", {}), Pose()
        if "body_pose" in control and stands:
            pose = control["body_pose"]
            trajectory = pose.get("base_offset_rt_root", {})
            name = pose.get("root_frame_name", "")
            if name not in t.POSE_FRAMES:
                return p.Command.UNKNOWN_FRAME
            default = mechanism.footprint.compose(pose_at(0.0, 0.0, float(self._table["stand_m"])))
            frame = default.inverse().compose(self.frame(name))
        offsets = t.offsets_of(trajectory, frame)
        if offsets is None or ("body_pose" in control and stands and not offsets):
            return p.Command.INVALID_REQUEST
        times = t.times_of(trajectory, self._robot_ns())
        if not offsets:
            offsets, times = [(0.0,) * 6], [0.0]
        path = t.path_of(mechanism.time_s, mechanism.posture.offset, times, offsets)
        return p.Command.INVALID_REQUEST if path is None else path

    def frame(self, name: str) -> Pose:
        """Return the pose of one of ``POSE_FRAMES``, relative to the place on the floor where the robot started."""
        return frames_of(self._mechanism, self._has_arm)[name]


def kind_of(command: Message) -> tuple[str, str | None]:
    """Return the kind of a command and the safe state that it causes, for the log of messages."""
    whole, parts = command.get("full_body_command", {}), command.get("synchronized_command", {})
    base = parts.get("mobility_command", {})
    if "safe_power_off_request" in whole:
        return "safe", "settle"
    if "stop_request" in whole or "stop_request" in base:
        return "safe", "hold"
    if "stand_request" in base or "sit_request" in base:
        return "enable", None
    return "setpoint", None


__all__ = ["CLOCK", "TOO_DISTANT_S", "Commands", "kind_of"]
