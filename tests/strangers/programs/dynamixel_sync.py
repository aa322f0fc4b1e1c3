"""dynamixel-sdk: write the goals of two servos in one packet, and read both in one packet."""

import sys
import time

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

TORQUE_ENABLE, GOAL_POSITION, PRESENT_POSITION, SIZE = 64, 116, 132, 4
SERVOS, BY, NEAR = (1, 4), -200, 10

port, packets = PortHandler(sys.argv[1]), PacketHandler(2.0)
assert port.openPort() and port.setBaudRate(1_000_000)
reader = GroupSyncRead(port, packets, PRESENT_POSITION, SIZE)
writer = GroupSyncWrite(port, packets, GOAL_POSITION, SIZE)
for servo in SERVOS:
    assert reader.addParam(servo)
    assert packets.write1ByteTxRx(port, servo, TORQUE_ENABLE, 1) == (COMM_SUCCESS, 0)


def positions() -> list[int]:
    assert reader.txRxPacket() == COMM_SUCCESS
    assert all(reader.isAvailable(servo, PRESENT_POSITION, SIZE) for servo in SERVOS)
    return [reader.getData(servo, PRESENT_POSITION, SIZE) for servo in SERVOS]


goals = [value + BY for value in positions()]
for servo, goal in zip(SERVOS, goals, strict=True):
    assert writer.addParam(servo, goal.to_bytes(SIZE, "little"))
assert writer.txPacket() == COMM_SUCCESS
deadline = time.monotonic() + 20
while any(abs(here - goal) > NEAR for here, goal in zip(positions(), goals, strict=True)):
    assert time.monotonic() < deadline, f"at {positions()}, sent to {goals}"
print("there:", positions())
