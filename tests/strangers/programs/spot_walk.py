"""bosdyn-client: log in, power on, stand, walk forwards, sit and power off, as the vendor's first tutorial."""

import sys
import time

import bosdyn.client
from bosdyn.client.estop import EstopClient, EstopEndpoint, EstopKeepAlive
from bosdyn.client.lease import LeaseClient, LeaseKeepAlive
from bosdyn.client.robot_command import RobotCommandBuilder, RobotCommandClient, blocking_sit, blocking_stand

host, port, certificate, user, password = sys.argv[1:6]
sdk = bosdyn.client.create_standard_sdk("strangers", cert_resource_glob=certificate)
robot = sdk.create_robot(host)
robot.update_secure_channel_port(int(port))
robot.authenticate(user, password)
robot.time_sync.wait_for_sync()
endpoint = EstopEndpoint(robot.ensure_client(EstopClient.default_service_name), "strangers", 9.0)
endpoint.force_simple_setup()
with (
    EstopKeepAlive(endpoint),
    LeaseKeepAlive(robot.ensure_client(LeaseClient.default_service_name), must_acquire=True, return_at_exit=True),
):
    robot.power_on(timeout_sec=20)
    assert robot.is_powered_on()
    commands = robot.ensure_client(RobotCommandClient.default_service_name)
    blocking_stand(commands, timeout_sec=20)
    walk = RobotCommandBuilder.synchro_velocity_command(v_x=0.5, v_y=0.0, v_rot=0.0)
    for _ in range(4):
        commands.robot_command(walk, end_time_secs=time.time() + 0.6)
        time.sleep(0.5)
    time.sleep(0.5)
    blocking_sit(commands, timeout_sec=20)
    robot.power_off(cut_immediately=False, timeout_sec=20)
    assert not robot.is_powered_on()
print("walked")
