"""Drive an arm over a network interface, with its twin at the other end: all of it in one process.

``python -m tests.drivers.can_motors.on_interface vcan0`` does so on an interface of the kernel.
"""

from __future__ import annotations

import sys

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.drivers.can_motors.driver import CanMotors
from strands_actors.drivers.can_motors.robots import arm_of
from strands_actors.drivers.can_motors.stop_channel import CanStopChannel
from strands_actors.drivers.can_motors.twin import CanRobot, CanServer
from strands_actors.drivers.can_motors.twin.can_line import CanLine
from strands_actors.drivers.can_motors.wire import CanWire
from strands_actors.drivers.common.twin import WireLog
from strands_actors.kernel.clock import MonotonicClock
from tests.drivers.common.memory_port import Permission


async def drive(interface: str) -> tuple[str, tuple[MotorReport, ...], tuple[MotorReport, ...]]:
    """Open, arm and stop an arm, by its wire and then by its stop channel.

    Returns:
        The format of the bus, and the reports of both stops.
    """
    options = CanMotors.resolve("yam", {})
    driver = CanMotors("yam", interface, options)
    robot = CanRobot(arm_of("yam", options["table"]), options["table"])
    server = CanServer(robot, [CanLine(interface)], WireLog(None), socketcan=True)
    clock = MonotonicClock()
    async with trio.open_nursery() as nursery:
        server.plug()
        nursery.start_soon(server.serve)
        wire = CanWire(driver.config, clock)
        facts = await wire.open()
        await wire.arm(Permission())
        by_wire = await wire.make_safe(SafeState.DAMP)
        await wire.arm(Permission())
        channel = CanStopChannel(driver.config, (), clock)
        by_root = await channel.make_safe(SafeState.DAMP)
        channel.close()
        wire.close()
        nursery.cancel_scope.cancel()
    server.close()
    return facts["adapters"][0], by_wire, by_root


if __name__ == "__main__":
    adapter, *stops = trio.run(drive, sys.argv[1])
    assert adapter == "socketcan"
    assert all(report.safe for stop in stops for report in stop), stops
