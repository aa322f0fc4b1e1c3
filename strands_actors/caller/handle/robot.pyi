# fmt: off
"""Signatures of the factories by robot and mode, for editors and type checkers.

Made by ``python -m tests.editors.signatures`` from the drivers' options and services: do not edit.
A robot whose name is not literal has the last of the overloads that fit. Options of a driver of your
own go in as ``**options``, where ``options`` is a ``dict[str, Any]``.
"""

import os
from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any, Literal, TypeAlias, overload, type_check_only

from strands_actors.surfaces.agents.approval import Approve
from strands_actors.surfaces.mesh.config import MeshConfig

from .async_robot import AsyncRobot as AsyncRobot
from .envelopes import Answer
from .real_robot import RealRobot as RealRobot
from .sim_robot import SimRobot as SimRobot

# -- names of robots, by their driver

BoosterName: TypeAlias = Literal["booster_t1", "booster"]
CanMotorsName: TypeAlias = Literal[
    "bi_openarm", "openarm", "rebot_b601", "yam", "bi_openarm_follower", "open_arm", "openarm_bimanual",
    "openarm_follower", "rebot_b601_follower"
]
CrazyflieName: TypeAlias = Literal["crazyflie", "bitcraze_crazyflie", "cf2"]
DynamixelName: TypeAlias = Literal["koch", "koch_follower", "koch_v1_1", "low_cost_robot_arm"]
EarthRoverName: TypeAlias = Literal["earthrover", "earth_rover", "earthrover_mini_plus", "frodobots"]
FeetechName: TypeAlias = Literal[
    "hope_jr", "open_duck_mini", "so100", "so101", "bdx", "hope_jr_arm", "mini_bdx", "open_duck",
    "open_duck_mini_v2", "open_duck_v2", "robotstudio_so101", "so100_4cam", "so100_dualcam", "so100_follower",
    "so101_dualcam", "so101_follower", "so101_tricam", "so_arm100", "so_arm101", "trs_so_arm100"
]
FrankaName: TypeAlias = Literal[
    "fr3", "fr3_v2", "panda", "bimanual_panda_gripper", "bimanual_panda_hand", "franka", "franka_emika_panda",
    "franka_fr3", "franka_fr3_v2", "franka_panda", "libero_panda", "oxe_droid", "oxe_droid_rel",
    "oxe_droid_relative_eef_relative_joint", "single_panda_gripper"
]
G1Name: TypeAlias = Literal[
    "unitree_g1", "g1", "g1_wbc", "real_g1_relative_eef_relative_joints", "unitree_g1_full_body",
    "unitree_g1_locomanip", "unitree_g1_real", "unitree_g1_sonic", "unitree_g1_wbc"
]
Go2Name: TypeAlias = Literal["b2", "unitree_go2", "unitree_h1", "unitree_h1_2", "go2", "h1", "h1_2"]
KinovaName: TypeAlias = Literal["kinova_gen3", "gen3"]
KukaName: TypeAlias = Literal["kuka_iiwa", "iiwa", "iiwa14", "kuka_iiwa_14"]
MicroduckName: TypeAlias = Literal["microduck", "micro_duck", "pollen_microduck"]
RBY1Name: TypeAlias = Literal["rby1", "rainbow_rby1", "rby1a"]
ReachyName: TypeAlias = Literal["reachy_mini", "pollen_reachy_mini", "reachy", "reachy-mini"]
RobotiqName: TypeAlias = Literal["robotiq_2f85", "robotiq_2f85_v4", "2f85", "2f85_v4", "robotiq"]
SpotName: TypeAlias = Literal["spot", "boston_dynamics_spot"]
StretchName: TypeAlias = Literal[
    "stretch", "stretch3", "hello_robot_stretch", "hello_robot_stretch_3", "hello_robot_stretch_original",
    "hello_stretch_2", "hello_stretch_3", "stretch2", "stretch_2", "stretch_3", "stretch_re2", "stretch_se3"
]
URName: TypeAlias = Literal[
    "ur10e", "ur12e", "ur15", "ur16e", "ur18", "ur20", "ur30", "ur3e", "ur5e", "ur7e", "ur8long"
]
XArmName: TypeAlias = Literal["xarm7", "ufactory_xarm7", "xarm"]
YahboomM3ProName: TypeAlias = Literal["yahboom_m3pro", "m3pro", "rosmaster_m3pro", "yahboom_rosmaster_m3_pro"]
LeRobotName: TypeAlias = Literal[
    "bi_rebot_b601", "bi_rebot_b601_follower", "bi_so100", "bi_so101", "bi_so_follower", "hope_jr_hand", "lekiwi",
    "lekiwi_client", "omx", "omx_follower", "reachy2"
]

# -- handles with the services of one driver

@type_check_only
class AsyncSimulation(AsyncRobot):
    async def step(self, steps: int = 1, *, action: Mapping[str, Any] | None = None) -> Answer: ...
    async def reset(self) -> Answer: ...

