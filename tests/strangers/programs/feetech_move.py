"""feetech-servo-sdk: switch the torque of one servo on, write a goal, read until it is there."""

import sys
import time

from scservo_sdk import COMM_SUCCESS, PacketHandler, PortHandler

TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION = 40, 42, 56
SERVO, BY, NEAR = 1, 300, 30

port, packets = PortHandler(sys.argv[1]), PacketHandler(0)
assert port.openPort() and port.setBaudRate(1_000_000)


def position() -> int:
    value, result, error = packets.read2ByteTxRx(port, SERVO, PRESENT_POSITION)
    assert (result, error) == (COMM_SUCCESS, 0), packets.getTxRxResult(result)
    return int(value)


assert packets.write1ByteTxRx(port, SERVO, TORQUE_ENABLE, 1) == (COMM_SUCCESS, 0)
goal = position() + BY
assert packets.write2ByteTxRx(port, SERVO, GOAL_POSITION, goal) == (COMM_SUCCESS, 0)
deadline = time.monotonic() + 20
while abs(position() - goal) > NEAR:
    assert time.monotonic() < deadline, f"at {position()}, sent to {goal}"
print("there:", position())
