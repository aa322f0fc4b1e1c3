"""Simulate Spot's body: it stands up, walks and sits, carries its body as commanded, and its arm follows its
goals."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.stepped import LONGEST_S, Stepped, towards
from strands_actors.drivers.spot.protocol import Motors
from strands_actors.drivers.spot.robots import ARM, CLAW

from .geometry import Pose, pose_at, turned
from .hand import HandMotion
from .paths import Path, held
from .posture import Posture
from .stance import Point, Stance, middle_of, under
from .walking import REST, Place, Trajectory, Twist

"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""
_SIMULATION_STAND_S = 0.3
"""How long it takes to stand up if a simulation moves the robot, and not a client."""

JOINTS = (*ARM, CLAW)
CLAW_INDEX = len(ARM)
CLAW_RAD_S = 10.0
"""Default of ``maximum_open_close_velocity`` (gripper_command.proto)."""
HAND_RAD_S = 5.0
"""Fastest joint of the arm while the hand moves along poses [assumed]."""
NO_SLEW: Twist = (math.inf, math.inf, math.inf)


class Mechanism(Stepped):
    STEP_S = 0.005

    def __init__(self, table: Mapping[str, Any], now_s: Callable[[], float]) -> None:
        self._table = table
        super().__init__(now_s)
        self.walked_m = self.walked_s = self.powered_s = 0.0
        """How far and for how long it has walked, and for how long its motors had power."""
        self.reset()

    def reset(self) -> None:
        """Put the robot back at its start: sitting, motors off, the arm stowed."""
        self.commander = Commander.NONE
        self.motors = Motors.OFF
        self.up = 0.0
        """How far the robot has stood up: 0 sits, 1 stands."""
        self.wants_up = False
        self._cuts_when_down = False
        self._on_in_s = 0.0
        self.target_twist: Twist = REST
        self.present_twist: Twist = REST
        self._slew: Twist = NO_SLEW
        self._in_world = False
        self._ends_s = math.inf
        self.trajectory: Trajectory | None = None
        self.stance: Stance | None = None
        self._stepping: Twist = REST
        """Speed of the footprint while the feet are put to places: in the frame of odometry."""
        self.x_m = self.y_m = self.yaw_rad = 0.0
        self.posture = Posture(self._table)
        self.joints = [float(value) for value in self._table["home_rad"]]
        self.speeds = [0.0] * len(self.joints)
        self.hand: HandMotion | None = None
        self._reach_at(self.joints)
        self.stuck = False

    # -- commands

    def power_on(self, at_once: bool = False) -> None:
        self.pass_time()
        if self.motors is Motors.OFF:
            self.motors = Motors.ON if at_once else Motors.POWERING_ON
            self._on_in_s = float(self._table["power_on_s"])

    def cut(self) -> None:
        """Switch motors off at once, in any pose. A standing robot falls."""
        self.pass_time()
        self._switch_off()

    def _switch_off(self) -> None:
        self.motors = Motors.OFF
        self.halt()
        self.up, self.wants_up, self._cuts_when_down = 0.0, False, False
        self.posture.level(at_once=True)
        self.commander = Commander.NONE

    def settle(self) -> None:
        """Sit down, then switch the motors off."""
        self.pass_time()
        self.halt()
        self.wants_up, self._cuts_when_down = False, True
        if self.motors is not Motors.ON:
            self._switch_off()

    def stand(self, commander: Commander) -> None:
        self.pass_time()
        self.halt_base()
        self.wants_up, self._cuts_when_down = True, False
        self.commander = commander

    def sit(self) -> None:
        self.pass_time()
        self.halt_base()
        self.wants_up = False

    def halt(self) -> None:
        """Stop walking, and stop body and arm where they are. The robot stands."""
        self.halt_base()
        self._reach_at(self.joints)

    def halt_base(self) -> None:
        self.target_twist, self._ends_s = REST, math.inf
        self._in_world, self._slew = False, NO_SLEW
        self._leave_trajectory()
        self.stance = None
        self.posture.hold()

    def halt_arm(self) -> None:
        """Stop the arm. The claw goes on."""
        self._arm_path, self.hand = held(self.joints[:CLAW_INDEX]), None

    def walk(
        self, twist: Twist, for_s: float, commander: Commander, slew: Twist = NO_SLEW, in_world: bool = False
    ) -> None:
        """Walk with this twist for ``for_s`` seconds. A sitting robot stands up first, as the real one does (issues
        175 and 260 of rai-opensource/spot_ros2).

        Args:
            twist: m/s and rad/s.
            for_s: Duration, seconds.
            commander: Who moves the robot.
            slew: Fastest change of each part of the twist, per second.
            in_world: True if the twist is relative to the frame of odometry, and not to the robot.
        """
        self.pass_time()
        self._leave_trajectory()
        self.stance, self.posture.feet = None, self.posture.default_feet
        self.wants_up, self._cuts_when_down = True, False
        self.target_twist, self.commander = twist, commander
        self._slew, self._in_world = slew, in_world
        self._ends_s = self.time_s + for_s

    def go(self, trajectory: Trajectory, for_s: float, commander: Commander) -> None:
        """Walk along a trajectory, for at most ``for_s`` seconds. A sitting robot stands up first [assumed]."""
        self.walk(REST, for_s, commander)
        self.trajectory = trajectory

    def stand_at(self, stance: Stance, for_s: float, commander: Commander) -> None:
        """Put the feet to places, within ``for_s`` seconds. A sitting robot stands up first [assumed]."""
        self.pass_time()
        self.halt_base()
        self.wants_up, self._cuts_when_down = True, False
        self.stance, self.commander = stance, commander
        self._ends_s = self.time_s + for_s

    def stance_at(self, goals: Sequence[Point], accuracy_m: float) -> Stance:
        """Return the stance with the feet at these places on the floor."""
        up_in_s = (1.0 - self.up) * float(self._table["stand_s"])
        middle = middle_of(self.posture.default_feet)
        return Stance(self.time_s + up_in_s, self.place, self._feet_on_the_floor(), goals, accuracy_m, middle)

    def _feet_on_the_floor(self) -> list[Point]:
        places = (self.footprint.compose(Pose(foot)).xyz for foot in self.posture.feet)
        return [(x, y) for x, y, _ in places]

    def reach(self, goals_rad: Mapping[int, float], commander: Commander) -> None:
        """Move joints of the arm, by index, as fast as they can. A goal outside a joint's range becomes the nearest
        limit."""
        self.pass_time()
        goals = [goals_rad.get(index, goal) for index, goal in enumerate(self._goal)]
        self._reach_at(self.limited(goals))
        self.commander = commander

    def follow_arm(self, path: Path, speeds_rad_s: Sequence[float], commander: Commander) -> None:
        """Move the six joints of the arm along a path, with these highest speeds."""
        self.pass_time()
        self._arm_path, self._arm_speeds, self.commander = path, tuple(speeds_rad_s), commander
        self.hand = None

    def move_hand(self, motion: HandMotion, commander: Commander) -> None:
        """Move the hand of the arm. When the motion is over, the arm stays where it is."""
        self.pass_time()
        self.hand, self.commander = motion, commander

    def follow_claw(self, path: Path, speed_rad_s: float, commander: Commander) -> None:
        self.pass_time()
        self._claw_path, self._claw_speed, self.commander = path, speed_rad_s, commander

    def limited(self, joints_rad: Sequence[float]) -> list[float]:
        """Return joints of arm and claw, each within its range. The robot picks the nearest joints that it can
        reach (``ArmJointTrajectory``, arm_command.proto)."""
        ranges = self._table["joints_rad"].values()
        return [min(max(value, low), high) for value, (low, high) in zip(joints_rad, ranges, strict=True)]

    def _reach_at(self, joints: Sequence[float]) -> None:
        self._arm_path, self._claw_path = held(joints[:CLAW_INDEX]), held(joints[CLAW_INDEX:])
        self._arm_speeds = (math.inf,) * CLAW_INDEX
        self._claw_speed = math.inf
        self.hand = None

    def _leave_trajectory(self) -> None:
        if self.trajectory is not None:
            self.trajectory.is_over = True
            self.trajectory = None

    # -- state

    @property
    def stands(self) -> bool:
        return self.up >= 1.0

    @property
    def is_posed(self) -> bool:
        """Return True if the robot stands and its body is where the command wants it."""
        return self.stands and self.posture.has_arrived(self.time_s)

    @property
    def _goal(self) -> tuple[float, ...]:
        return (*self._arm_path.last, *self._claw_path.last)

    @property
    def arm_arrived(self) -> bool:
        is_there = tuple(self.joints[:CLAW_INDEX]) == self._arm_path.last
        return self.hand is None and self._arm_path.has_ended(self.time_s) and is_there

    @property
    def claw_arrived(self) -> bool:
        return self._claw_path.has_ended(self.time_s) and self.joints[CLAW_INDEX] == self._claw_path.last[0]

    @property
    def arm_left_s(self) -> float:
        """Return the time until the arm is at its goal, seconds."""
        ways = zip(self._arm_path.last, self.joints[:CLAW_INDEX], self._arm_speeds, strict=True)
        fastest = float(self._table["arm_rad_s"])
        times = [abs(goal - now) / min(speed, fastest) for goal, now, speed in ways if goal != now]
        return max(0.0, self._arm_path.ends_s - self.time_s, *times)

    @property
    def walks(self) -> bool:
        """Return True if the robot is commanded to move, or still moves."""
        follows = self.trajectory is not None and not self.trajectory.waits
        wants = self.target_twist != REST or follows or self.stance is not None
        return wants or any(abs(speed) > 1e-9 for speed in self.present_twist)

    @property
    def place(self) -> Place:
        return self.x_m, self.y_m, self.yaw_rad

    @property
    def odometry(self) -> Pose:
        """Return the pose of the frame of odometry above the floor: that of the body at the start, which sits
        (docs/concepts/geometry_and_frames.md)."""
        return pose_at(0.0, 0.0, float(self._table["sit_m"]))

    @property
    def footprint(self) -> Pose:
        """Return the pose of the centre of the feet, on the floor, relative to the place where the robot began."""
        return pose_at(self.x_m, self.y_m, 0.0, yaw=self.yaw_rad)

    @property
    def body_pose(self) -> Pose:
        """Return the pose of the body, relative to the place on the floor where the robot started."""
        return self.footprint.compose(self.posture.body(self.up))

    @property
    def velocity(self) -> tuple[float, float, float, float]:
        """Return the body's speed along x, y, z and about z, in the frame of odometry."""
        vx, vy, wz = self.present_twist
        x, y, z, _, _, yaw = self.posture.rates if self.stands else (0.0,) * 6
        forwards, sideways = turned(self.yaw_rad, vx + x, vy + y)
        to_x, to_y, turn = self._stepping
        return forwards + to_x, sideways + to_y, z, wz + yaw + turn

    @property
    def legs_rad(self) -> list[tuple[float, ...]]:
        """Return the angles of each leg: two of the hip, one of the knee."""
        return self.posture.legs_rad(self.up)

    def pass_time(self) -> None:
        # Count the time of a long pause, so that a twist ends on time. The motion of the pause is left out.
        self.time_s += max(0.0, self.now_s() - self._updated_s - LONGEST_S)
        super().pass_time()

    def _step(self, step_s: float) -> None:
        if self.motors is Motors.POWERING_ON:
            self._on_in_s -= step_s
            if self._on_in_s <= 0:
                self.motors = Motors.ON
        if self.time_s >= self._ends_s:
            self.target_twist, self._ends_s = REST, math.inf
            self._leave_trajectory()
            self.stance = None
            self.commander = Commander.NONE if self.commander is Commander.WIRE else self.commander
        is_able = self.motors is Motors.ON and not self.stuck
        if is_able:
            self._rise(step_s)
        self._walk(is_able and self.stands, step_s)
        self._put_feet(is_able and self.stands, step_s)
        self._move_arm(is_able, step_s)

    def _rise(self, step_s: float) -> None:
        rise_s = float(self._table["stand_s"] if self.wants_up else self._table["sit_s"])
        if self.commander is Commander.SIM:
            rise_s = _SIMULATION_STAND_S
        self.up = towards(self.up, float(self.wants_up), step_s / rise_s)
        if self.stands:
            self.posture.step(self.time_s, step_s)
        if self.up == 0.0 and not self.wants_up:
            self.posture.level(at_once=True)
            if self._cuts_when_down:
                self._switch_off()

    def _walk(self, moves: bool, step_s: float) -> None:
        goal_speeds = self._commanded_twist() if moves else REST
        ramp = float(self._table["ramp_m_s2"])
        vx, vy, wz = (
            towards(now, goal, min(ramp, slew) * step_s)
            for now, goal, slew in zip(self.present_twist, goal_speeds, self._slew, strict=True)
        )
        self.present_twist = vx, vy, wz
        x, y = turned(self.yaw_rad, vx, vy)
        self.x_m += x * step_s
        self.y_m += y * step_s
        self.yaw_rad += wz * step_s
        self.walked_m += math.hypot(vx, vy) * step_s
        self.walked_s += step_s if any(self.present_twist) else 0.0
        self.powered_s += step_s if self.motors is Motors.ON else 0.0

    def _put_feet(self, moves: bool, step_s: float) -> None:
        self._stepping = REST
        if self.stance is None or not moves:
            return
        before, place = self.place, self.stance.place_at(self.time_s)
        x, y, yaw = ((after - now) / step_s for now, after in zip(before, place, strict=True))
        self._stepping, (self.x_m, self.y_m, self.yaw_rad) = (x, y, yaw), place
        down_m = self.posture.default_feet[0][2]
        feet = self.stance.feet_at(self.time_s)
        self.posture.feet = tuple(under(place, foot, down_m) for foot in feet)
        if self.stance.has_ended(self.time_s):
            self.stance = None

    def _commanded_twist(self) -> Twist:
        if self.trajectory is not None:
            return self.trajectory.twist(self.time_s, self.place)
        vx, vy, wz = self.target_twist
        if self._in_world:
            vx, vy = turned(-self.yaw_rad, vx, vy)
        return vx, vy, wz

    def _move_arm(self, moves: bool, step_s: float) -> None:
        fastest = float(self._table["arm_rad_s"]) if moves else 0.0
        arm, speeds = self._arm_path.values_at(self.time_s), [min(fastest, speed) for speed in self._arm_speeds]
        if self.hand is not None:
            present = tuple(self.joints[:CLAW_INDEX])
            step = self.hand.step(self.time_s, step_s, self.body_pose, present) if moves else None
            arm, speeds = step or present, [HAND_RAD_S] * CLAW_INDEX
        goals = (*arm, *self._claw_path.values_at(self.time_s))
        # A client's command moves the claw faster than the arm. A simulation moves both alike.
        claw = self._claw_speed if math.isfinite(self._claw_speed) else fastest
        speeds.append(claw if moves else 0.0)
        for index, (goal, speed) in enumerate(zip(goals, speeds, strict=True)):
            before = self.joints[index]
            self.joints[index] = towards(before, goal, speed * step_s)
            self.speeds[index] = (self.joints[index] - before) / step_s


__all__ = ["CLAW_INDEX", "CLAW_RAD_S", "JOINTS", "NO_SLEW", "REST", "Mechanism", "Twist"]
