"""Simulate the robot behind the simulated daemon. Axes follow their targets at the motors' speed. Recorded and
commanded moves are played."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander, Felt
from strands_actors.drivers.common.physics.stepped import Stepped, towards

PEAK = 1.875
"""Peak speed of a minimum-jerk move, as a multiple of its average speed."""

Row = tuple[float, ...]


class Move:
    """A motion from the present position through ``stages``, a list of targets with the duration of each in
    seconds.

    ``listed`` is true if the daemon includes the move in its list of running moves. The real daemon lists only
    moves that were begun over REST.
    """

    def __init__(self, uuid: str, stages: Sequence[tuple[Row, float]], listed: bool = True) -> None:
        self.uuid = uuid
        self.listed = listed
        self._stages = list(stages)
        self._from: Row = ()
        self._passed_s = 0.0

    def step(self, step_s: float, position: Row) -> Row | None:
        """Advance the move by one step and return its target; None if the move has ended."""
        if not self._stages:
            return None
        target, duration_s = self._stages[0]
        self._from = self._from or position
        self._passed_s += step_s
        part = min(1.0, self._passed_s / duration_s)
        eased = part**3 * (10 - 15 * part + 6 * part**2)
        aimed = tuple(a + (b - a) * eased for a, b in zip(self._from, target, strict=True))
        if part == 1.0:
            self._stages.pop(0)
            self._from, self._passed_s = target, 0.0
        return aimed


class ReachyBody(Stepped):
    """The simulated body of the robot. Values are in axis order and in the driver's units.

    Motors without torque keep their position [assumed]. The head of the real robot drops.
    """

    def __init__(self, axes: Sequence[Axis], table: Mapping[str, Any], now_s: Callable[[], float]) -> None:
        self.axes = tuple(axis.key for axis in axes)
        self._table = table
        self._speeds = [axis.speed * PEAK for axis in axes]
        self._scales = [1e-3 if axis.unit == "mm" else math.radians(1.0) for axis in axes]
        super().__init__(now_s)
        self.ended: list[str] = []  # ids of moves that have ended and are not reported yet
        self.reset()

    def reset(self) -> None:
        """Reset the simulated robot: all axes at zero, motors on."""
        self.mode = "enabled"
        self.position: Row = (0.0,) * len(self.axes)
        self.target: Row = self.position
        self.move: Move | None = None
        self.stuck = False
        self.commander = Commander.NONE

    def set_mode(self, mode: str) -> None:
        """Set the motors' mode, as the daemon does. When torque begins, the target is the present position."""
        if mode == "enabled" and self.mode != "enabled":
            self.target = self.position
        self.mode = mode

    def aim_at(self, target: Row) -> bool:
        """Set a target. Return False if a move runs, because the daemon then ignores targets."""
        self.commander = Commander.WIRE
        if self.move is None:
            self.target = target
        return self.move is None

    def play(self, move: Move) -> None:
        """Play a move. If a move is already running, the new one ends at once without a reason, as with the
        real daemon."""
        self.commander = Commander.WIRE
        if self.move is None:
            self.move = move
        else:
            self.ended.append(move.uuid)

    def end_move(self) -> str:
        """End the running move at the present position. Return its id; empty if no move was running."""
        move, self.move = self.move, None
        if self.commander is Commander.WIRE:
            self.commander = Commander.NONE
        return move.uuid if move is not None else ""

    def _step(self, step_s: float) -> None:
        if self.move is not None:
            aimed = self.move.step(step_s, self.position)
            if aimed is None:
                self.ended.append(self.end_move())
            else:
                self.target = aimed
        if (self.mode == "enabled" or self.commander is Commander.SIM) and not self.stuck:
            self.position = tuple(
                towards(position, goal, speed * step_s)
                for position, goal, speed in zip(self.position, self.target, self._speeds, strict=True)
            )

    # -- methods for a local simulation

    @cached_property
    def spec(self) -> Any:
        # Import MuJoCo only here. It only renders pictures.
        from strands_actors.drivers.common.physics.model_rows import build

        return build(self._table)

    @property
    def commanders(self) -> Sequence[Commander]:
        return (self.commander,) * len(self.axes)

    def felt(self) -> Felt:
        still = (0.0,) * len(self.axes)
        return Felt(self.time_s, self._metric(self.position), still, still, self.commanders)

    def pose(self) -> Sequence[float]:
        values = dict(zip(self.axes, self._metric(self.position), strict=True))
        # In the model the head is mounted on the turning body, so its yaw is relative to the body.
        values["head_yaw"] -= values["body_yaw"]
        return [values[name] for name in _MODEL_ORDER]

    def energise(self, on: bool) -> None:
        if self.commander is (Commander.NONE if on else Commander.SIM):
            self.commander, self.target = (Commander.SIM if on else Commander.NONE), self.position

    def set_targets(self, values: Sequence[float]) -> None:
        if self.commander is Commander.SIM:
            self.target = tuple(value / scale for value, scale in zip(values, self._scales, strict=True))

    def hold(self) -> None:
        if self.commander is Commander.SIM:
            self.target = self.position

    def step(self, steps: int) -> None:
        self.run(steps * TIMESTEP_S)

    def _metric(self, row: Row) -> list[float]:
        return [value * scale for value, scale in zip(row, self._scales, strict=True)]


_MODEL_ORDER = (
    "body_yaw", "head_x", "head_y", "head_z", "head_yaw", "head_pitch", "head_roll", "antenna_left",
    "antenna_right",
)  # fmt: skip
"""The joints in the order of ``model_rows``."""
