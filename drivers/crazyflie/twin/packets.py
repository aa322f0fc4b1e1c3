"""The packets of the radio protocol (CRTP) that the simulated firmware models, by port and channel."""

from __future__ import annotations

from typing import NamedTuple

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.crazyflie.protocol import HighLevel, Port, Setpoint, encode

EPERM, ENOENT, EIO, E2BIG, ENOEXEC, ENOMEM, EACCES, EBUSY, EEXIST, EINVAL = 1, 2, 5, 7, 8, 12, 13, 16, 17, 22
"""Error numbers of the firmware: not permitted, not there, input or output, too long, no such command, no memory
left, read-only, busy, there already, invalid."""


class Reaction(NamedTuple):
    """The effect of a packet: its kind for the packet log, the answers, and the safe state that it causes."""

    kind: str
    replies: tuple[bytes, ...] = ()
    safe_state: str | None = None


def answer(port: int, channel: int, data: bytes, kind: str = "read") -> Reaction:
    """Return the reaction that only answers."""
    return Reaction(kind, (encode(port, channel, data),))


def key_of(port: int, channel: int) -> str:
    """Return the name of a port and its channel in the table: ``3.0``."""
    return f"{port}.{channel}"


PACKETS: Modelled[str] = Modelled(
    "packets, by port.channel",
    {
        key_of(Port.PARAMETERS, 0): "returns the table of parameters",
        key_of(Port.PARAMETERS, 1): "returns the value of a parameter; error 2 for an unknown one",
        key_of(Port.PARAMETERS, 2): "stores the value of a parameter; error 2 for an unknown one",
        key_of(Port.PARAMETERS, 3): "a command of the table of parameter commands",
        key_of(Port.RPYT, 0): "flies with roll, pitch, yaw rate and thrust; locked until a setpoint without thrust",
        key_of(Port.MEMORY, 0): "returns the number of memories, and describes each",
        key_of(Port.MEMORY, 1): "returns bytes of a memory; error 5 outside of it",
        key_of(Port.MEMORY, 2): "stores bytes in a memory; error 5 outside of it",
        key_of(Port.LOG, 0): "returns the table of variables",
        key_of(Port.LOG, 1): "creates, extends, starts, stops or deletes a block; error 8 for other commands",
        key_of(Port.LOCALIZATION, 0): "moves the estimate to a position that was measured from outside",
        key_of(Port.LOCALIZATION, 1): "a packet of the table of localization; silence for others",
        key_of(Port.LOCALIZATION, 2): "as 6.0 for up to four drones, by the last byte of the radio's address",
        key_of(Port.SETPOINT, 0): "a setpoint of the table of setpoints; silence for others",
        key_of(Port.SETPOINT, 1): "0: lets the high-level commander fly; silence for others",
        key_of(Port.HIGH_LEVEL, 0): "an order of the table of orders; error 8 for others",
        key_of(Port.SUPERVISOR, 0): "1 to 12: returns one of the supervisor's flags, or all",
        key_of(
            Port.SUPERVISOR, 1
        ): "arms, disarms, recovers from a crash, stops in an emergency or starts a watchdog",
        key_of(Port.PLATFORM, 0): "1 arms or disarms, 2 recovers from a crash; silence for others",
        key_of(Port.PLATFORM, 1): "0 returns the version of the protocol, 1 of the firmware, 2 the type of drone",
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
        Setpoint.OLD_VELOCITY_WORLD: "as 8, with the opposite yaw rate",
        Setpoint.OLD_Z_DISTANCE: "as 9, with the opposite yaw rate",
        Setpoint.ALTITUDE_HOLD: "flies with roll, pitch, yaw rate and climb speed",
        Setpoint.OLD_HOVER: "as 10, with the opposite yaw rate",
        Setpoint.FULL_STATE: "flies to a place with a speed and a yaw; accelerations and rates do not count",
        Setpoint.POSITION: "flies to a place with a yaw",
        Setpoint.VELOCITY_WORLD: "flies with a velocity in the frame of the world",
        Setpoint.Z_DISTANCE: "flies at a height with roll, pitch and yaw rate",
        Setpoint.HOVER: "flies at a height with a velocity in the frame of the drone",
        Setpoint.MANUAL: "flies with roll, pitch, yaw rate and thrust, but not with rates of roll and pitch",
    },
    "silence, and the present setpoint stays",
)

ORDERS: Modelled[int] = Modelled(
    "orders to the high-level commander",
    {
        HighLevel.SET_GROUP_MASK: "sets the groups to which the drone belongs",
        HighLevel.OLD_TAKEOFF: "as 7, turning to yaw 0",
        HighLevel.OLD_LAND: "as 8, turning to yaw 0",
        HighLevel.STOP: "switches the motors off",
        HighLevel.GO_TO: "flies to a place in a time",
        HighLevel.START_TRAJECTORY: "flies a trajectory of the memory; 0 without an effect for an undefined one",
        HighLevel.DEFINE_TRAJECTORY: "defines where a trajectory stands in the memory",
        HighLevel.TAKEOFF: "takes off in a time",
        HighLevel.LAND: "lands in a time",
        HighLevel.TAKEOFF_WITH_VELOCITY: "takes off with a mean speed",
        HighLevel.LAND_WITH_VELOCITY: "lands with a mean speed",
        HighLevel.SPIRAL: "flies an arc with a changing radius",
        HighLevel.GO_TO_2: "flies to a place in a time, in a straight line if wanted",
        HighLevel.START_TRAJECTORY_2: "flies a trajectory, turned to the present yaw if wanted",
    },
    "error 8, no such order",
)

EMERGENCY_STOP, KEEP_ALIVE, EXTERNAL_POSE, EXTERNAL_POSES = 3, 4, 8, 9
"""Packets of localization: the first byte of the data on ``Port.LOCALIZATION``, channel 1."""

LOCALIZATIONS: Modelled[int] = Modelled(
    "packets of localization",
    {
        EMERGENCY_STOP: "stops in an emergency, and locks the drone",
        KEEP_ALIVE: "starts a watchdog that stops in an emergency after 1 s without this packet",
        EXTERNAL_POSE: "moves the estimate to a pose that was measured from outside",
        EXTERNAL_POSES: "the same for up to two drones, by the last byte of the radio's address",
    },
    "silence",
)
