"""A gripper on the flange of a simulated arm: its links in the arm's model, and its fingers in the arm's physics.

The driver of the arm names these functions as text, since no driver imports another one. The force in a command is
not simulated: the fingers always press with ``GRIP_NM`` at most.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.drivers.common.physics.fingers import FingerJoints
from strands_actors.drivers.common.physics.fingers import motorise as motorise_fingers
from strands_actors.drivers.common.physics.jointed import Jointed
from strands_actors.drivers.common.twin import Handler, answering

from .body import CLOSED_RAD
from .mechanism import Gripper, Setup
from .protocol import TOP
from .robots import TABLES, UNIT
from .sessions import TcpSession
from .unit import RobotiqTwin
from .urcap import PORT as URCAP_PORT
from .urcap import UrcapSession

LINK = "gripper_base"
"""The name of the gripper's base in the model of an arm, where ``base`` is the base of the arm."""

MODBUS_PORT = 502

MOTOR = "right_driver_joint"
FOLLOWERS = ("left_driver_joint", "right_follower_joint", "left_follower_joint")
"""The joints that the mechanics turn by the same angle as the motor's joint."""

GRIP_NM = 8.0
"""Torque of the motor's joint. At the finger tips it is a force of 150 N [assumed]; the 2F-85 has 20 to 235 N."""
STIFFNESS_NM_RAD, DAMPING_NM_S_RAD = 60.0, 4.0
INERTIA_KG_M2 = 0.01
"""Gains of the motor, and the reflected inertia of each joint [assumed]."""
JOINTS = FingerJoints(
    MOTOR,
    FOLLOWERS,
    open=0.0,
    closed=CLOSED_RAD,
    effort=GRIP_NM,
    stiffness=STIFFNESS_NM_RAD,
    damping=DAMPING_NM_S_RAD,
    inertia=INERTIA_KG_M2,
)
BLOCKED_COUNTS, STILL_RAD_S = 12.0, 0.02
"""The fingers press an object if they are so far behind the motor, and slower than this."""


def with_gripper(table: Mapping[str, Any], flange: str, gripper: str) -> dict[str, Any]:
    """Return the table of an arm with the links of a gripper on its flange.

    Args:
        table: The table of the arm, with ``model_rows`` and ``looks``.
        flange: The link of the arm that carries the gripper.
        gripper: The name of the gripper.
    """
    own = TABLES.table(gripper)
    base = own["base"]
    rows = f"{LINK} {flange} - - {base['xyz']} 0 - - - {base['kg']} - {base['geom']}\n{own['model_rows']}"
    return {
        **table,
        "model_rows": f"{table['model_rows']}\n{_on_link(rows, 1)}",
        "looks": f"{table['looks']}\n{_on_link(own['looks'], 0)}",
    }


def tool_m(gripper: str) -> tuple[float, float, float]:
    """Return the point between the finger tips of a gripper, in the frame of its link."""
    x, y, z = TABLES.table(gripper)["tool_m"]
    return x, y, z


def _on_link(rows: str, column: int) -> str:
    """Return rows in which the gripper's own base, in this column, has the name ``LINK``."""
    lines = (line.split() for line in rows.splitlines() if line.strip())
    return "\n".join(
        " ".join(LINK if number == column and word == "base" else word for number, word in enumerate(words))
        for words in lines
    )


def motorise(spec: Any) -> None:
    """Give the fingers in the model of an arm their motor, and the mechanics that couple them."""
    motorise_fingers(spec, JOINTS)


class PhysicalFingers:
    """The fingers of a gripper in the physics of an arm. Positions are in register counts."""

    def __init__(self, physics: Jointed) -> None:
        self._physics = physics

    @property
    def position(self) -> float:
        return float(self._physics.data.joint(MOTOR).qpos[0]) / CLOSED_RAD * TOP

    def is_blocked(self, goal: float) -> bool:
        """Return True if something keeps the fingers from closing further, with the motor at ``goal``."""
        is_still = abs(float(self._physics.data.joint(MOTOR).qvel[0])) < STILL_RAD_S
        return is_still and goal - self.position > BLOCKED_COUNTS

    def follow(self, goal: float) -> None:
        self._physics.data.actuator(MOTOR).ctrl[0] = goal / TOP * CLOSED_RAD


class MountedGripper:
    """A gripper on a simulated arm, with its Modbus gateway and the text port of its URCap.

    Args:
        gripper: The name of the gripper.
        physics: The arm, whose model has the gripper (``with_gripper``, ``motorise``).
    """

    def __init__(self, gripper: str, physics: Jointed) -> None:
        table = TABLES.table(gripper)
        self._fingers = PhysicalFingers(physics)
        self._twin = RobotiqTwin(Setup.from_table(table), UNIT, table, fingers=self._fingers)

    @property
    def handlers(self) -> dict[int, Handler]:
        """Return the functions that serve the gripper's ports, by port."""
        return {
            MODBUS_PORT: answering(lambda: TcpSession(self._twin)),
            URCAP_PORT: answering(lambda: UrcapSession(self._twin)),
        }

    def pass_time(self) -> None:
        """Move the motor, up to the present time."""
        gripper: Gripper = self._twin.gripper
        gripper.pass_time()
        self._fingers.follow(gripper.goal)


__all__ = ["LINK", "MountedGripper", "motorise", "tool_m", "with_gripper"]
