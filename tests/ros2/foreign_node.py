"""A robot on a ROS 2 graph that this project did not build: two joints and a base, on zenoh-ros2-sdk and rosbags.

Run as ``python -m tests.ros2.foreign_node PORT LOG HASHES``. PORT is that of a router on this computer. Each
command that it gets is a JSON line in LOG, with the time of CLOCK_MONOTONIC. HASHES is JSON with the hashes of the
services ``send_goal`` and ``cancel_goal``, which rosbags does not know. It behaves as ros2_control does: a new goal
replaces the present one, a cancel holds, and a base without twists stops after ``TIMEOUT_S``.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceServer, ROS2Subscriber, ZenohSession

JOINTS = ("shoulder", "elbow")
ACTION = "/arm_controller/follow_joint_trajectory"
TIMEOUT_S = 0.5
PERIOD_S = 0.02

STORE = get_typestore(Stores.ROS2_JAZZY)
TOLERANCES = {
    "control_msgs/msg/JointTolerance": "string name\nfloat64 position\nfloat64 velocity\nfloat64 acceleration",
    "control_msgs/msg/JointComponentTolerance": (
        "string joint_name\nuint16 component\nfloat64 position\nfloat64 velocity\nfloat64 acceleration"
    ),
}
GOAL = """
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
control_msgs/JointTolerance[] path_tolerance
control_msgs/JointComponentTolerance[] component_path_tolerance
control_msgs/JointTolerance[] goal_tolerance
control_msgs/JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
"""


class Robot:
    """The state of the robot, which the threads of the SDK change."""

    def __init__(self, log: str) -> None:
        self.lock = threading.Lock()
        self._log = open(log, "a", buffering=1)  # noqa: SIM115  # open as long as the process runs
        self.twist = (0.0, 0.0)
        self.twist_s = 0.0
        self.x_m = 0.0
        self.positions = [0.0, 0.0]
        self.begin, self.begin_s = [0.0, 0.0], 0.0
        self.goal: list[float] | None = None
        self.goal_s = 0.0

    def note(self, what: str, values: list[float]) -> None:
        self._log.write(json.dumps({"t_ns": time.monotonic_ns(), "what": what, "values": values}) + "\n")

    def on_twist(self, message: Any) -> None:
        with self.lock:
            self.twist, self.twist_s = (message.linear.x, message.angular.z), time.monotonic()
            self.note("twist", list(self.twist))

    def on_goal(self, request: Any) -> Any:
        with self.lock:
            trajectory = request.goal.trajectory
            point = trajectory.points[-1]
            rows = dict(zip(trajectory.joint_names, point.positions, strict=True))
            self.goal = [float(rows[joint]) for joint in JOINTS]
            self.goal_s = point.time_from_start.sec + point.time_from_start.nanosec / 1e9
            self.begin, self.begin_s = list(self.positions), time.monotonic()
            self.note("goal", [*self.goal, self.goal_s])
        types = ZenohSession.get_instance().store.types
        response = types["control_msgs/srv/msg/FollowJointTrajectory_SendGoal_Response"]
        return response(accepted=True, stamp=types["builtin_interfaces/msg/Time"](0, 0))

    def on_cancel(self, request: Any) -> Any:
        with self.lock:
            self.goal = None
            self.note("cancel", [])
        types = ZenohSession.get_instance().store.types
        return types["action_msgs/srv/msg/CancelGoal_Response"](return_code=0, goals_canceling=[])

    def step(self) -> None:
        with self.lock:
            now_s = time.monotonic()
            if now_s - self.twist_s > TIMEOUT_S:
                self.twist = (0.0, 0.0)
            self.x_m += self.twist[0] * PERIOD_S
            if self.goal is not None:
                part = min(1.0, (now_s - self.begin_s) / max(self.goal_s, 1e-6))
                pairs = zip(self.begin, self.goal, strict=True)
                self.positions = [begin + part * (goal - begin) for begin, goal in pairs]


def main(port: int, log: str, hashes: dict[str, str]) -> None:
    robot = Robot(log)
    session = ZenohSession.get_instance("127.0.0.1", port)
    # The SDK would load definitions from the network.
    known = {
        name: definition for name, definition in STORE.fielddefs.items() if name not in session.store.fielddefs
    }
    session.store.register(known)
    for name, text in TOLERANCES.items():
        session.store.register(get_types_from_msg(text, name))
    session.store.register(get_types_from_msg(GOAL, "control_msgs/msg/FollowJointTrajectoryGoal"))
    session._registered_types.update({name: name for name in session.store.fielddefs})
    types = session.store.types

    def publisher(topic: str, name: str) -> Any:
        return ROS2Publisher(
            topic, name, "", "foreign", type_hash=STORE.hash_rihs01(name), domain_id=0, router_port=port
        )

    joint_states, odom = (
        publisher("/joint_states", "sensor_msgs/msg/JointState"),
        publisher("/odom", "nav_msgs/msg/Odometry"),
    )
    twist = "geometry_msgs/msg/Twist"
    keep: list[Any] = [
        ROS2Subscriber(
            "/cmd_vel",
            twist,
            robot.on_twist,
            "",
            "foreign",
            type_hash=STORE.hash_rihs01(twist),
            domain_id=0,
            router_port=port,
        ),
        ROS2ServiceServer(
            f"{ACTION}/_action/send_goal",
            "control_msgs/action/FollowJointTrajectory_SendGoal",
            robot.on_goal,
            "unique_identifier_msgs/UUID goal_id\ncontrol_msgs/FollowJointTrajectoryGoal goal",
            "bool accepted\nbuiltin_interfaces/Time stamp",
            "foreign",
            type_hash=hashes["send_goal"],
            domain_id=0,
            router_port=port,
        ),
        ROS2ServiceServer(
            f"{ACTION}/_action/cancel_goal",
            "action_msgs/srv/CancelGoal",
            robot.on_cancel,
            "action_msgs/GoalInfo goal_info",
            "int8 return_code\naction_msgs/GoalInfo[] goals_canceling",
            "foreign",
            type_hash=hashes["cancel_goal"],
            domain_id=0,
            router_port=port,
        ),
    ]
    print("ready", flush=True)
    empty = np.empty(0)
    nothing = np.zeros(36)
    while keep:
        robot.step()
        now_ns = time.time_ns()
        stamp = types["builtin_interfaces/msg/Time"](now_ns // 10**9, now_ns % 10**9)
        header = types["std_msgs/msg/Header"](stamp, "odom")
        vector, point = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Point"]
        joint_states.publish(
            header=header, name=list(JOINTS), position=np.array(robot.positions), velocity=empty, effort=empty
        )
        pose = types["geometry_msgs/msg/Pose"](
            point(robot.x_m, 0.0, 0.0), types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        )
        speed = types[twist](vector(robot.twist[0], 0.0, 0.0), vector(0.0, 0.0, robot.twist[1]))
        odom.publish(
            header=header,
            child_frame_id="base",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, nothing),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](speed, nothing),
        )
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], json.loads(sys.argv[3]))
