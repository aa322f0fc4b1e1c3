"""Simulate the topic ``rt/arm_sdk`` of a humanoid: commands for its arms while its own controller balances.

A message is a LowCmd. The q of one motor slot that no motor has is the weight, 0 to 1: the share of the message in
the commands of the arms and the waist. Slots and joints are those of the vendor's examples:

    robot   weight    joints                                example (unitree_sdk2, unitree_sdk2_python)
    G1      slot 29   waist 12 to 14, arms 15 to 28         g1_arm7_sdk_dds_example
    H1      slot 9    torso 6, arms 12 to 19                h1_arm_sdk_dds_example
    H1-2    slot 27   torso 12, arms 13 to 26               h1_2_arm_sdk_dds_example

These examples set neither the checksum nor ``mode_machine`` nor the motors' modes, so none of them is checked. Both
commands are mixed in proportion to the weight [assumed]. If the messages end, the last one stays in force (as users
report, the weight stays where it was). Users also report that the topic has no effect while the robot sits or
stands with locked joints. In such states its last message is forgotten [assumed]. A joint whose torque and gains
are all 0 in a message stays with the controller [assumed: users command only the arms, and the waist does not go
limp].

This module has no clock and no physics.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.unitree.protocol import COMMAND_BYTES
from strands_actors.drivers.unitree.robots import Model

TOPIC = "rt/arm_sdk"
OCCUPIED_S = 1.0
"""For so long after a message with a weight the topic counts as occupied [assumed]."""

Rows = Sequence[Sequence[float]]
"""Rows of q, dq, tau, kp and kd, each in the order of the robot's joints."""

_MOTOR = struct.Struct("<5f")
_LAYOUT = {"hg": (4, 28), "go": (24, 36)}
"""Family of frames -> offset of the first motor's q in a LowCmd, and the distance between two motors, in bytes."""


class Slots(NamedTuple):
    weight: int
    joints: frozenset[int]


SLOTS = {
    "unitree_g1": Slots(29, frozenset(range(12, 29))),
    "unitree_h1": Slots(9, frozenset((6, *range(12, 20)))),
    "unitree_h1_2": Slots(27, frozenset(range(12, 27))),
}


class ArmSdk:
    """The commands for the arms that are mixed into those of the onboard controller."""

    def __init__(self, model: Model) -> None:
        """Make one without a command. ``model`` must be a robot of ``SLOTS``."""
        slots = SLOTS[model.name]
        self._offset, self._stride = _LAYOUT[model.family]
        self._bytes = COMMAND_BYTES[model.family]
        self._weight_slot = slots.weight
        self._slots = model.slots
        self._count = len(model.slots)
        self.joints = tuple(index for index, slot in enumerate(model.slots) if slot in slots.joints)
        """Indices of the joints that this topic commands."""
        self.weight = 0.0
        self._rows: Rows = ()
        self._mixed = self.joints
        self._taken_s = -math.inf

    def take(self, body: bytes, now_s: float) -> None:
        """Put a received message in force.

        Raises:
            MalformedFrame: It has another length, or a number is not finite. Nothing changes.
        """
        if len(body) != self._bytes:
            raise MalformedFrame(f"a LowCmd has {self._bytes} bytes, not {len(body)}")
        weight = self._motor(body, self._weight_slot)[0]
        columns = [self._motor(body, slot) for slot in self._slots]
        if not all(map(math.isfinite, (weight, *(value for column in columns for value in column)))):
            raise MalformedFrame("a LowCmd with a number that is not finite")
        commanded = tuple(index for index in self.joints if any(columns[index][2:]))
        self.set(weight if commanded else 0.0, list(zip(*columns, strict=True)), commanded)
        if self.weight:
            self._taken_s = now_s

    def _motor(self, body: bytes, slot: int) -> tuple[float, ...]:
        return _MOTOR.unpack_from(body, self._offset + slot * self._stride)

    def set(self, weight: float, rows: Rows, joints: tuple[int, ...] = ()) -> None:
        """Put a command in force, for these joints or, without ``joints``, for all of this topic.

        A weight outside of 0 to 1 is clamped [assumed].
        """
        self.weight, self._rows, self._mixed = min(1.0, max(0.0, weight)), rows, joints or self.joints

    def release(self) -> None:
        """Forget the command: the onboard controller alone commands the arms."""
        self.weight, self._taken_s = 0.0, -math.inf

    def is_occupied(self, now_s: float) -> bool:
        """Return True if a client has sent a message with a weight within the last ``OCCUPIED_S``."""
        return now_s - self._taken_s <= OCCUPIED_S

    @property
    def commanded(self) -> tuple[int, ...]:
        """Indices of the joints that the command in force moves."""
        return self._mixed if self.weight else ()

    def mixed_into(self, own: Rows) -> Rows:
        """Return the commands of the onboard controller, with those for the arms mixed in."""
        if not self.weight:
            return own
        mixed = [list(row) for row in own]
        for row, arms in zip(mixed, self._rows, strict=True):
            for index in self.commanded:
                row[index] += self.weight * (arms[index] - row[index])
        return mixed
