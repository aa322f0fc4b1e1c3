"""Open a gripper's TCP connection or serial port, as its settings require."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.modbus import ModbusClient
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.drivers.common.ports.tcp_port import ByteStream
from strands_actors.kernel.clock import Clock

from .client import GripperClient
from .config import RobotiqConfig
from .serial_client import SerialGripper
from .tcp_client import TcpGripper

OpenStream = Callable[[str, int], Awaitable[ByteStream]]
OpenPort = Callable[[str, int], BytePort]


async def open_gripper(
    config: RobotiqConfig, clock: Clock, open_stream: OpenStream, open_port: OpenPort = open_serial
) -> GripperClient:
    """Connect by TCP, or open the serial port. Return a client for the gripper. Raise ``WireDown``."""
    if config.serial:
        return SerialGripper(open_port(config.port, config.baud), config, clock)
    try:
        host, port = config.address()
    except ValueError as error:
        raise WireDown(str(error)) from None
    stream = await open_stream(host, port)
    return TcpGripper(ModbusClient(stream, config.unit_id, f"{config.robot} at {host}:{port}", clock))
