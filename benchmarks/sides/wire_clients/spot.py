"""The client for a Spot: Boston Dynamics' bosdyn-client. It sends the keepalives of its lease and its e-stop."""

from __future__ import annotations

import time

import bosdyn.client
from bosdyn.client.estop import EstopEndpoint, EstopKeepAlive
from bosdyn.client.lease import LeaseKeepAlive
from bosdyn.client.robot_command import RobotCommandBuilder, blocking_stand

from .hand import BaseClient, wave

SPEED_M_S = 0.3
LIVES_S = 0.6


class Client(BaseClient):
    def __init__(self, robot: str, port: str) -> None:
        address, _, certificate = port.partition("?ca=")
        host, _, number = address.rpartition(":")
        sdk = bosdyn.client.create_standard_sdk("benchmark", cert_resource_glob=certificate)
        self._spot = sdk.create_robot(host)
        self._spot.update_secure_channel_port(int(number))
        self._spot.authenticate("user", "password")
        self._spot.time_sync.wait_for_sync(8)
        leases, estops = self._spot.ensure_client("lease"), self._spot.ensure_client("estop")
        leases.take("body")
        self._keep_lease = LeaseKeepAlive(leases, must_acquire=False, return_at_exit=False)
        endpoint = EstopEndpoint(estops, "benchmark", 9.0)
        endpoint.force_simple_setup()
        self._keep_estop = EstopKeepAlive(endpoint)
        time.sleep(0.5)
        self._spot.power_on(timeout_sec=10)
        self._commands = self._spot.ensure_client("robot-command")
        blocking_stand(self._commands, timeout_sec=10)

    def setpoint(self, number: int) -> int:
        began_ns = time.monotonic_ns()
        walk = RobotCommandBuilder.synchro_velocity_command(SPEED_M_S * wave(number), 0, 0)
        self._commands.robot_command(walk, end_time_secs=time.time() + LIVES_S)
        return began_ns

    def stop(self) -> None:
        self._commands.robot_command(RobotCommandBuilder.stop_command())

    def close(self) -> None:
        self._spot.power_off(cut_immediately=True, timeout_sec=10)
        self._keep_estop.shutdown()
        self._keep_lease.shutdown()
