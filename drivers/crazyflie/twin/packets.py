"""The packets of the radio protocol (CRTP) that the simulated firmware models, by port and channel."""

from __future__ import annotations

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.crazyflie.protocol import HighLevel, Port, Setpoint

ENOENT, EIO, ENOEXEC, EEXIST, E2BIG = 2, 5, 8, 17, 7
"""Error numbers of the firmware: not there, input or output, no such command, there already, too long."""


def key_of(port: int, channel: int) -> str:
    """Return the name of a port and its channel in the table: ``3.0``."""
    return f"{port}.{channel}"


PACKETS: Modelled[str] = Modelled(
    "packets, by port.channel",
    {
        key_of(Port.PARAMETERS, 0): "returns the table of parameters",
        key_of(Port.PARAMETERS, 1): "returns the value of a parameter; error 2 for an unknown one",
        key_of(Port.PARAMETERS, 2): "stores the value of a parameter; error 2 for an unknown one",
        key_of(Port.RPYT, 0): "levels out; angles and thrust are not modelled",
        key_of(Port.MEMORY, 0): "returns that there is no memory",
        key_of(Port.MEMORY, 1): "error 5: there is no memory",
        key_of(Port.MEMORY, 2): "error 5: there is no memory",
        key_of(Port.LOG, 0): "returns the table of variables",
        key_of(Port.LOG, 1): "creates, starts, stops or deletes a block; error 8 for other commands",
        key_of(Port.LOCALIZATION, 1): "3: emergency stop; silence for other packets",
        key_of(Port.SETPOINT, 0): "stop, hover or velocity; silence for other setpoints",
        key_of(Port.SETPOINT, 1): "lets the high-level commander fly",
        key_of(Port.HIGH_LEVEL, 0): "takes off, lands or stops; error 8 for other orders",
        key_of(Port.SUPERVISOR, 0): "12: returns the supervisor's flags",
        key_of(Port.SUPERVISOR, 1): "arms, disarms, recovers from a crash, or stops in an emergency",
        key_of(Port.PLATFORM, 1): "0 returns the version of the protocol, 1 of the firmware",
        key_of(Port.LINK, 0): "returns the packet",
        key_of(Port.LINK, 1): "returns the name of the link",
        key_of(Port.LINK, 3): "returns an empty packet",
    },
    "silence, as of a firmware without a reader for that port and channel",
)

SETPOINTS: Modelled[int] = Modelled(
    "setpoints",
    {
        Setpoint.STOP: "switches the motors off",
        Setpoint.VELOCITY_WORLD: "flies with a velocity in the frame of the world",
        Setpoint.HOVER: "flies at a height with a velocity in the frame of the drone",
    },
    "silence, and the present setpoint stays",
)

ORDERS: Modelled[int] = Modelled(
    "orders to the high-level commander",
    {
        HighLevel.STOP: "switches the motors off",
        HighLevel.TAKEOFF: "takes off in a time",
        HighLevel.LAND: "lands in a time",
        HighLevel.LAND_WITH_VELOCITY: "lands with a mean speed",
    },
    "error 8, no such order",
)

MODELLED = (PACKETS, SETPOINTS, ORDERS)
