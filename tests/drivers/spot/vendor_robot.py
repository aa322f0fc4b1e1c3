"""Connect the vendor's unmodified client to a twin, for the scenes of ``vendor_client.py``."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import bosdyn.client
from bosdyn.client import frame_helpers
from bosdyn.client.estop import EstopEndpoint, EstopKeepAlive
from bosdyn.client.lease import LeaseKeepAlive
from bosdyn.client.robot_command import RobotCommandBuilder


def failure(step: Callable[[], Any]) -> str:
    """Return the class of the error that a step raises; empty for no error."""
    try:
        step()
    except Exception as error:  # any of the vendor's errors
        return type(error).__name__
    return ""


def connected(port: str) -> Any:
    """Return the vendor's object of the robot, without a login."""
    address, _, certificate = port.partition("?ca=")
    host, _, number = address.rpartition(":")
    sdk = bosdyn.client.create_standard_sdk("vendor", cert_resource_glob=certificate)
    robot = sdk.create_robot(host)
    robot.update_secure_channel_port(int(number))
    return robot


class Powered:
    """A robot with power, and the clients of its services."""

    def __init__(self, robot: Any) -> None:
        self.robot = robot
        self.commands = robot.ensure_client("robot-command")
        self.states = robot.ensure_client("robot-state")

    def command(self, command: Any, seconds: float = 5.0) -> int:
        number: int = self.commands.robot_command(command, end_time_secs=time.time() + seconds)
        return number

    def walk(self, vx: float, vy: float = 0.0, wz: float = 0.0, seconds: float = 0.6, **how: Any) -> int:
        return self.command(RobotCommandBuilder.synchro_velocity_command(vx, vy, wz, **how), seconds)

    def feedback(self, number: int) -> Any:
        return self.commands.robot_command_feedback(number).feedback.synchronized_feedback

    @property
    def state(self) -> Any:
        return self.states.get_robot_state()

    @property
    def frames(self) -> Any:
        return self.state.kinematic_state.transforms_snapshot

    @property
    def body(self) -> Any:
        """The pose of the body in the frame of odometry."""
        return frame_helpers.get_odom_tform_body(self.frames)

    @property
    def joints(self) -> dict[str, float]:
        return {joint.name: joint.position.value for joint in self.state.kinematic_state.joint_states}


@contextmanager
def powered(port: str) -> Iterator[Powered]:
    """Log in, take lease and e-stop, and power the motors on."""
    robot = connected(port)
    robot.authenticate("twin", "twin")
    robot.time_sync.wait_for_sync(8)
    leases = robot.ensure_client("lease")
    leases.acquire("body")
    with LeaseKeepAlive(leases, must_acquire=False, return_at_exit=False):
        endpoint = EstopEndpoint(robot.ensure_client("estop"), "vendor", 5.0)
        endpoint.force_simple_setup()
        with EstopKeepAlive(endpoint):
            robot.power_on(timeout_sec=10)
            yield Powered(robot)


def feet_in_odom(spot: Powered) -> list[tuple[float, float, float]]:
    state = spot.state
    body = frame_helpers.get_odom_tform_body(state.kinematic_state.transforms_snapshot)
    feet = [foot.foot_position_rt_body for foot in state.foot_state]
    return [body.transform_point(foot.x, foot.y, foot.z) for foot in feet]
