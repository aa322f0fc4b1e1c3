"""dynamixel-sdk: switch the torque of one servo on, write a goal, read until it is there."""

import sys
import time

from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION = 64, 116, 132
SERVO, BY, NEAR = 1, 300, 10

port, packets = PortHandler(sys.argv[1]), PacketHandler(2.0)
assert port.openPort() and port.setBaudRate(1_000_000)


def check(result: int, error: int) -> None:
    assert result == COMM_SUCCESS, packets.getTxRxResult(result)
    assert error == 0, packets.getRxPacketError(error)


def position() -> int:
    value, result, error = packets.read4ByteTxRx(port, SERVO, PRESENT_POSITION)
    check(result, error)
    return int(value)


check(*packets.write1ByteTxRx(port, SERVO, TORQUE_ENABLE, 1))
goal = position() + BY
check(*packets.write4ByteTxRx(port, SERVO, GOAL_POSITION, goal))
deadline = time.monotonic() + 20
while abs(position() - goal) > NEAR:
    assert time.monotonic() < deadline, f"at {position()}, sent to {goal}"
print("there:", position())
port.closePort()
