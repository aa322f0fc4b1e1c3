"""A gripper on the flange of a simulated arm: its links in the arm's model, and its fingers in the arm's physics.

The driver of the arm names these functions as text, since no driver imports another one. The force in a command is
not simulated: the fingers always press with ``GRIP_NM`` at most. A gripper that the driver of the arm drives is an
axis of the arm's body, too (``GrippingBody``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.drivers.common.physics.body import Commander, Felt
from strands_actors.drivers.common.physics.controlled_body import ControlledBody
from strands_actors.drivers.common.physics.fingers import FingerJoints
from strands_actors.drivers.common.physics.fingers import motorise as motorise_fingers
from strands_actors.drivers.common.physics.jointed import Jointed
from strands_actors.drivers.common.twin import Handler, answering

from .body import CLOSED_RAD, GripperBody
from .mechanism import Setup
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

    @property
    def is_still(self) -> bool:
        return abs(float(self._physics.data.joint(MOTOR).qvel[0])) < STILL_RAD_S

    def is_blocked(self, goal: float) -> bool:
        """Return True if something keeps the fingers from closing further, with the motor at ``goal``."""
        return self.is_still and goal - self.position > BLOCKED_COUNTS

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
            URCAP_PORT: answering(lambda: UrcapSession(self._twin, safe_state="")),
        }

    @property
    def body(self) -> GripperBody:
        """The fingers for a simulation, as of a gripper without an arm."""
        return self._twin.body

    def pass_time(self) -> None:
        """Move the motor, up to the present time."""
        self._twin.gripper.pass_time()
        self.follow()

    def follow(self) -> None:
        """Let the fingers follow the motor."""
        self._fingers.follow(self._twin.gripper.goal)


class GrippingBody:
    """The body of an arm with its gripper, the last axis: the fraction by which it is closed."""

    def __init__(self, arm: ControlledBody, mounted: MountedGripper) -> None:
        self._arm, self._mounted, self._hand = arm, mounted, mounted.body
        self.axes = (*arm.axes, *self._hand.axes)
        self.spec = arm.spec
        self.scenery = arm.scenery
        self.pass_time = arm.pass_time

    @property
    def commanders(self) -> Sequence[Commander]:
        return (*self._arm.commanders, *self._hand.commanders)

    def felt(self) -> Felt:
        arm, hand = self._arm.felt(), self._hand.felt()
        return arm._replace(
            position=(*arm.position, *hand.position),
            velocity=(*arm.velocity, *hand.velocity),
            effort=(*arm.effort, *hand.effort),
            commanders=self.commanders,
        )

    def pose(self) -> Sequence[float]:
        return self._arm.pose()

    def energise(self, on: bool) -> None:
        self._arm.energise(on)
        self._hand.energise(on)

    def set_targets(self, values: Sequence[float]) -> None:
        self._arm.set_targets(values[:-1])
        self._hand.set_targets(values[-1:])

    def hold(self) -> None:
        self._arm.hold()
        self._hand.hold()

    def step(self, steps: int) -> None:
        # The motor and the physics take turns, so that the fingers lag behind the motor as they do in real time.
        for _ in range(steps):
            self._hand.step(1)
            self._mounted.follow()
            self._arm.step(1)

    def reset(self) -> None:
        self._arm.reset()
        self._hand.reset()
        self._mounted.follow()


__all__ = ["LINK", "GrippingBody", "MountedGripper", "motorise", "tool_m", "with_gripper"]
