"""pyrobotiqgripper: activate the gripper, close it half, and open it."""

import sys

from pyrobotiqgripper import RobotiqGripper

host, port = sys.argv[1:3]
gripper = RobotiqGripper(connection_type="RTU_VIA_TCP", tcp_host=host, tcp_port=int(port))
gripper.connect()
gripper.activate()
assert gripper.isActivated()
gripper.close()
closed = gripper.position()
gripper.move(128)
assert abs(gripper.position() - 128) < 5 < closed - 128, (closed, gripper.position())
print("there:", gripper.position())
gripper.disconnect()
