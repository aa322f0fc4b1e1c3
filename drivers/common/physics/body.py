"""What a twin shows at its simulation control: the robot's body, whatever is behind its wire."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

TIMESTEP_S = 0.002
"""Of the physics of every twin."""


class Hand(enum.IntEnum):
    """Who holds a joint.

    What is energised on the wire follows the wire: a servo with torque enabled there, an arm whose
    controller runs a program. The simulation holds the rest, from ``take`` until it is stopped or
    the wire takes it. It is never given back by itself, since then an old target would come back
    with it.
    """

    NONE = 0  # nobody: it is limp
    WIRE = 1  # the robot's own electronics, told by whoever is on its wire
    SIM = 2  # the simulation


class Felt(NamedTuple):
    """One reading, a value per axis: radians or metres, and what is pushed with."""

    time_s: float
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]
    hands: Sequence[Hand]


class Body(Protocol):
    """Time passes between calls, in ``pass_time``; nothing here waits. What the wire holds follows
    the wire."""

    @property
    def axes(self) -> tuple[str, ...]: ...
    @property
    def spec(self) -> Any:
        """Return the model, as an ``mujoco.MjSpec`` that was compiled."""
        ...

    @property
    def hands(self) -> Sequence[Hand]:
        """Return who holds each axis."""
        ...

    def pass_time(self) -> None: ...
    def felt(self) -> Felt: ...
    def pose(self) -> Sequence[float]:
        """``qpos`` of ``spec``."""
        ...

    def take(self, on: bool) -> None:
        """Energise what the wire does not hold, where it is; or let go of what was taken."""
        ...

    def aim(self, values: Sequence[float]) -> None:
        """Targets for what was taken: one per axis, or ``target_rows`` rows of them, where a body
        has that attribute."""
        ...

    def hold(self) -> None:
        """Let what was taken stay where it is."""
        ...

    def step(self, steps: int) -> None:
        """Let so many time steps of physics (``TIMESTEP_S``) pass at once."""
        ...

    def reset(self) -> None:
        """Everything as at first."""
        ...


@runtime_checkable
class Flying(Protocol):
    """A body that falls when it is let go of."""

    def land(self) -> None:
        """Go down to the floor, and switch the motors off there."""
        ...


def body_of(twin: object) -> Body:
    """Raise ``ValueError`` for a twin that shows none."""
    body: Body | None = getattr(twin, "body", None)
    if body is None:
        raise ValueError("this robot's twin shows no body: it cannot be simulated")
    return body
