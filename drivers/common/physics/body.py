"""The body of a simulated robot: the interface that a simulation uses to move it and to read it.

A joint can be moved by commands in the robot's real protocol (the "wire"), or by the simulation. The commands have
priority: a servo with torque, or an arm with a running program, follows them. The simulation can move only the
other joints.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

TIMESTEP_S = 0.002
"""Time step of the physics of every twin, in seconds."""


class Commander(enum.IntEnum):
    """The controller of a joint: commands in the robot's protocol, or the simulation.

    The simulation controls a joint from ``energise`` until it is stopped, or until a command in the robot's
    protocol energises the joint. It does not get the joint back automatically, because its old target would become
    active again.
    """

    # Neither commands nor the simulation control the joint.
    NONE = 0
    # The robot's simulated electronics control the joint, on commands in the robot's protocol.
    WIRE = 1
    # The simulation controls the joint.
    SIM = 2


class Felt(NamedTuple):
    """Position, velocity and effort of each axis of a simulated body at one time, in radians or metres. ``effort``
    is in Nm or N. The last three are the position, the orientation and the angular velocity (in its own frame) of a
    base that moves freely. They are empty for any other robot."""

    time_s: float
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]
    commanders: Sequence[Commander]
    base_xyz_m: Sequence[float] = ()
    orientation_wxyz: Sequence[float] = ()
    gyro_rad_s: Sequence[float] = ()


class Body(Protocol):
    """A simulated body. Its time advances only in ``pass_time`` and ``step``, and no method waits. A joint that
    commands in the robot's protocol have energised follows these commands only."""

    @property
    def axes(self) -> tuple[str, ...]: ...
    @property
    def spec(self) -> Any:
        """The model of the body, an ``mujoco.MjSpec`` that was compiled."""
        ...

    @property
    def commanders(self) -> Sequence[Commander]:
        """The controller of each axis: commands in the robot's protocol, or the simulation."""
        ...

    def pass_time(self) -> None: ...
    def felt(self) -> Felt: ...
    def pose(self) -> Sequence[float]:
        """Return the state ``qpos`` of the body's MuJoCo model."""
        ...

    def energise(self, on: bool) -> None:
        """Energise the free joints (those that no robot command has energised) at their positions. With
        ``on=False`` release the joints that the simulation controls."""
        ...

    def set_targets(self, values: Sequence[float]) -> None:
        """Set the targets of the joints that the simulation controls: one value per axis. A body with the attribute
        ``target_rows`` takes that many rows of values."""
        ...

    def hold(self) -> None:
        """Hold the joints that the simulation controls at their positions."""
        ...

    def step(self, steps: int) -> None:
        """Advance the simulation by ``steps`` time steps (``TIMESTEP_S`` each) at once."""
        ...

    def reset(self) -> None:
        """Return to the initial state."""
        ...


@runtime_checkable
class Flying(Protocol):
    """A flying robot: its body falls when its motors are switched off."""

    def land(self) -> None:
        """Descend to the floor and switch the motors off there."""
        ...


def body_of(twin: object) -> Body:
    """Return the body of a simulated robot. Raise ``ValueError`` if it has no body."""
    body: Body | None = getattr(twin, "body", None)
    if body is None:
        raise ValueError("this robot has no simulated body, so it cannot be used as a simulation")
    return body
