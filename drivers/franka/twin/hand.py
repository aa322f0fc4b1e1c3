"""Simulate a Franka Hand: what its service does with a request. No sockets and no clock: the owner gives the time.

It carries out one request at a time, and refuses another one meanwhile [assumed]. A grasp closes the fingers until
they meet something, and then presses with its force. A stop ends the running request, and also the force of a grasp
that has ended [assumed: the vendor does not say so].
"""

from __future__ import annotations

import math
from typing import NamedTuple

from strands_actors.drivers.common.physics.fingers import FingerJoints, PhysicalFingers, motorise
from strands_actors.drivers.common.physics.hand_motion import HandMotion
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.twin import Connection
from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.franka import hand_protocol as p
from strands_actors.drivers.franka.arms import Arm
from strands_actors.drivers.franka.grippers import FASTEST_M_S, FINGERS, STRONGEST_N, TRAVEL_M, WIDTH_M, table_of
from strands_actors.drivers.franka.hand_protocol import Command, Status

from .plant import Plant

JOINTS = FingerJoints(
    motor=FINGERS[0],
    followers=FINGERS[1:],
    open=TRAVEL_M,
    closed=0.0,
    effort=STRONGEST_N,
    stiffness=4000.0,
    damping=120.0,
    inertia=0.3,
)
"""The force is the vendor's. Gains and inertia are [assumed]."""

TEMPERATURE_C = 30
STILL_PER_S = 0.02
"""Fingers that are slower than this share of their travel have arrived. They lag behind their motor."""
REQUESTS: Modelled[int] = Modelled(
    "requests to the hand",
    {
        Command.CONNECT: "compares the versions, and sends states to the client's UDP port from then on",
        Command.HOMING: "closes and opens the fingers, and sets the largest width",
        Command.GRASP: "closes the fingers until they meet something, and presses",
        Command.MOVE: "moves the fingers to a width",
        Command.STOP: "ends the running request, and the force of a grasp",
    },
    "an unknown number closes the connection; a second request while one runs fails",
)


class Ended(NamedTuple):
    """A request that has ended, for its reply."""

    client: Connection
    command: Command
    number: int
    status: Status


class _Running(NamedTuple):
    client: Connection
    command: Command
    number: int
    least_m: float  # A grasp succeeds above this width,
    most_m: float  # and below this one.


class Hand:
    """The hand of one arm.

    Args:
        motion: The motion of its fingers.
    """

    def __init__(self, motion: HandMotion) -> None:
        self.motion = motion
        self.is_lost = False  # True while the service neither answers nor sends states.
        self.ended: list[Ended] = []  # requests that have ended since the owner looked
        self._ms = 0.0
        self._before = motion.closed
        self.wake_up()

    def wake_up(self) -> None:
        """Reset to the state after a boot. The fingers stay where they are."""
        self.most_m = WIDTH_M
        self._running: _Running | None = None
        self._is_grasped = False
        self._speed_per_s = FASTEST_M_S / WIDTH_M
        self._ms = 0.0
        self.motion.halt()

    @property
    def width_m(self) -> float:
        return (1.0 - self.motion.closed) * WIDTH_M

    def state(self) -> bytes:
        return p.HandState(round(self._ms), self.width_m, self.most_m, self.is_grasped, TEMPERATURE_C).pack()

    @property
    def is_grasped(self) -> bool:
        return self._is_grasped and self.motion.holds

    def begin(self, client: Connection, command: Command, number: int, payload: bytes) -> Status | None:
        """Begin a motion. Return the status of a request that was refused; None if its reply comes later."""
        if self._running is not None:
            return Status.FAIL
        least_m, most_m = 0.0, WIDTH_M
        match command:
            case Command.HOMING if not payload:
                self.most_m = 0.0
                self._move(1.0, FASTEST_M_S)
            case Command.MOVE if len(payload) == p.MOVE.size:
                width_m, speed_m_s = p.MOVE.unpack(payload)
                if not (0.0 <= width_m <= self.most_m and 0.0 < speed_m_s < math.inf):
                    return Status.FAIL
                self._move(1.0 - width_m / WIDTH_M, speed_m_s)
            case Command.GRASP if len(payload) == p.GRASP.size:
                width_m, inner_m, outer_m, speed_m_s, force_n = p.GRASP.unpack(payload)
                within = 0.0 <= width_m <= self.most_m and 0.0 <= inner_m < math.inf and 0.0 <= outer_m < math.inf
                if not (within and 0.0 < speed_m_s < math.inf and 0.0 < force_n < math.inf):
                    return Status.FAIL
                least_m, most_m = width_m - inner_m, width_m + outer_m
                self._move(1.0, speed_m_s, min(1.0, force_n / STRONGEST_N))
            case _:
                return Status.FAIL
        self._running = _Running(client, command, number, least_m, most_m)
        return None

    def stop(self) -> None:
        """End the running request, or else the force of the last grasp."""
        running, self._running = self._running, None
        if running is not None:
            self.ended.append(Ended(running.client, running.command, running.number, Status.ABORTED))
            self.motion.halt()
        elif self.motion.holds:
            self.motion.move_to(self.motion.motor, 0.0)
        self._is_grasped = False

    def _move(self, goal: float, speed_m_s: float, force: float = 1.0) -> None:
        self._is_grasped = False
        self._speed_per_s = min(speed_m_s, FASTEST_M_S) / WIDTH_M
        self.motion.move_to(goal, force)

    def advance(self, seconds: float) -> None:
        """Move the fingers for so long, and end the request that has arrived."""
        self._ms += seconds * 1e3
        self.motion.advance(seconds, self._speed_per_s)
        before, self._before = self._before, self.motion.closed
        running = self._running
        if running is None or self.motion.moves or abs(self._before - before) > STILL_PER_S * seconds:
            return
        match running.command:
            case Command.HOMING if self.motion.holds:
                status = Status.UNSUCCESSFUL  # Something is between the fingers.
            case Command.HOMING if self.motion.goal > 0.5:
                self._move(0.0, FASTEST_M_S)
                return
            case Command.HOMING:
                self.most_m, status = WIDTH_M, Status.SUCCESS
            case Command.GRASP:
                self._is_grasped = running.least_m < self.width_m < running.most_m
                status = Status.SUCCESS if self._is_grasped else Status.UNSUCCESSFUL
            case _:
                status = Status.UNSUCCESSFUL if self.motion.holds else Status.SUCCESS
        self._running = None
        self.ended.append(Ended(running.client, running.command, running.number, status))


def plant_with_hand(arm: Arm, gripper: str) -> Plant:
    """Return the simulated arm with its hand."""
    table = table_of(arm, gripper)
    spec = build(table)
    motorise(spec, JOINTS)
    return Plant(spec, [joint["key"] for joint in table["joints"]], float(table["bandwidth"]), table["home_rad"])


def hand_of(plant: Plant) -> Hand:
    """Return the hand in the physics of an arm from ``plant_with_hand``."""
    return Hand(HandMotion(PhysicalFingers(plant, JOINTS)))
