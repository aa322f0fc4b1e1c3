"""Watch the body of a twin while a program uses the robot: which axes moved, and where they are at the end.

The positions come from the twin's physics, over the socket of its simulation control. Nothing that the client or
the robot's protocol reports takes part in the judgement.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control.client import SimulationClient

EVERY_S = 0.05
ANSWER_S = 30.0
"""Timeout of a reading on a busy machine."""
STILL = 0.01
"""A smaller change of an axis is no movement: radians or metres. An arm that sags under its weight moves less."""
LEGS = 0.05
SWAY = 0.08
"""The same for joints that are no axis, such as legs, and for the base of a free body. A standing robot sways."""
BASE = ("base_x", "base_y", "base_z", "base_roll", "base_pitch", "base_yaw")
"""Axes of a body that stands, drives or flies freely, in the world's frame."""


class AxisWay(NamedTuple):
    """The way of one axis during a program, in radians or metres."""

    start: float
    least: float
    most: float
    end: float

    @property
    def range(self) -> float:
        """How far apart the two extreme positions were."""
        return self.most - self.least

    @property
    def furthest(self) -> float:
        """The extreme position that is furthest from the start."""
        return max(self.least, self.most, key=lambda position: abs(position - self.start))


class Way:
    """The ways of all axes."""

    def __init__(self, axes: Sequence[str], others: Sequence[str] = ()) -> None:
        self._axes = (*axes, *others)
        self._still = dict.fromkeys(axes, STILL) | {name: SWAY if name in BASE else LEGS for name in others}
        self._rows: dict[str, AxisWay] = {}

    def add(self, position: Sequence[float]) -> None:
        """Add a reading of all axes."""
        for axis, value in zip(self._axes, position, strict=True):
            known = self._rows.get(axis)
            if known is None:
                self._rows[axis] = AxisWay(value, value, value, value)
            else:
                self._rows[axis] = AxisWay(known.start, min(known.least, value), max(known.most, value), value)

    @property
    def rows(self) -> dict[str, AxisWay]:
        return dict(self._rows)

    def moved(self) -> dict[str, AxisWay]:
        """Return the axes that moved, the one that moved furthest first."""
        rows = {axis: row for axis, row in self._rows.items() if row.range > self._still[axis]}
        return dict(sorted(rows.items(), key=lambda item: -item[1].range))


class Watch:
    """Read the twin's body in a thread, for as long as the ``with`` block.

    Args:
        control: The socket of the twin's simulation control.
    """

    def __init__(self, control: Path) -> None:
        self._control = str(control)
        self._ended = threading.Event()
        self._began = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._read,), daemon=True)
        self.way = Way(())
        self.lost = ""
        """Why the body could not be read any longer; empty if it could."""

    def __enter__(self) -> Watch:
        self._thread.start()
        self._began.wait(ANSWER_S)
        return self

    def __exit__(
        self, error_type: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join(2 * ANSWER_S)

    async def _read(self) -> None:
        try:
            client = SimulationClient(self._control)
            try:
                await self._follow(client)
            finally:
                client.close()
        except WireDown as down:
            self.lost = str(down)
        finally:
            self._began.set()

    async def _follow(self, client: SimulationClient) -> None:
        axes = (await client.call(p.Handshake(0), p.Axes, ANSWER_S)).axes
        others = _others(await _joints(client), axes)
        self.way = Way(axes, [name for joint in others for name in joint.names])
        last = False
        while True:
            sample = await client.call(p.Read(0), p.Sample, ANSWER_S)
            row = list(sample.position)
            qpos = (await client.call(p.GetPose(0), p.Pose, ANSWER_S)).qpos
            row += [value for joint in others for value in joint.values(qpos)]
            self.way.add(row)
            self._began.set()
            if last:
                return
            # The reading after the end is the one in which the program has left the robot.
            last = self._ended.is_set()
            if not last:
                await trio.sleep(EVERY_S)


class Joint(NamedTuple):
    """A joint of the model.

    Attributes:
        name: Its name. Empty: the free joint of a body that stands, drives or flies.
        address: Where its position begins in the pose of the scene.
    """

    name: str
    address: int

    @property
    def names(self) -> tuple[str, ...]:
        return (self.name,) if self.name else BASE

    def values(self, qpos: Sequence[float]) -> Iterator[float]:
        """Yield the positions of this joint in a pose of the scene."""
        if self.name:
            yield qpos[self.address]
        else:
            yield from _base(qpos[self.address : self.address + 7])


async def _joints(client: SimulationClient) -> list[Joint]:
    """Return the joints of the model. Of several free joints, only the first is the robot's own base."""
    binary = (await client.call(p.GetModel(0), p.Model, ANSWER_S)).binary
    model = mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": binary})
    found: list[Joint] = []
    for joint in range(model.njnt):
        kind, address = int(model.jnt_type[joint]), int(model.jnt_qposadr[joint])
        if kind in (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)):
            found.append(Joint(model.joint(joint).name or f"joint {joint}", address))
        elif kind == int(mujoco.mjtJoint.mjJNT_FREE) and all(each.name for each in found):
            found.append(Joint("", address))
    return found


def _others(joints: Sequence[Joint], axes: Sequence[str]) -> list[Joint]:
    """Return the joints that are no axis of the robot's action: the base, the head, the legs."""
    return [joint for joint in joints if joint.name not in axes]


def _base(qpos: Sequence[float]) -> Iterator[float]:
    """Yield place and angles (roll, pitch, yaw) of a free body from its place and quaternion."""
    x, y, z, qw, qx, qy, qz = qpos
    yield from (x, y, z)
    yield math.atan2(2 * (qw * qx + qy * qz), 1 - 2 * (qx * qx + qy * qy))
    yield math.asin(max(-1.0, min(1.0, 2 * (qw * qy - qz * qx))))
    yield math.atan2(2 * (qw * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz))


__all__ = ["BASE", "STILL", "AxisWay", "Watch", "Way"]
