"""Test what all twins share: faults of the robot and of its joints, restarts, and the network of a robot that is
off."""

from __future__ import annotations

import pytest
import trio

from strands_actors.drivers.common.twin import Connection, Fault, TcpServer, TwinRobot, WireLog


class Arm(TwinRobot):
    PARTS = range(2, 5)
    TICK_S = 0.001
    RESTART_CUTS = True

    def __init__(self) -> None:
        super().__init__()
        self.jammed: set[int] = set()
        self.restarts = 0
        self.ticked = trio.Event()
        self.begun: list[Fault] = []

    def begin_fault(self, fault: Fault) -> None:
        self.begun.append(fault)

    def jam(self, index: int, on: bool) -> None:
        (self.jammed.add if on else self.jammed.discard)(index)

    def power_cycle(self) -> None:
        self.restarts += 1

    def tick(self) -> None:
        self.ticked.set()


async def serve(connection: Connection) -> None:
    while True:
        await connection.receive()


def test_a_joint_can_get_stuck_and_only_that() -> None:
    arm = Arm()
    arm.set_fault(Fault.STUCK, 4)
    assert arm.jammed == {2} and not arm.begun
    arm.set_fault(Fault.OK, 4)
    assert not arm.jammed
    for fault, unit in ((Fault.OFF, 2), (Fault.STUCK, 5)):
        with pytest.raises(ValueError, match=rf"fault {fault}:{unit}: this robot has joints 2 to 4"):
            arm.set_fault(fault, unit)


def test_the_network_of_a_robot_without_power_is_down_until_the_fault_ends() -> None:
    async def test() -> None:
        arm = Arm()
        server = TcpServer(arm, {0: serve}, WireLog(None))
        host, _, port = server.address.rpartition(":")
        server.plug()
        async with trio.open_nursery() as nursery:
            nursery.start_soon(server.serve)
            stream = await trio.open_tcp_stream(host, int(port))
            server.set_fault("off")
            assert arm.restarts == 1 and arm.is_off
            with pytest.raises(trio.BrokenResourceError):
                await stream.receive_some(1)
            await stream.aclose()
            server.power_cycle()
            with pytest.raises(OSError):
                await trio.open_tcp_stream(host, int(port))
            server.set_fault("ok")
            await (await trio.open_tcp_stream(host, int(port))).aclose()
            await arm.ticked.wait()
            nursery.cancel_scope.cancel()
        server.close()

    trio.run(test)
