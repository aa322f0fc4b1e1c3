"""Carry out the commands to the body of the simulated Spot, and report their progress.

Each accepted command has a number. A later command replaces an earlier one part by part: a command to the arm alone
does not end a walk. The feedback of a replaced part reads "overridden".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Motors

from . import targets as t
from .feedback import ArmMove, BaseMove, ClawMove, Progress, WholeMove
from .geometry import Pose, pose_at
from .mechanism import CLAW_INDEX, CLAW_RAD_S, Mechanism
from .paths import Path
from .requests import COMMANDS, NAMED_POSITIONS, names_of
from .walking import SpeedLimits, Trajectory

TOO_DISTANT_S = 600.0
CLOCK = "twin-clock"
PARAMS_TYPE = "bosdyn.api.spot.MobilityParams"
_ARM_PARTS = ("arm_command", "gripper_command")


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
        arm = self._arm(parts["arm_command"]) if "arm_command" in parts else None
        claw = self._claw(parts["gripper_command"]) if "gripper_command" in parts else None
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
        posture = self._posture(params.get("body_control", {}), stands=names[0] == "stand_request")
        if isinstance(posture, p.Command):
            return posture
        if names[0] == "stand_request":

            def stand() -> BaseMove:
                mechanism.stand(Commander.WIRE)
                mechanism.posture.follow(posture)
                return BaseMove("stand")

            return stand
        walk = self._walk(content, params, clock, names[0])
        if isinstance(walk, p.Command):
            return walk
        is_velocity = names[0] == "se2_velocity_request"
        start = self._velocity(content, walk) if is_velocity else self._trajectory(content, walk)
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

    def _walk(self, request: Message, params: Message, clock: str, name: str) -> Walk | p.Command:
        """Check the end time and the frame of a command to walk."""
        if clock != CLOCK:
            return p.Command.NO_TIMESYNC
        seconds = (p.stamp_ns(request.get("end_time", {})) - self._robot_ns()) / p.NS
        if seconds <= 0:
            return p.Command.EXPIRED
        if seconds > TOO_DISTANT_S:
            return p.Command.TOO_DISTANT
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
        if name in t.WORLD_FRAMES:
            return self._mechanism.odometry
        body = self._mechanism.body_pose
        return body if name == "body" else pose_at(*body.xyz, yaw=body.roll_pitch_yaw[2])

    # -- arm and claw

    def _arm(self, arm: Message) -> Callable[[], ArmMove] | p.Command | None:
        names = [name for name in arm if name != "params"]
        if not self._has_arm:
            return lambda: ArmMove("none")
        if not names:
            return None
        if names[0] == "arm_stop_command":

            def stop() -> ArmMove:
                self._mechanism.halt_arm()
                return ArmMove("arm_stop")

            return stop
        if names[0] == "named_arm_position_command":
            return self._named_position(arm[names[0]].get("position", 0))
        return self._joint_move(arm[names[0]].get("trajectory", {}))

    def _named_position(self, position: int) -> Callable[[], ArmMove] | p.Command:
        if position not in NAMED_POSITIONS:
            return p.Command.INVALID_REQUEST
        goal = tuple(float(value) for value in self._table[NAMED_POSITIONS[position]][:CLAW_INDEX])
        return self._arm_to(Path(0.0, goal, [(0.0, goal)]), float(self._table["arm_rad_s"]), "named", goal)

    def _joint_move(self, trajectory: Message) -> Callable[[], ArmMove] | p.Command:
        mechanism = self._mechanism
        points = t.arm_points(trajectory, mechanism.joints)
        claw = mechanism.joints[CLAW_INDEX]
        limited = [tuple(mechanism.limited((*point, claw))[:CLAW_INDEX]) for point in points]
        times = t.times_of(trajectory, self._robot_ns())
        path = t.path_of(mechanism.time_s, tuple(mechanism.joints[:CLAW_INDEX]), times, limited)
        if path is None:
            return p.Command.INVALID_REQUEST
        fastest = min(float(self._table["arm_rad_s"]), t.number(trajectory, "maximum_velocity"))
        return self._arm_to(path, fastest, "joint_move", points[-1])

    def _arm_to(self, path: Path, fastest: float, kind: str, requested: tuple[float, ...]) -> Callable[[], ArmMove]:
        def start() -> ArmMove:
            mechanism = self._mechanism
            is_timed = not path.has_ended(mechanism.time_s)
            present = mechanism.joints[:CLAW_INDEX]
            speeds = (fastest,) * CLAW_INDEX if is_timed else t.together(present, path.last, fastest)
            mechanism.follow_arm(path, speeds, Commander.WIRE)
            return ArmMove(kind, is_limited=requested != path.last)

        return start

    def _claw(self, gripper: Message) -> Callable[[], ClawMove] | p.Command | None:
        if not self._has_arm:
            return lambda: ClawMove("none")
        if not gripper:
            return None
        mechanism, request = self._mechanism, gripper["claw_gripper_command"]
        trajectory = request.get("trajectory", {})
        points = [
            (mechanism.limited((*mechanism.joints[:CLAW_INDEX], float(point.get("point", 0.0))))[CLAW_INDEX],)
            for point in trajectory.get("points", ())
        ]
        times = t.times_of(trajectory, self._robot_ns())
        path = t.path_of(mechanism.time_s, tuple(mechanism.joints[CLAW_INDEX:]), times, points)
        if path is None:
            return p.Command.INVALID_REQUEST
        speed = min(CLAW_RAD_S, t.number(request, "maximum_open_close_velocity"))

        def start() -> ClawMove:
            mechanism.follow_claw(path, speed, Commander.WIRE)
            return ClawMove("claw")

        return start


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
