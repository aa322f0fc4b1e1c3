"""The body of a simulated robot, as its twin offers it to the simulation control.

The wire and the simulation share one body. A joint that is energised on the wire follows the wire: a servo with
torque, an arm with a running program. The simulation holds the other joints.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

TIMESTEP_S = 0.002
"""Time step of the physics of every twin, in seconds."""


class Hand(enum.IntEnum):
    """The holder of a joint.

    The simulation holds a joint from ``take`` until it is stopped or the wire energises the joint. It does
    not take the joint back by itself, because an old target would come back with it.
    """

    NONE = 0  # The joint is limp.
    WIRE = 1  # The robot's electronics, on commands from the wire.
    SIM = 2  # The simulation.


class Felt(NamedTuple):
    """One reading with a value per axis, in radians or metres. ``effort`` is in Nm or N."""

    time_s: float
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]
    hands: Sequence[Hand]


class Body(Protocol):
    """A simulated body. Time passes only in ``pass_time`` and ``step``; no method waits. Joints that the wire
    holds follow the wire."""

    @property
    def axes(self) -> tuple[str, ...]: ...
    @property
    def spec(self) -> Any:
        """The compiled model, an ``mujoco.MjSpec``."""
        ...

    @property
    def hands(self) -> Sequence[Hand]:
        """The holder of each axis."""
        ...

    def pass_time(self) -> None: ...
    def felt(self) -> Felt: ...
    def pose(self) -> Sequence[float]:
        """Return ``qpos`` of ``spec``."""
        ...

    def take(self, on: bool) -> None:
        """Energise the joints that the wire does not hold, at their positions. With ``on=False`` release them."""
        ...

    def aim(self, values: Sequence[float]) -> None:
        """Set the targets of the taken joints: one per axis, or ``target_rows`` rows if the body has that
        attribute."""
        ...

    def hold(self) -> None:
        """Hold the taken joints at their positions."""
        ...

    def step(self, steps: int) -> None:
        """Compute ``steps`` time steps of physics (``TIMESTEP_S``) at once."""
        ...

    def reset(self) -> None:
        """Return to the initial state."""
        ...


@runtime_checkable
class Flying(Protocol):
    """A body that falls when it is released."""

    def land(self) -> None:
        """Descend to the floor and switch the motors off there."""
        ...


def body_of(twin: object) -> Body:
    """Return the body of a twin. Raise ``ValueError`` for a twin without a body."""
    body: Body | None = getattr(twin, "body", None)
    if body is None:
        raise ValueError("this robot's twin shows no body: it cannot be simulated")
    return body
