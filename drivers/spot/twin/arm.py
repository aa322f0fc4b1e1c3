"""Carry out the commands to arm and gripper of the simulated Spot.

Each function checks a command first. It returns a function that carries the command out, or the status of the
refusal, so that a command whose other parts are refused moves nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Vector, rotated

from . import targets as t
from .feedback import ArmMove, ClawMove
from .frames import OF_THE_BODY, frames_of, level
from .geometry import Pose, pose_at, pose_of
from .hand import ANGULAR_RAD_S, LINEAR_M_S, BodyPose, Follow, Limits, Track, Velocity, around_the_shoulder
from .limbs import HAND
from .mechanism import CLAW_INDEX, CLAW_RAD_S, Mechanism
from .paths import Path
from .reach import joints_for
from .requests import NAMED_POSITIONS

_HAND = Pose(HAND)
"""The default tool of ``ArmCartesianCommand``, relative to the wrist (arm_command.proto)."""
_CAMERA = Pose(HAND, pose_at(0.0, 0.0, 0.0, pitch=math.radians(-9.0)).rotation)
"""The default tool of ``GazeCommand`` (arm_command.proto)."""
_GAZE_FROM: tuple[Vector, ...] = (
    (0.8, 0.0, 0.35),
    (0.55, 0.0, 0.75),
    (0.5, 0.45, 0.35),
    (0.5, -0.45, 0.35),
    (0.1, 0.45, 0.55),
    (0.1, -0.45, 0.55),
)
"""Places of the hand in the body, for a gaze that is impossible from where the hand is. "The robot will pick one"
(example arm_gaze). These are [assumed]."""
_AXES = ("x_axis", "y_axis", "z_axis", "rx_axis", "ry_axis", "rz_axis")
_FORCE = 1
"""Value of an axis of ``ArmCartesianCommand`` that is controlled by force."""
CYLINDRICAL_M_S = 0.5
"""Default of ``max_linear_velocity`` of ``CylindricalVelocity`` (arm_command.proto)."""

ArmPlan = Callable[[], ArmMove] | p.Command | None
ClawPlan = Callable[[], ClawMove] | p.Command | None
SecondsLeft = Callable[[Message], float | p.Command]
"""Returns the time until the end time of a command, seconds, or why that is refused."""


class ArmCommands:
    """The commands to arm and gripper.

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
        self._ranges = list(table["joints_rad"].values())[:CLAW_INDEX]
        self._has_arm = has_arm
        self._robot_ns = robot_ns

    def arm(self, arm: Message, seconds_left: SecondsLeft) -> ArmPlan:
        """Check a command to the arm."""
        names = [name for name in arm if name != "params"]
        if not self._has_arm:
            return lambda: ArmMove("none")
        if not names:
            return None
        request = arm[names[0]]
        match names[0]:
            case "arm_stop_command":
                return self._stop
            case "named_arm_position_command":
                return self._named_position(request.get("position", 0))
            case "arm_cartesian_command":
                return self._cartesian(request)
            case "arm_gaze_command":
                return self._gaze(request)
            case "arm_velocity_command":
                return self._velocity(request, seconds_left)
        return self._joint_move(request.get("trajectory", {}))

    def _stop(self) -> ArmMove:
        self._mechanism.halt_arm()
        return ArmMove("arm_stop")

    # -- joints

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

    # -- hand

    def _cartesian(self, request: Message) -> Callable[[], ArmMove] | p.Command:
        """Check a command to move the tool along poses. Forces are not modelled."""
        if "wrench_trajectory_in_task" in request or any(request.get(axis, 0) == _FORCE for axis in _AXES):
            return p.Command.UNSUPPORTED
        frame = self._frame(request.get("root_frame_name", ""))
        if frame is None:
            return p.Command.UNKNOWN_FRAME
        task = _optional_pose(request, "root_tform_task", Pose())
        tool = _optional_pose(request, "wrist_tform_tool", _HAND)
        points = t.poses_of(request.get("pose_trajectory_in_task", {}))
        if task is None or tool is None or not points:
            return p.Command.INVALID_REQUEST
        start = self._tool(frame, tool)
        track = self._track(request["pose_trajectory_in_task"], start, [task.compose(pose) for pose in points])
        if track is None:
            return p.Command.INVALID_REQUEST
        is_fixed = request["root_frame_name"] not in OF_THE_BODY
        limits = _limits_of(request)
        return self._move(
            "cartesian",
            Follow(start, track, frame=frame, is_fixed=is_fixed, tool=tool, ranges=self._ranges, limits=limits),
        )

    def _gaze(self, request: Message) -> Callable[[], ArmMove] | p.Command:
        """Check a command to look at a place, or along places, while the hand stays or moves along poses."""
        targets_in = self._frame(request.get("frame1_name", ""))
        poses, has_poses = request.get("tool_trajectory_in_frame2", {}), "tool_trajectory_in_frame2" in request
        frame = self._frame(request.get("frame2_name", "") if has_poses else "flat_body")
        if targets_in is None or frame is None:
            return p.Command.UNKNOWN_FRAME
        tool = _optional_pose(request, "wrist_tform_tool", _CAMERA)
        places = [
            Pose(t.vector_of(point.get("point", {}))) for point in _points(request, "target_trajectory_in_frame1")
        ]
        points = t.poses_of(poses)
        if tool is None or not places or points is None or (has_poses and not points):
            return p.Command.INVALID_REQUEST
        start = self._tool(frame, tool)
        looks_at = Pose(self._look(frame, targets_in, start))
        targets = self._track(request["target_trajectory_in_frame1"], looks_at, places)
        tracks = [self._track(poses, start, points)] if has_poses else self._places_of_the_hand(start)
        if targets is None or tracks[0] is None:
            return p.Command.INVALID_REQUEST
        is_fixed = has_poses and request["frame2_name"] not in OF_THE_BODY

        motions = [
            Follow(
                start,
                track,
                targets,
                targets_in=targets_in,
                frame=frame,
                is_fixed=is_fixed,
                tool=tool,
                ranges=self._ranges,
                limits=_limits_of(request),
            )
            for track in tracks
            if track is not None
        ]
        possible = (motion for motion in motions if self._can_reach(motion, frame, tool))
        return self._move("gaze", next(possible, motions[0]))

    def _places_of_the_hand(self, start: Pose) -> list[Track | None]:
        """Return from where the hand may look, the best first: from where it is, else from other places."""
        now_s = self._mechanism.time_s
        others = (Pose(xyz, start.rotation) for xyz in _GAZE_FROM)
        return [Track(now_s, start, [(now_s, place)]) for place in (start, *others)]

    def _velocity(self, request: Message, seconds_left: SecondsLeft) -> Callable[[], ArmMove] | p.Command:
        """Check a command to move the hand with a velocity."""
        left_s = seconds_left(request)
        if isinstance(left_s, p.Command):
            return left_s

        def flat() -> Pose:
            return level(self._mechanism.body_pose)

        velocity = self._linear(request, flat)
        if isinstance(velocity, p.Command):
            return velocity
        spin = t.vector_of(request.get("angular_velocity_of_hand_rt_odom_in_hand", {}))
        ends_s = self._mechanism.time_s + left_s
        start = self._tool(flat, _HAND)
        return self._move(
            "velocity", Velocity(start, velocity, spin, ends_s, frame=flat, tool=_HAND, ranges=self._ranges)
        )

    def _linear(self, request: Message, flat: BodyPose) -> Callable[[Vector], Vector] | p.Command:
        """Return the velocity of the hand in the frame ``flat_body``, from its place there."""
        if "cylindrical_velocity" in request:
            cylindrical = request["cylindrical_velocity"]
            share = cylindrical.get("linear_velocity", {})
            fastest = t.number(cylindrical, "max_linear_velocity")
            fastest = fastest if math.isfinite(fastest) else CYLINDRICAL_M_S
            radial, around, up = (
                fastest * max(-1.0, min(1.0, float(share.get(key, 0.0)))) for key in ("r", "theta", "z")
            )
            return around_the_shoulder(radial, around, up)
        if "cartesian_velocity" not in request:
            return lambda place: (0.0, 0.0, 0.0)
        cartesian = request["cartesian_velocity"]
        frame = self._frame(cartesian.get("frame_name", ""))
        if frame is None:
            return p.Command.UNKNOWN_FRAME
        in_frame = t.vector_of(cartesian.get("velocity_in_frame_name", {}))
        return lambda place: rotated(flat().inverse().rotation, rotated(frame().rotation, in_frame))

    def _move(self, kind: str, motion: Follow | Velocity) -> Callable[[], ArmMove]:
        def start() -> ArmMove:
            self._mechanism.move_hand(motion, Commander.WIRE)
            return ArmMove(kind, motion=motion)

        return start

    def _frame(self, name: str) -> BodyPose | None:
        """Return where a frame is; None if its name is unknown. A frame of feet or arm stays where it is when the
        command comes [assumed], because the hand would otherwise run away from itself."""
        now = frames_of(self._mechanism, self._has_arm)
        if name not in now:
            return None
        if name == "body":
            return lambda: self._mechanism.body_pose
        if name == "flat_body":
            return lambda: level(self._mechanism.body_pose)
        pose = now[name]
        return lambda: pose

    def _tool(self, frame: BodyPose, tool: Pose) -> Pose:
        """Return the present pose of the tool in a frame."""
        hand = frames_of(self._mechanism, True)["arm0.link_wr1"]
        return frame().inverse().compose(hand).compose(tool)

    def _look(self, frame: BodyPose, targets_in: BodyPose, start: Pose) -> Vector:
        """Return the place in front of the tool, one metre away: the gaze begins there."""
        ahead = start.compose(Pose((1.0, 0.0, 0.0)))
        return targets_in().inverse().compose(frame()).compose(ahead).xyz

    def _can_reach(self, motion: Follow, frame: BodyPose, tool: Pose) -> bool:
        """Return True if the arm can look at the last target from where its hand is."""
        desired = motion.desired(math.inf)
        wrist = self._mechanism.body_pose.inverse().compose(frame()).compose(desired).compose(tool.inverse())
        return joints_for(wrist, self._mechanism.joints, self._ranges) is not None

    def _track(self, trajectory: Message, start: Pose, poses: list[Pose]) -> Track | None:
        """Return poses in time; None if their times decrease."""
        times = t.times_of(trajectory, self._robot_ns())
        if not t.is_sorted(times):
            return None
        now_s = self._mechanism.time_s
        return Track(now_s, start, [(now_s + time, pose) for time, pose in zip(times, poses, strict=True)])

    # -- gripper

    def claw(self, gripper: Message) -> ClawPlan:
        """Check a command to the gripper."""
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


def _points(request: Message, name: str) -> list[Message]:
    points: list[Message] = request.get(name, {}).get("points", [])
    return points


def _optional_pose(request: Message, name: str, default: Pose) -> Pose | None:
    """Return a pose of a request; its default if it is missing, None if its rotation is invalid."""
    return pose_of(request[name]) if name in request else default


def _limits_of(request: Message) -> Limits:
    linear, angular = t.number(request, "max_linear_velocity"), t.number(request, "max_angular_velocity")
    return Limits(
        linear if math.isfinite(linear) else LINEAR_M_S,
        angular if math.isfinite(angular) else ANGULAR_RAD_S,
        t.number(request, "max_pos_tracking_error"),
        t.number(request, "max_rot_tracking_error"),
    )
