"""Run the vendor's unmodified client against the twin: ``python -m tests.drivers.spot.vendor_client PORT``. It
prints the result of each step as one JSON object."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import bosdyn.client
from bosdyn.client.estop import EstopEndpoint, EstopKeepAlive
from bosdyn.client.lease import LeaseKeepAlive
from bosdyn.client.robot_command import RobotCommandBuilder, block_until_arm_arrives, blocking_sit, blocking_stand


def failure(step: Callable[[], Any]) -> str:
    """Return the class of the error that a step raises; empty for no error."""
    try:
        step()
    except Exception as error:  # any of the vendor's errors
        return type(error).__name__
    return ""


def main(port: str) -> dict[str, Any]:
    address, _, certificate = port.partition("?ca=")
    host, _, number = address.rpartition(":")
    sdk = bosdyn.client.create_standard_sdk("vendor", cert_resource_glob=certificate)
    robot = sdk.create_robot(host)
    robot.update_secure_channel_port(int(number))
    reported: dict[str, Any] = {"serial": robot.get_id().serial_number}
    reported["bad_login"] = failure(lambda: robot.authenticate("user", "wrong"))
    robot.authenticate("user", "password")
    robot.time_sync.wait_for_sync(8)
    reported["skew_s"] = robot.time_sync.endpoint.clock_skew.ToNanoseconds() / 1e9
    leases, estops = robot.ensure_client("lease"), robot.ensure_client("estop")
    reported["lease"] = leases.acquire("body").lease_proto.resource
    reported["second_lease"] = failure(lambda: leases.acquire("body"))
    keep_lease = LeaseKeepAlive(leases, must_acquire=False, return_at_exit=False)
    reported["power_without_estop"] = failure(lambda: robot.power_on(timeout_sec=5))
    endpoint = EstopEndpoint(estops, "vendor", 3.0)
    endpoint.force_simple_setup()
    keep_estop = EstopKeepAlive(endpoint)
    time.sleep(0.5)
    reported["level"] = int(estops.get_status().stop_level)
    robot.power_on(timeout_sec=10)
    commands, states = robot.ensure_client("robot-command"), robot.ensure_client("robot-state")
    blocking_stand(commands, timeout_sec=10)
    walk = RobotCommandBuilder.synchro_velocity_command(0.5, 0, 0)
    began_x = position(states)
    commands.robot_command(walk, end_time_secs=time.time() + 0.6)
    time.sleep(1.0)
    reported["walked_m"] = position(states) - began_x
    reported["late"] = failure(lambda: commands.robot_command(walk, end_time_secs=time.time() - 1))
    reported["far"] = failure(lambda: commands.robot_command(walk, end_time_secs=time.time() + 700))
    arm = commands.robot_command(RobotCommandBuilder.arm_joint_command(0.1, -1.0, 1.5, 0.0, 0.2, 0.0))
    reported["arrived"] = block_until_arm_arrives(commands, arm, 10)
    joints = {joint.name: joint.position.value for joint in states.get_robot_state().kinematic_state.joint_states}
    reported["joints"] = {name: round(joints[name], 3) for name in ("arm0.sh0", "arm0.sh1", "arm0.el0", "arm0.wr0")}
    reported["has_arm"] = robot.has_arm()
    reported["stow"] = failure(lambda: commands.robot_command(RobotCommandBuilder.arm_stow_command()))
    pose = RobotCommandBuilder.arm_pose_command(0.8, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0, "body")
    reported["pose"] = failure(lambda: commands.robot_command(pose))
    there = RobotCommandBuilder.synchro_se2_trajectory_point_command(1.0, 0.0, 0.0, "odom")
    reported["trajectory"] = failure(lambda: commands.robot_command(there, end_time_secs=time.time() + 5))
    reported["legs"] = sum(name[:2] in ("fl", "fr", "hl", "hr") for name in joints)
    blocking_sit(commands, timeout_sec=10)
    blocking_stand(commands, timeout_sec=10)
    keep_estop.shutdown()
    time.sleep(4.5)
    reported["motors_after_silence"] = int(states.get_robot_state().power_state.motor_power_state)
    reported["after_the_cut"] = failure(lambda: commands.robot_command(walk, end_time_secs=time.time() + 0.6))
    keep_lease.shutdown()
    return reported


def position(states: Any) -> float:
    snapshot = states.get_robot_state().kinematic_state.transforms_snapshot
    return -float(snapshot.child_to_parent_edge_map["odom"].parent_tform_child.position.x)


if __name__ == "__main__":
    print(json.dumps(main(sys.argv[1])), flush=True)
    os._exit(0)  # the vendor's threads would keep the process