@type_check_only
class Booster(RealRobot):
    def enable_upper_body(self, on: bool = True) -> Answer:
        """Hand the arms over to this program; after each stop, and each change of mode, once more. With on=False as
        disable_upper_body."""
    def disable_upper_body(self) -> Answer:
        """Give the arms back to the robot's own controller."""
    def move(self, vx: float = 0.0, vy: float = 0.0, vyaw: float = 0.0) -> Answer:
        """Walk so fast for 0.3 s, m/s and rad/s in the robot's own frame, then stand."""
    def rotate_head(self, pitch: float = 0.0, yaw: float = 0.0) -> Answer:
        """Turn the head there, radians."""
    def change_mode(self, mode: str = "walking") -> Answer:
        """Change to damping, prepare, walking, soccer; in damping mode the robot sinks to the floor."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncBooster(AsyncRobot):
    async def enable_upper_body(self, on: bool = True) -> Answer: ...
    async def disable_upper_body(self) -> Answer: ...
    async def move(self, vx: float = 0.0, vy: float = 0.0, vyaw: float = 0.0) -> Answer: ...
    async def rotate_head(self, pitch: float = 0.0, yaw: float = 0.0) -> Answer: ...
    async def change_mode(self, mode: str = "walking") -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedBooster(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedBooster(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class CanMotors(RealRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""

@type_check_only
class AsyncCanMotors(AsyncRobot):
    async def status(self) -> Answer: ...
    async def sensors(self) -> Answer: ...

@type_check_only
class SimulatedCanMotors(SimRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""

@type_check_only
class AsyncSimulatedCanMotors(AsyncSimulation):
    async def status(self) -> Answer: ...
    async def sensors(self) -> Answer: ...

@type_check_only
class Crazyflie(RealRobot):
    def takeoff(self, height: float = 0.5, duration: float = 2.0) -> Answer:
        """Arm the motors, rise to a height, hover there; in the air: go to that height."""
    def set_twist(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, z: float | None = None) -> Answer:
        """Fly at vx and vy (m/s) and wz (rad/s) for 300 ms, then hover; z: at this height (m)."""
    def land(self, duration: float = 2.0) -> Answer:
        """Come down to the floor, motors off."""
    def emergency_stop(self) -> Answer:
        """Cut the motors at once, wherever it is, and lock it until it is switched off and on."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(
    self, vx: float = ..., vy: float = ..., vz: float = ..., wz: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Fly for duration_s after a takeoff, then hover."""

@type_check_only
class AsyncCrazyflie(AsyncRobot):
    async def takeoff(self, height: float = 0.5, duration: float = 2.0) -> Answer: ...
    async def set_twist(
    self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, z: float | None = None,
) -> Answer: ...
    async def land(self, duration: float = 2.0) -> Answer: ...
    async def emergency_stop(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., vy: float = ..., vz: float = ..., wz: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer: ...

@type_check_only
class SimulatedCrazyflie(SimRobot):
    def set_twist(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, z: float | None = None) -> Answer:
        """Fly at vx and vy (m/s) and wz (rad/s) for 300 ms, then hover; z: at this height (m)."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def land(self) -> Answer:
        """Land at once, motors off on the floor; nothing flies again by itself."""
    def move(
    self, vx: float = ..., vy: float = ..., vz: float = ..., wz: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Fly for duration_s after a takeoff, then hover."""

@type_check_only
class AsyncSimulatedCrazyflie(AsyncSimulation):
    async def set_twist(
    self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, z: float | None = None,
) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def land(self) -> Answer: ...
    async def move(
    self, vx: float = ..., vy: float = ..., vz: float = ..., wz: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer: ...

@type_check_only
class Dynamixel(RealRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def set_torque(self, enabled: bool = ...) -> Answer:
        """Energise the motors where they are, or release them."""

@type_check_only
class AsyncDynamixel(AsyncRobot):
    async def status(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def set_torque(self, enabled: bool = ...) -> Answer: ...

@type_check_only
class SimulatedDynamixel(SimRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def set_torque(self, enabled: bool = ...) -> Answer:
        """Energise the motors where they are, or release them."""

@type_check_only
class AsyncSimulatedDynamixel(AsyncSimulation):
    async def status(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def set_torque(self, enabled: bool = ...) -> Answer: ...

@type_check_only
class EarthRover(RealRobot):
    def speak(self, text: str = "") -> Answer:
        """Say a text by the rover's speaker."""
    def move(
    self, linear: float = ..., angular: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer:
        """Drive for duration_s, or for 0.3 s, then stand."""
    def lamp(self, lamp: float = ..., *, wait: bool = True) -> Answer:
        """Light the lamp, or put it out; the rover drives on as it does."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncEarthRover(AsyncRobot):
    async def speak(self, text: str = "") -> Answer: ...
    async def move(
    self, linear: float = ..., angular: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def lamp(self, lamp: float = ..., *, wait: bool = True) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedEarthRover(SimRobot):
    def move(
    self, linear: float = ..., angular: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer:
        """Drive for duration_s, or for 0.3 s, then stand."""
    def lamp(self, lamp: float = ..., *, wait: bool = True) -> Answer:
        """Light the lamp, or put it out; the rover drives on as it does."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedEarthRover(AsyncSimulation):
    async def move(
    self, linear: float = ..., angular: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def lamp(self, lamp: float = ..., *, wait: bool = True) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class Feetech(RealRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def set_torque(self, enabled: bool = ...) -> Answer:
        """Energise the motors where they are, or release them."""

@type_check_only
class AsyncFeetech(AsyncRobot):
    async def status(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def set_torque(self, enabled: bool = ...) -> Answer: ...

@type_check_only
class SimulatedFeetech(SimRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def set_torque(self, enabled: bool = ...) -> Answer:
        """Energise the motors where they are, or release them."""

@type_check_only
class AsyncSimulatedFeetech(AsyncSimulation):
    async def status(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def set_torque(self, enabled: bool = ...) -> Answer: ...

@type_check_only
class Franka(RealRobot):
    def recover(self) -> Answer:
        """Let the controller clear a reflex, so that the arm may be armed again."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncFranka(AsyncRobot):
    async def recover(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedFranka(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedFranka(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class G1(RealRobot):
    def move(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, duration_s: float = 0.0) -> Answer:
        """Walk so fast, m/s and rad/s of the body, for so many seconds."""
    def stand_up(self) -> Answer:
        """Stand up, held by its hanger or from squatting, and balance."""
    def balance(self) -> Answer:
        """Unlock the joints of a robot that stands, so that it balances and can walk."""
    def damp(self) -> Answer:
        """Brake every joint: a robot that stands sinks to the floor unless its hanger holds it."""
    def squat(self) -> Answer:
        """Squat down; the joints stay locked."""
    def sit(self) -> Answer:
        """Sit down; something to sit on must be behind it."""
    def select_sport_mode(self) -> Answer:
        """Give the joints back to the onboard controller after they were commanded one by one (level='low')."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncG1(AsyncRobot):
    async def move(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, duration_s: float = 0.0) -> Answer: ...
    async def stand_up(self) -> Answer: ...
    async def balance(self) -> Answer: ...
    async def damp(self) -> Answer: ...
    async def squat(self) -> Answer: ...
    async def sit(self) -> Answer: ...
    async def select_sport_mode(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedG1(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedG1(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class Go2(RealRobot):
    def move(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, duration_s: float = 0.0) -> Answer:
        """Walk so fast, m/s and rad/s of the body, for so many seconds."""
    def stand_up(self) -> Answer:
        """Stand up from lying or from damping, and balance."""
    def balance(self) -> Answer:
        """Unlock the joints of a robot that stands, so that it balances and can walk."""
    def damp(self) -> Answer:
        """Brake every joint: a robot that stands sinks to the floor unless its hanger holds it."""
    def select_sport_mode(self) -> Answer:
        """Give the joints back to the onboard controller after they were commanded one by one (level='low')."""
    def lie_down(self) -> Answer:
        """Lie down; the joints stay locked."""
    def recover(self) -> Answer:
        """Get up from wherever it lies, turned over or not, and balance."""
    def sit(self) -> Answer:
        """Sit down."""
    def rise(self) -> Answer:
        """Rise from sitting, and balance."""
    def release_sport_mode(self, attempts: int = 5) -> Answer:
        """End the robot's own controller, so that its joints can be commanded: it no longer balances by itself."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncGo2(AsyncRobot):
    async def move(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0, duration_s: float = 0.0) -> Answer: ...
    async def stand_up(self) -> Answer: ...
    async def balance(self) -> Answer: ...
    async def damp(self) -> Answer: ...
    async def select_sport_mode(self) -> Answer: ...
    async def lie_down(self) -> Answer: ...
    async def recover(self) -> Answer: ...
    async def sit(self) -> Answer: ...
    async def rise(self) -> Answer: ...
    async def release_sport_mode(self, attempts: int = 5) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedGo2(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedGo2(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class Kinova(RealRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncKinova(AsyncRobot):
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedKinova(SimRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedKinova(AsyncSimulation):
    async def status(self) -> Answer: ...

@type_check_only
class Kuka(RealRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncKuka(AsyncRobot):
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedKuka(SimRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedKuka(AsyncSimulation):
    async def status(self) -> Answer: ...

@type_check_only
class Microduck(RealRobot):
    def enable(self) -> Answer:
        """Hand the duck to its policy: it stands up and balances."""
    def disable(self) -> Answer:
        """Take it back from its policy: it holds its pose, and nothing balances it."""
    def do(self, skill: str = "") -> Answer:
        """Run a skill that the robot has, by name."""
    def sit(self) -> Answer:
        """Sit down, if it stands."""
    def stand(self) -> Answer:
        """Stand up, if it sits."""
    def look_at(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, neck_pitch: float = 0.0) -> Answer:
        """Turn the head towards a point."""
    def relax(self, confirm: bool = False) -> Answer:
        """Take the torque away: an unheld duck collapses."""
    def init(self, confirm: bool = False) -> Answer:
        """Power the joints and move all of them to the home pose."""
    def reboot_motors(self, ids: str = "", confirm: bool = False) -> Answer:
        """Restart servos; torque goes off on all of them."""
    def skills(self) -> Answer:
        """List the skills that the robot has."""
    def sounds(self) -> Answer:
        """List the sounds that it can play."""
    def play_sound(self, tag: str = "chirp") -> Answer:
        """Play a sound of its voice."""
    def theremin(self, active: bool = True) -> Answer:
        """Play by the depth sensor, the mouth moves along; or end that."""
    def mode(self) -> Answer:
        """Report the drive mode."""
    def set_mode(self, mode: str = "") -> Answer:
        """Change the drive mode: it goes home, loads other policies, drives again."""
    def policies(self) -> Answer:
        """List the policy of each slot."""
    def load_policy(self, slot: str = "", path: str = "") -> Answer:
        """Put a file of the robot's into a policy slot; no path: back to its own."""
    def reload_policies(self) -> Answer:
        """Read all policy slots again."""
    def health(self) -> Answer:
        """Report the health of robotd."""
    def version(self) -> Answer:
        """Report the versions of robotd and of its protocol."""
    def model(self) -> Answer:
        """Report the geometry of the robot."""
    def odometry(self) -> Answer:
        """Report the robot's estimate of its position."""
    def monitor(self) -> Answer:
        """Report the newest state of robotd, unchanged."""
    def tof(self) -> Answer:
        """Report one frame of the depth sensor: 8 by 8 distances in millimetres."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(
    self, vx: float = ..., vy: float = ..., vyaw: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer:
        """Walk for duration seconds (default 1, at most 10), then stand. A zero stands at once."""
    def head(
    self, neck_pitch: float = ..., head_pitch: float = ..., head_yaw: float = ..., head_roll: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Turn the joints of the head."""
    def pose(self, z: float = ..., roll: float = ..., pitch: float = ..., *, wait: bool = True) -> Answer:
        """Shift and tilt the body on its feet."""
    def mouth(self, open: float = ..., *, wait: bool = True) -> Answer:
        """Open the mouth: 0 closed, 1 open."""

@type_check_only
class AsyncMicroduck(AsyncRobot):
    async def enable(self) -> Answer: ...
    async def disable(self) -> Answer: ...
    async def do(self, skill: str = "") -> Answer: ...
    async def sit(self) -> Answer: ...
    async def stand(self) -> Answer: ...
    async def look_at(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, neck_pitch: float = 0.0) -> Answer: ...
    async def relax(self, confirm: bool = False) -> Answer: ...
    async def init(self, confirm: bool = False) -> Answer: ...
    async def reboot_motors(self, ids: str = "", confirm: bool = False) -> Answer: ...
    async def skills(self) -> Answer: ...
    async def sounds(self) -> Answer: ...
    async def play_sound(self, tag: str = "chirp") -> Answer: ...
    async def theremin(self, active: bool = True) -> Answer: ...
    async def mode(self) -> Answer: ...
    async def set_mode(self, mode: str = "") -> Answer: ...
    async def policies(self) -> Answer: ...
    async def load_policy(self, slot: str = "", path: str = "") -> Answer: ...
    async def reload_policies(self) -> Answer: ...
    async def health(self) -> Answer: ...
    async def version(self) -> Answer: ...
    async def model(self) -> Answer: ...
    async def odometry(self) -> Answer: ...
    async def monitor(self) -> Answer: ...
    async def tof(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., vy: float = ..., vyaw: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def head(
    self, neck_pitch: float = ..., head_pitch: float = ..., head_yaw: float = ..., head_roll: float = ..., *,
    wait: bool = True,
) -> Answer: ...
    async def pose(self, z: float = ..., roll: float = ..., pitch: float = ..., *, wait: bool = True) -> Answer: ...
    async def mouth(self, open: float = ..., *, wait: bool = True) -> Answer: ...

@type_check_only
class SimulatedMicroduck(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(
    self, vx: float = ..., vy: float = ..., vyaw: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer:
        """Walk for duration seconds (default 1, at most 10), then stand. A zero stands at once."""
    def head(
    self, neck_pitch: float = ..., head_pitch: float = ..., head_yaw: float = ..., head_roll: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Turn the joints of the head."""
    def pose(self, z: float = ..., roll: float = ..., pitch: float = ..., *, wait: bool = True) -> Answer:
        """Shift and tilt the body on its feet."""
    def mouth(self, open: float = ..., *, wait: bool = True) -> Answer:
        """Open the mouth: 0 closed, 1 open."""

@type_check_only
class AsyncSimulatedMicroduck(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., vy: float = ..., vyaw: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def head(
    self, neck_pitch: float = ..., head_pitch: float = ..., head_yaw: float = ..., head_roll: float = ..., *,
    wait: bool = True,
) -> Answer: ...
    async def pose(self, z: float = ..., roll: float = ..., pitch: float = ..., *, wait: bool = True) -> Answer: ...
    async def mouth(self, open: float = ..., *, wait: bool = True) -> Answer: ...

@type_check_only
class RBY1(RealRobot):
    def reset_fault_control_manager(self) -> Answer:
        """Clear a fault of the control manager, once its cause is gone. Nothing moves before resume()."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncRBY1(AsyncRobot):
    async def reset_fault_control_manager(self) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedRBY1(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedRBY1(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class Reachy(RealRobot):
    def wake(self) -> Answer:
        """Wake up: the head rises and nods."""
    def sleep(self) -> Answer:
        """Go to sleep: the head sinks; torque stays on."""
    def express(self, move: str = "", dataset: str = ...) -> Answer:
        """Play a recorded move, an emotion or a dance, to its end."""
    def list_moves(self, dataset: str = ...) -> Answer:
        """List the recorded moves."""
    def motors(self, mode: str = "enabled") -> Answer:
        """Give the motors torque where they are, take it away (the head drops), or let them float."""
    def say(self, text: str = "") -> Answer:
        """Say a text by the speaker."""
    def play_sound(self, file: str = "") -> Answer:
        """Play a sound file of the robot's."""
    def volume(self) -> Answer:
        """Report the speaker's volume."""
    def set_volume(self, volume: int = 50) -> Answer:
        """Set the speaker's volume."""
    def track_face(self, enabled: bool = True, weight: float = 1.0) -> Answer:
        """Let the daemon turn the head after a face, or end that; a stop ends it, too."""
    def tracking_status(self) -> Answer:
        """Report the face that the daemon tracks."""
    def camera(self) -> Answer:
        """Report the camera, and the address at which it streams its pictures."""
    def record_audio(self, duration: float = 5.0) -> Answer:
        """Refused, because the daemon sends sound only over WebRTC."""
    def turn_to_sound(self) -> Answer:
        """Turn the head towards what is heard now."""
    def turn_to_sound_status(self) -> Answer:
        """Report where sound comes from."""
    def wake_up(self) -> Answer:
        """Wake up: the head rises and nods."""
    def goto_sleep(self) -> Answer:
        """Go to sleep: the head sinks; torque stays on."""
    def play_move(self, move: str = "", dataset: str = ...) -> Answer:
        """Play a recorded move, an emotion or a dance, to its end."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def get_state(self) -> Answer:
        """Measured positions and velocities."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def look(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer:
        """Turn and shift the head."""
    def look_at(
    self, look_x: float = ..., look_y: float = ..., look_z: float = ..., duration: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Turn the head towards a point."""
    def antennas(
    self, antenna_left: float = ..., antenna_right: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer:
        """Move the antennas."""
    def body_turn(self, body_yaw: float = ..., duration: float = ..., *, wait: bool = True) -> Answer:
        """Turn the body, at most 65 degrees away from the head."""
    def goto(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., body_yaw: float = ..., antenna_left: float = ...,
    antenna_right: float = ..., duration: float = ..., head: Any = ..., antennas: Sequence[float] = ..., *,
    wait: bool = True,
) -> Answer:
        """Move head, body and antennas together."""
    def home(self, duration: float = ..., *, wait: bool = True) -> Answer:
        """Head, body and antennas straight."""

@type_check_only
class AsyncReachy(AsyncRobot):
    async def wake(self) -> Answer: ...
    async def sleep(self) -> Answer: ...
    async def express(self, move: str = "", dataset: str = ...) -> Answer: ...
    async def list_moves(self, dataset: str = ...) -> Answer: ...
    async def motors(self, mode: str = "enabled") -> Answer: ...
    async def say(self, text: str = "") -> Answer: ...
    async def play_sound(self, file: str = "") -> Answer: ...
    async def volume(self) -> Answer: ...
    async def set_volume(self, volume: int = 50) -> Answer: ...
    async def track_face(self, enabled: bool = True, weight: float = 1.0) -> Answer: ...
    async def tracking_status(self) -> Answer: ...
    async def camera(self) -> Answer: ...
    async def record_audio(self, duration: float = 5.0) -> Answer: ...
    async def turn_to_sound(self) -> Answer: ...
    async def turn_to_sound_status(self) -> Answer: ...
    async def wake_up(self) -> Answer: ...
    async def goto_sleep(self) -> Answer: ...
    async def play_move(self, move: str = "", dataset: str = ...) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def get_state(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def look(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def look_at(
    self, look_x: float = ..., look_y: float = ..., look_z: float = ..., duration: float = ..., *,
    wait: bool = True,
) -> Answer: ...
    async def antennas(
    self, antenna_left: float = ..., antenna_right: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def body_turn(self, body_yaw: float = ..., duration: float = ..., *, wait: bool = True) -> Answer: ...
    async def goto(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., body_yaw: float = ..., antenna_left: float = ...,
    antenna_right: float = ..., duration: float = ..., head: Any = ..., antennas: Sequence[float] = ..., *,
    wait: bool = True,
) -> Answer: ...
    async def home(self, duration: float = ..., *, wait: bool = True) -> Answer: ...

@type_check_only
class SimulatedReachy(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def get_state(self) -> Answer:
        """Measured positions and velocities."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def look(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer:
        """Turn and shift the head."""
    def look_at(
    self, look_x: float = ..., look_y: float = ..., look_z: float = ..., duration: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Turn the head towards a point."""
    def antennas(
    self, antenna_left: float = ..., antenna_right: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer:
        """Move the antennas."""
    def body_turn(self, body_yaw: float = ..., duration: float = ..., *, wait: bool = True) -> Answer:
        """Turn the body, at most 65 degrees away from the head."""
    def goto(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., body_yaw: float = ..., antenna_left: float = ...,
    antenna_right: float = ..., duration: float = ..., head: Any = ..., antennas: Sequence[float] = ..., *,
    wait: bool = True,
) -> Answer:
        """Move head, body and antennas together."""
    def home(self, duration: float = ..., *, wait: bool = True) -> Answer:
        """Head, body and antennas straight."""

@type_check_only
class AsyncSimulatedReachy(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def get_state(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def look(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def look_at(
    self, look_x: float = ..., look_y: float = ..., look_z: float = ..., duration: float = ..., *,
    wait: bool = True,
) -> Answer: ...
    async def antennas(
    self, antenna_left: float = ..., antenna_right: float = ..., duration: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def body_turn(self, body_yaw: float = ..., duration: float = ..., *, wait: bool = True) -> Answer: ...
    async def goto(
    self, head_pitch: float = ..., head_roll: float = ..., head_yaw: float = ..., head_x: float = ...,
    head_y: float = ..., head_z: float = ..., body_yaw: float = ..., antenna_left: float = ...,
    antenna_right: float = ..., duration: float = ..., head: Any = ..., antennas: Sequence[float] = ..., *,
    wait: bool = True,
) -> Answer: ...
    async def home(self, duration: float = ..., *, wait: bool = True) -> Answer: ...

@type_check_only
class Robotiq(RealRobot):
    def open(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer:
        """Open the fingers all the way."""
    def close(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer:
        """Close the fingers, onto what is between them."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncRobotiq(AsyncRobot):
    async def open(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer: ...
    async def close(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedRobotiq(SimRobot):
    def open(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer:
        """Open the fingers all the way."""
    def close(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer:
        """Close the fingers, onto what is between them."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedRobotiq(AsyncSimulation):
    async def open(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer: ...
    async def close(self, speed: float = ..., force: float = ..., *, wait: bool = True) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class Spot(RealRobot):
    def stand(self) -> Answer:
        """Power the motors on and stand up."""
    def set_twist(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0) -> Answer:
        """Walk so fast for 0.6 s, m/s and rad/s of the body, then stand."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(
    self, vx: float = ..., vy: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer:
        """Walk for duration_s, then stand."""

@type_check_only
class AsyncSpot(AsyncRobot):
    async def stand(self) -> Answer: ...
    async def set_twist(self, vx: float = 0.0, vy: float = 0.0, wz: float = 0.0) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., vy: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer: ...

@type_check_only
class SimulatedSpot(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(
    self, vx: float = ..., vy: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer:
        """Walk for duration_s, then stand."""

@type_check_only
class AsyncSimulatedSpot(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., vy: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer: ...

@type_check_only
class Stretch(RealRobot):
    def set_twist(self, vx: float = 0.0, wz: float = 0.0, vy: float = 0.0) -> Answer:
        """Drive at vx (m/s, forward) and wz (rad/s, to the left) for 300 ms."""
    def set_soft_limits(self, joint: str = "", low: float = ..., high: float = ...) -> Answer:
        """From now on refuse goals of a joint outside low..high; never wider than its range."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(self, vx: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True) -> Answer:
        """Drive for duration_s, then stand."""

@type_check_only
class AsyncStretch(AsyncRobot):
    async def set_twist(self, vx: float = 0.0, wz: float = 0.0, vy: float = 0.0) -> Answer: ...
    async def set_soft_limits(self, joint: str = "", low: float = ..., high: float = ...) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer: ...

@type_check_only
class SimulatedStretch(SimRobot):
    def set_twist(self, vx: float = 0.0, wz: float = 0.0, vy: float = 0.0) -> Answer:
        """Drive at vx (m/s, forward) and wz (rad/s, to the left) for 300 ms."""
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def move(self, vx: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True) -> Answer:
        """Drive for duration_s, then stand."""

@type_check_only
class AsyncSimulatedStretch(AsyncSimulation):
    async def set_twist(self, vx: float = 0.0, wz: float = 0.0, vy: float = 0.0) -> Answer: ...
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def move(
    self, vx: float = ..., wz: float = ..., duration_s: float = ..., *, wait: bool = True,
) -> Answer: ...

@type_check_only
class UR(RealRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncUR(AsyncRobot):
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedUR(SimRobot):
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedUR(AsyncSimulation):
    async def status(self) -> Answer: ...

@type_check_only
class XArm(RealRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncXArm(AsyncRobot):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class SimulatedXArm(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""

@type_check_only
class AsyncSimulatedXArm(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...

@type_check_only
class YahboomM3Pro(RealRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def arm(
    self, arm1: float = ..., arm2: float = ..., arm3: float = ..., arm4: float = ..., arm5: float = ...,
    time_ms: float = ..., *, wait: bool = True,
) -> Answer:
        """Move the named joints of the arm."""
    def gripper(self, gripper: float = ..., time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Move the gripper: 0 is open, -1.54 closed."""
    def set_gripper(self, open: bool = ..., time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Open or close the gripper."""
    def set_arm_degrees(self, joints: Sequence[float] = ..., time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Move all six servos to angles in degrees."""
    def home(self, time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Move the arm to its home pose, the gripper open."""
    def move(
    self, linear_x: float = ..., linear_y: float = ..., angular_z: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Drive for duration_s, or for 0.3 s, then stand. A zero stops at once."""

@type_check_only
class AsyncYahboomM3Pro(AsyncRobot):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def arm(
    self, arm1: float = ..., arm2: float = ..., arm3: float = ..., arm4: float = ..., arm5: float = ...,
    time_ms: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def gripper(self, gripper: float = ..., time_ms: float = ..., *, wait: bool = True) -> Answer: ...
    async def set_gripper(self, open: bool = ..., time_ms: float = ..., *, wait: bool = True) -> Answer: ...
    async def set_arm_degrees(
    self, joints: Sequence[float] = ..., time_ms: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def home(self, time_ms: float = ..., *, wait: bool = True) -> Answer: ...
    async def move(
    self, linear_x: float = ..., linear_y: float = ..., angular_z: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer: ...

@type_check_only
class SimulatedYahboomM3Pro(SimRobot):
    def sensors(self) -> Answer:
        """Measured positions, sensors and faults."""
    def status(self) -> Answer:
        """Connection, state, last refusal."""
    def arm(
    self, arm1: float = ..., arm2: float = ..., arm3: float = ..., arm4: float = ..., arm5: float = ...,
    time_ms: float = ..., *, wait: bool = True,
) -> Answer:
        """Move the named joints of the arm."""
    def gripper(self, gripper: float = ..., time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Move the gripper: 0 is open, -1.54 closed."""
    def set_gripper(self, open: bool = ..., time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Open or close the gripper."""
    def set_arm_degrees(self, joints: Sequence[float] = ..., time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Move all six servos to angles in degrees."""
    def home(self, time_ms: float = ..., *, wait: bool = True) -> Answer:
        """Move the arm to its home pose, the gripper open."""
    def move(
    self, linear_x: float = ..., linear_y: float = ..., angular_z: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer:
        """Drive for duration_s, or for 0.3 s, then stand. A zero stops at once."""

@type_check_only
class AsyncSimulatedYahboomM3Pro(AsyncSimulation):
    async def sensors(self) -> Answer: ...
    async def status(self) -> Answer: ...
    async def arm(
    self, arm1: float = ..., arm2: float = ..., arm3: float = ..., arm4: float = ..., arm5: float = ...,
    time_ms: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def gripper(self, gripper: float = ..., time_ms: float = ..., *, wait: bool = True) -> Answer: ...
    async def set_gripper(self, open: bool = ..., time_ms: float = ..., *, wait: bool = True) -> Answer: ...
    async def set_arm_degrees(
    self, joints: Sequence[float] = ..., time_ms: float = ..., *, wait: bool = True,
) -> Answer: ...
    async def home(self, time_ms: float = ..., *, wait: bool = True) -> Answer: ...
    async def move(
    self, linear_x: float = ..., linear_y: float = ..., angular_z: float = ..., duration_s: float = ..., *,
    wait: bool = True,
) -> Answer: ...

# -- the factories

@overload
def Robot(
    name: BoosterName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, domain_id: int = 0,
    robot_name: str | None = None, cmd_type: Literal["parallel", "serial"] = "parallel",
    network_interface: str = "",
) -> Booster: ...
@overload
def Robot(
    name: CanMotorsName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
    adapter: Literal["slcan", "damiao", "robstride"] | None = None, baud: int = 921600,
    side: Literal["left", "right"] = "right", control_frequency: float = 250.0, gravity_compensation: bool = False,
    gains_in_actions: bool = False, on_exit: Literal["lower", "damp", "limp", "zero_torque"] | None = None,
    lower_s: float = 12.0, table: str | os.PathLike[str] | Mapping[str, Any] | None = None,
) -> CanMotors: ...
@overload
def Robot(
    name: CrazyflieName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, setpoint_hz: float = 20.0,
) -> Crazyflie: ...
@overload
def Robot(
    name: DynamixelName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin", "serial"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
    calibration: str | os.PathLike[str] | Mapping[str, Any] | None = None, baud: int | None = None,
    baud_rate: int | None = None, motor_ids: Sequence[int] | None = None, timeout: float | None = None,
    max_jump: float | None = None, max_relative_target: float | None = None, on_exit: str | None = None,
    rest: str | os.PathLike[str] | Mapping[str, float] | None = None, lower_s: float | None = None,
) -> Dynamixel: ...
@overload
def Robot(
    name: EarthRoverName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, timeout_s: float = 10.0,
    turn_sign: float = 1.0,
) -> EarthRover: ...
@overload
def Robot(
    name: FeetechName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin", "serial"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
    calibration: str | os.PathLike[str] | Mapping[str, Any] | None = None, baud: int | None = None,
    baud_rate: int | None = None, motor_ids: Sequence[int] | None = None, timeout: float | None = None,
    max_jump: float | None = None, max_relative_target: float | None = None, on_exit: str | None = None,
    rest: str | os.PathLike[str] | Mapping[str, float] | None = None, lower_s: float | None = None,
) -> Feetech: ...
@overload
def Robot(
    name: FrankaName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, speed_factor: float = 0.2,
    stream_rate_hz: float = 30.0, gripper: Literal["franka_hand"] | None = None, gripper_speed: float = 100.0,
    gripper_force: float = 100.0,
) -> Franka: ...
@overload
def Robot(
    name: G1Name, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, level: Literal["low", "sport"] = "low",
    on_exit: Literal["zero_torque", "damp"] = "zero_torque", battery_floor_pct: float = 15.0,
    domain: int | None = None, simulator: bool = False, network_interface: str = "", interface: str = "",
) -> G1: ...
@overload
def Robot(
    name: Go2Name, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, level: Literal["low", "sport"] = "low",
    on_exit: Literal["zero_torque", "damp"] = "zero_torque", battery_floor_pct: float = 15.0,
    domain: int | None = None, simulator: bool = False, network_interface: str = "", interface: str = "",
) -> Go2: ...
@overload
def Robot(
    name: KinovaName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, username: str = "admin",
    password: str = "admin", control_frequency: float = 40.0, gripper: Literal["robotiq_2f85"] | None = None,
) -> Kinova: ...
@overload
def Robot(
    name: KukaName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, fri_port: int = 30200,
    control_frequency: float = 50.0, connect_timeout: float = 5.0,
) -> Kuka: ...
@overload
def Robot(
    name: MicroduckName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, api_version: int = 31, timeout: float = 5.0,
    subscribe_hz: int | None = None,
) -> Microduck: ...
@overload
def Robot(
    name: RBY1Name, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 50.0,
    priority: int = 1, on_estop: Literal["stop", "power_off"] = "stop",
) -> RBY1: ...
@overload
def Robot(
    name: ReachyName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, api_port: int = 8000, media_port: int = 8443,
    tts_url: str | None = None,
) -> Reachy: ...
@overload
def Robot(
    name: RobotiqName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, unit_id: int = 9,
    stroke_mm: float | None = None, tcp_port: int | None = None, baud: int | None = None,
    baud_rate: int | None = None, speed: float = 1.0, force: float = 1.0, activate: bool = True,
) -> Robotiq: ...
@overload
def Robot(
    name: SpotName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 10.0,
    estop_timeout_s: float = 3.0, on_estop: Literal["settle", "cut"] = "settle",
) -> Spot: ...
@overload
def Robot(
    name: StretchName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin", "serial"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 15.0,
) -> Stretch: ...
@overload
def Robot(
    name: URName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 125.0,
    rtde_frequency: float | None = None, control: Literal["ur-rtde", "script"] | None = None,
    gripper: Literal["robotiq_2f85", "robotiq_2f85_v4"] | None = None, gripper_driven: bool = True,
    gripper_speed: float = 100.0, gripper_force: float = 100.0, gripper_activate: bool = True,
    model: str | None = None,
) -> UR: ...
@overload
def Robot(
    name: XArmName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 100.0,
    gripper: Literal["xarm_gripper", "xarm_vacuum"] | None = None, gripper_speed: float = 100.0,
) -> XArm: ...
@overload
def Robot(
    name: YahboomM3ProName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["rosbridge", "ros2", "twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, timeout_s: float = 5.0,
    joint_signs: Sequence[float] = ..., move_time_ms: int = 1500, humble: bool = False,
) -> YahboomM3Pro: ...
@overload
def Robot(
    name: LeRobotName, mode: Literal["real", "auto"], *, driver: Literal["auto", "lerobot"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: None = None, sim: SimRobot | None = None,
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, **fields: Any,
) -> RealRobot: ...
@overload
def Robot(
    name: str, mode: Literal["real", "auto"], *, driver: Literal["lerobot"],
    port: str | os.PathLike[str] | None = None, transport: None = None, sim: SimRobot | None = None,
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, **fields: Any,
) -> RealRobot: ...
@overload
def Robot(
    name: str, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands", "ros2"] = "auto",
    table: str | Mapping[str, Any], port: str | os.PathLike[str] | None = None, transport: None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, **fields: Any,
) -> RealRobot: ...
@overload
def Robot(
    name: str, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None,
    transport: Literal["twin", "serial", "ros2", "rosbridge"] | None = None, sim: SimRobot | None = None,
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
) -> RealRobot: ...
@overload
def Robot(
    name: BoosterName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedBooster: ...
@overload
def Robot(
    name: CanMotorsName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, side: Literal["left", "right"] = "right",
    table: str | os.PathLike[str] | Mapping[str, Any] | None = None,
) -> SimulatedCanMotors: ...
@overload
def Robot(
    name: CrazyflieName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedCrazyflie: ...
@overload
def Robot(
    name: DynamixelName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedDynamixel: ...
@overload
def Robot(
    name: EarthRoverName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedEarthRover: ...
@overload
def Robot(
    name: FeetechName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedFeetech: ...
@overload
def Robot(
    name: FrankaName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["franka_hand"] | None = None,
) -> SimulatedFranka: ...
@overload
def Robot(
    name: G1Name, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedG1: ...
@overload
def Robot(
    name: Go2Name, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedGo2: ...
@overload
def Robot(
    name: KinovaName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["robotiq_2f85"] | None = None,
) -> SimulatedKinova: ...
@overload
def Robot(
    name: KukaName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedKuka: ...
@overload
def Robot(
    name: MicroduckName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedMicroduck: ...
@overload
def Robot(
    name: RBY1Name, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedRBY1: ...
@overload
def Robot(
    name: ReachyName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedReachy: ...
@overload
def Robot(
    name: RobotiqName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedRobotiq: ...
@overload
def Robot(
    name: SpotName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedSpot: ...
@overload
def Robot(
    name: StretchName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimulatedStretch: ...
@overload
def Robot(
    name: URName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["robotiq_2f85", "robotiq_2f85_v4"] | None = None,
    gripper_driven: bool = True,
) -> SimulatedUR: ...
@overload
def Robot(
    name: XArmName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["xarm_gripper", "xarm_vacuum"] | None = None,
) -> SimulatedXArm: ...
@overload
def Robot(
    name: YahboomM3ProName, mode: Literal["sim"] = "sim", *,
    driver: Literal["auto", "strands", "lerobot"] = "auto", id: str | None = None, tool_name: str | None = None,
    peer_id: str | None = None, cameras: Mapping[str, Any] | None = None, data_config: Any = None,
    mesh: MeshConfig | bool | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, backend: Literal["mujoco", "newton", "isaac"] = "mujoco",
    urdf_path: str | os.PathLike[str] | None = None, position: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None, keyframe: str | int | None = None, gated: bool = True,
    onboard: str | os.PathLike[str] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
) -> SimulatedYahboomM3Pro: ...
@overload
def Robot(
    name: str, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> SimRobot: ...
@overload
def Robot(
    name: str, *, attach: Literal[True], arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
) -> RealRobot: ...

@overload
def open_robot(
    name: BoosterName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, domain_id: int = 0,
    robot_name: str | None = None, cmd_type: Literal["parallel", "serial"] = "parallel",
    network_interface: str = "",
) -> AbstractAsyncContextManager[AsyncBooster]: ...
@overload
def open_robot(
    name: CanMotorsName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
    adapter: Literal["slcan", "damiao", "robstride"] | None = None, baud: int = 921600,
    side: Literal["left", "right"] = "right", control_frequency: float = 250.0, gravity_compensation: bool = False,
    gains_in_actions: bool = False, on_exit: Literal["lower", "damp", "limp", "zero_torque"] | None = None,
    lower_s: float = 12.0, table: str | os.PathLike[str] | Mapping[str, Any] | None = None,
) -> AbstractAsyncContextManager[AsyncCanMotors]: ...
@overload
def open_robot(
    name: CrazyflieName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, setpoint_hz: float = 20.0,
) -> AbstractAsyncContextManager[AsyncCrazyflie]: ...
@overload
def open_robot(
    name: DynamixelName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin", "serial"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
    calibration: str | os.PathLike[str] | Mapping[str, Any] | None = None, baud: int | None = None,
    baud_rate: int | None = None, motor_ids: Sequence[int] | None = None, timeout: float | None = None,
    max_jump: float | None = None, max_relative_target: float | None = None, on_exit: str | None = None,
    rest: str | os.PathLike[str] | Mapping[str, float] | None = None, lower_s: float | None = None,
) -> AbstractAsyncContextManager[AsyncDynamixel]: ...
@overload
def open_robot(
    name: EarthRoverName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, timeout_s: float = 10.0,
    turn_sign: float = 1.0,
) -> AbstractAsyncContextManager[AsyncEarthRover]: ...
@overload
def open_robot(
    name: FeetechName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin", "serial"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
    calibration: str | os.PathLike[str] | Mapping[str, Any] | None = None, baud: int | None = None,
    baud_rate: int | None = None, motor_ids: Sequence[int] | None = None, timeout: float | None = None,
    max_jump: float | None = None, max_relative_target: float | None = None, on_exit: str | None = None,
    rest: str | os.PathLike[str] | Mapping[str, float] | None = None, lower_s: float | None = None,
) -> AbstractAsyncContextManager[AsyncFeetech]: ...
@overload
def open_robot(
    name: FrankaName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, speed_factor: float = 0.2,
    stream_rate_hz: float = 30.0, gripper: Literal["franka_hand"] | None = None, gripper_speed: float = 100.0,
    gripper_force: float = 100.0,
) -> AbstractAsyncContextManager[AsyncFranka]: ...
@overload
def open_robot(
    name: G1Name, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, level: Literal["low", "sport"] = "low",
    on_exit: Literal["zero_torque", "damp"] = "zero_torque", battery_floor_pct: float = 15.0,
    domain: int | None = None, simulator: bool = False, network_interface: str = "", interface: str = "",
) -> AbstractAsyncContextManager[AsyncG1]: ...
@overload
def open_robot(
    name: Go2Name, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, level: Literal["low", "sport"] = "low",
    on_exit: Literal["zero_torque", "damp"] = "zero_torque", battery_floor_pct: float = 15.0,
    domain: int | None = None, simulator: bool = False, network_interface: str = "", interface: str = "",
) -> AbstractAsyncContextManager[AsyncGo2]: ...
@overload
def open_robot(
    name: KinovaName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, username: str = "admin",
    password: str = "admin", control_frequency: float = 40.0, gripper: Literal["robotiq_2f85"] | None = None,
) -> AbstractAsyncContextManager[AsyncKinova]: ...
@overload
def open_robot(
    name: KukaName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, fri_port: int = 30200,
    control_frequency: float = 50.0, connect_timeout: float = 5.0,
) -> AbstractAsyncContextManager[AsyncKuka]: ...
@overload
def open_robot(
    name: MicroduckName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, api_version: int = 31, timeout: float = 5.0,
    subscribe_hz: int | None = None,
) -> AbstractAsyncContextManager[AsyncMicroduck]: ...
@overload
def open_robot(
    name: RBY1Name, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 50.0,
    priority: int = 1, on_estop: Literal["stop", "power_off"] = "stop",
) -> AbstractAsyncContextManager[AsyncRBY1]: ...
@overload
def open_robot(
    name: ReachyName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, api_port: int = 8000, media_port: int = 8443,
    tts_url: str | None = None,
) -> AbstractAsyncContextManager[AsyncReachy]: ...
@overload
def open_robot(
    name: RobotiqName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, unit_id: int = 9,
    stroke_mm: float | None = None, tcp_port: int | None = None, baud: int | None = None,
    baud_rate: int | None = None, speed: float = 1.0, force: float = 1.0, activate: bool = True,
) -> AbstractAsyncContextManager[AsyncRobotiq]: ...
@overload
def open_robot(
    name: SpotName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 10.0,
    estop_timeout_s: float = 3.0, on_estop: Literal["settle", "cut"] = "settle",
) -> AbstractAsyncContextManager[AsyncSpot]: ...
@overload
def open_robot(
    name: StretchName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin", "serial"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 15.0,
) -> AbstractAsyncContextManager[AsyncStretch]: ...
@overload
def open_robot(
    name: URName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 125.0,
    rtde_frequency: float | None = None, control: Literal["ur-rtde", "script"] | None = None,
    gripper: Literal["robotiq_2f85", "robotiq_2f85_v4"] | None = None, gripper_driven: bool = True,
    gripper_speed: float = 100.0, gripper_force: float = 100.0, gripper_activate: bool = True,
    model: str | None = None,
) -> AbstractAsyncContextManager[AsyncUR]: ...
@overload
def open_robot(
    name: XArmName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, control_frequency: float = 100.0,
    gripper: Literal["xarm_gripper", "xarm_vacuum"] | None = None, gripper_speed: float = 100.0,
) -> AbstractAsyncContextManager[AsyncXArm]: ...
@overload
def open_robot(
    name: YahboomM3ProName, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: Literal["rosbridge", "ros2", "twin"] | None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, timeout_s: float = 5.0,
    joint_signs: Sequence[float] = ..., move_time_ms: int = 1500, humble: bool = False,
) -> AbstractAsyncContextManager[AsyncYahboomM3Pro]: ...
@overload
def open_robot(
    name: LeRobotName, mode: Literal["real", "auto"], *, driver: Literal["auto", "lerobot"] = "auto",
    port: str | os.PathLike[str] | None = None, transport: None = None, sim: SimRobot | None = None,
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, **fields: Any,
) -> AbstractAsyncContextManager[AsyncRobot]: ...
@overload
def open_robot(
    name: str, mode: Literal["real", "auto"], *, driver: Literal["lerobot"],
    port: str | os.PathLike[str] | None = None, transport: None = None, sim: SimRobot | None = None,
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, **fields: Any,
) -> AbstractAsyncContextManager[AsyncRobot]: ...
@overload
def open_robot(
    name: str, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands", "ros2"] = "auto",
    table: str | Mapping[str, Any], port: str | os.PathLike[str] | None = None, transport: None = None,
    sim: SimRobot | None = None, id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0, **fields: Any,
) -> AbstractAsyncContextManager[AsyncRobot]: ...
@overload
def open_robot(
    name: str, mode: Literal["real", "auto"], *, driver: Literal["auto", "strands"] = "auto",
    port: str | os.PathLike[str] | None = None,
    transport: Literal["twin", "serial", "ros2", "rosbridge"] | None = None, sim: SimRobot | None = None,
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    require_drill: str | None = None, at: str | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncRobot]: ...
@overload
def open_robot(
    name: BoosterName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedBooster]: ...
@overload
def open_robot(
    name: CanMotorsName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, side: Literal["left", "right"] = "right",
    table: str | os.PathLike[str] | Mapping[str, Any] | None = None,
) -> AbstractAsyncContextManager[AsyncSimulatedCanMotors]: ...
@overload
def open_robot(
    name: CrazyflieName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedCrazyflie]: ...
@overload
def open_robot(
    name: DynamixelName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedDynamixel]: ...
@overload
def open_robot(
    name: EarthRoverName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedEarthRover]: ...
@overload
def open_robot(
    name: FeetechName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedFeetech]: ...
@overload
def open_robot(
    name: FrankaName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["franka_hand"] | None = None,
) -> AbstractAsyncContextManager[AsyncSimulatedFranka]: ...
@overload
def open_robot(
    name: G1Name, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedG1]: ...
@overload
def open_robot(
    name: Go2Name, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedGo2]: ...
@overload
def open_robot(
    name: KinovaName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["robotiq_2f85"] | None = None,
) -> AbstractAsyncContextManager[AsyncSimulatedKinova]: ...
@overload
def open_robot(
    name: KukaName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedKuka]: ...
@overload
def open_robot(
    name: MicroduckName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedMicroduck]: ...
@overload
def open_robot(
    name: RBY1Name, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedRBY1]: ...
@overload
def open_robot(
    name: ReachyName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedReachy]: ...
@overload
def open_robot(
    name: RobotiqName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedRobotiq]: ...
@overload
def open_robot(
    name: SpotName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedSpot]: ...
@overload
def open_robot(
    name: StretchName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedStretch]: ...
@overload
def open_robot(
    name: URName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["robotiq_2f85", "robotiq_2f85_v4"] | None = None,
    gripper_driven: bool = True,
) -> AbstractAsyncContextManager[AsyncSimulatedUR]: ...
@overload
def open_robot(
    name: XArmName, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0, gripper: Literal["xarm_gripper", "xarm_vacuum"] | None = None,
) -> AbstractAsyncContextManager[AsyncSimulatedXArm]: ...
@overload
def open_robot(
    name: YahboomM3ProName, mode: Literal["sim"] = "sim", *,
    driver: Literal["auto", "strands", "lerobot"] = "auto", id: str | None = None, tool_name: str | None = None,
    peer_id: str | None = None, cameras: Mapping[str, Any] | None = None, data_config: Any = None,
    mesh: MeshConfig | bool | None = None, lifetime: float | None = None,
    policy_limits: Mapping[str, Any] | None = None, backend: Literal["mujoco", "newton", "isaac"] = "mujoco",
    urdf_path: str | os.PathLike[str] | None = None, position: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None, keyframe: str | int | None = None, gated: bool = True,
    onboard: str | os.PathLike[str] | None = None, arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulatedYahboomM3Pro]: ...
@overload
def open_robot(
    name: str, mode: Literal["sim"] = "sim", *, driver: Literal["auto", "strands", "lerobot"] = "auto",
    id: str | None = None, tool_name: str | None = None, peer_id: str | None = None,
    cameras: Mapping[str, Any] | None = None, data_config: Any = None, mesh: MeshConfig | bool | None = None,
    lifetime: float | None = None, policy_limits: Mapping[str, Any] | None = None,
    backend: Literal["mujoco", "newton", "isaac"] = "mujoco", urdf_path: str | os.PathLike[str] | None = None,
    position: Sequence[float] | None = None, orientation: Sequence[float] | None = None,
    keyframe: str | int | None = None, gated: bool = True, onboard: str | os.PathLike[str] | None = None,
    arm: bool = True, approve: Approve | None = None, guarded: tuple[str, ...] = ...,
    approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncSimulation]: ...
@overload
def open_robot(
    name: str, *, attach: Literal[True], arm: bool = True, approve: Approve | None = None,
    guarded: tuple[str, ...] = ..., approve_within_s: float = 30.0,
) -> AbstractAsyncContextManager[AsyncRobot]: ...
