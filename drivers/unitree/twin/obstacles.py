"""Simulate the service ``obstacles_avoid`` of a Go2: it walks, and stops before obstacles if that is switched on.

Requests are those of the vendor's SDK. As in its example, a client first takes the remote control over
(``UseRemoteCommandFromApi``). Before that, ``Move`` has no effect [assumed]. Obstacles are the objects that were
added to the simulated scene. The robot stops ``STOP_M`` before them [assumed]. The service ``sport`` walks into
obstacles, as on the robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.legged_body import LeggedBody
from strands_actors.drivers.unitree import rpc

from .gait import REST, Gait

SERVICE, VERSION = "obstacles_avoid", "1.0.0.2"
SWITCH_SET, SWITCH_GET, MOVE, USE_REMOTE = 1001, 1002, 1003, 1004
VELOCITY, INCREMENT, ABSOLUTE = 0, 1, 2
"""Meaning of the numbers in a ``Move``: a velocity, a way to go, or a place to go to."""
STOP_M = 0.5
WALK_M_S, TURN_RAD_S = 0.5, 0.8
"""Speeds on the way to a place [assumed]."""
THERE_M, THERE_RAD = 0.05, 0.05
STEER_S = 0.05
"""Period of computing the velocity towards a place."""
AHEAD_COS = 0.5
"""An obstacle is ahead if it is at most 60 degrees to the side of the way [assumed]."""

Twist = tuple[float, float, float]


class ObstacleAvoidance:
    """The service."""

    def __init__(self, gait: Gait, body: LeggedBody) -> None:
        self._gait = gait
        self._body = body
        self.reset()

    def reset(self) -> None:
        self.is_on = False
        self.is_remote = False  # True while clients walk the robot by this service.
        self._twist: Twist = REST
        self._goal: Twist | None = None  # A place: x and y in m, and the heading in rad.
        self._next_s = 0.0  # Time at which the velocity towards the place is computed next.

    def order(self, api: int, parameter: dict[str, Any]) -> tuple[int, Any]:
        """Carry out a request. Return the code and the data of the answer.

        Raises:
            KeyError: The parameter lacks a key.
            TypeError, ValueError: The parameter has a wrong type, or ``Move`` an unknown mode.
        """
        if api == SWITCH_GET:
            return rpc.OK, {"enable": self.is_on}
        if api == SWITCH_SET:
            self.is_on = _flag(parameter["enable"])
        elif api == USE_REMOTE:
            self.is_remote = _flag(parameter["is_remote_commands_from_api"])
            if not self.is_remote:
                self._stop()
        elif api == MOVE:
            x, y, yaw = (float(parameter[key]) for key in ("x", "y", "yaw"))
            self._move((x, y, yaw), int(parameter["mode"]))
        else:
            return rpc.NOT_IMPLEMENTED, None
        return rpc.OK, None

    def _move(self, numbers: Twist, mode: int) -> None:
        x, y, yaw = numbers
        if not self.is_remote:
            return
        if mode == VELOCITY:
            self._goal, self._twist = None, (x, y, yaw)
            self._walk(self._twist)
        elif mode == ABSOLUTE:
            self._goal = x, y, yaw
        elif mode == INCREMENT:
            gait = self._gait
            cos, sin = math.cos(gait.heading_rad), math.sin(gait.heading_rad)
            here_x, here_y = gait.position
            self._goal = here_x + cos * x - sin * y, here_y + sin * x + cos * y, gait.heading_rad + yaw
        else:
            raise ValueError(f"a Move of the mode {mode}")

    def advance(self, now_s: float) -> None:
        """Walk on to a place, and stop before an obstacle. Call this before the gait advances."""
        if self._goal is not None:
            if now_s < self._next_s:
                return
            self._next_s = now_s + STEER_S
            self._twist = self._way_to(self._goal)
            if self._twist == REST:
                self._stop()
            else:
                self._walk(self._twist)
        elif self._twist != REST and self._gait.twist == REST:
            self._twist = REST  # The velocity has ended by itself.
        elif self._gait.twist != REST and self._gait.twist == self._twist and self._is_blocked(self._twist):
            self._stop()

    def _walk(self, twist: Twist) -> None:
        if self._is_blocked(twist):
            self._gait.order(rpc.STOP_MOVE, {})
        else:
            self._gait.order(rpc.MOVE, dict(zip("xyz", twist, strict=True)))

    def _stop(self) -> None:
        if self._twist != REST or self._goal is not None:
            self._goal, self._twist = None, REST
            self._gait.order(rpc.STOP_MOVE, {})

    def _way_to(self, goal: Twist) -> Twist:
        """Return the velocity towards a place, in the robot's frame. At the place it is ``REST``."""
        gait = self._gait
        x, y = goal[0] - gait.position[0], goal[1] - gait.position[1]
        turn_rad = math.remainder(goal[2] - gait.heading_rad, math.tau)
        far_m = math.hypot(x, y)
        if far_m <= THERE_M and abs(turn_rad) <= THERE_RAD:
            return REST
        cos, sin = math.cos(gait.heading_rad), math.sin(gait.heading_rad)
        speed = min(1.0, far_m / 0.2) * WALK_M_S / far_m if far_m > THERE_M else 0.0
        turn_rad_s = math.copysign(min(TURN_RAD_S, 2.0 * abs(turn_rad)), turn_rad)
        return (
            (cos * x + sin * y) * speed,
            (cos * y - sin * x) * speed,
            turn_rad_s if abs(turn_rad) > THERE_RAD else 0.0,
        )

    def _is_blocked(self, twist: Twist) -> bool:
        """Return True if avoidance is on and an obstacle is near, ahead on the way."""
        if not self.is_on or not any(twist[:2]):
            return False
        w, _, _, z = self._body.orientation_wxyz
        heading = 2.0 * math.atan2(z, w)
        cos, sin = math.cos(heading), math.sin(heading)
        way = np.array([cos * twist[0] - sin * twist[1], sin * twist[0] + cos * twist[1]])
        way /= np.linalg.norm(way)
        return any(float(way @ towards) >= AHEAD_COS for towards in self._near())

    def _near(self) -> Iterator[Any]:
        """Yield the horizontal directions to the obstacles that are nearer than ``STOP_M``."""
        model, data = self._body.model, self._body.data
        base = model.body("base").id
        (own, *_) = (geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == base)
        root, line = model.body_rootid[base], np.empty(6)
        for geom in range(model.ngeom):
            plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
            if plane or model.body_rootid[model.geom_bodyid[geom]] == root:
                continue
            if mujoco.mj_geomDistance(model, data, own, geom, STOP_M, line) < STOP_M:
                towards = line[3:5] - line[:2]
                yield towards / max(float(np.linalg.norm(towards)), 1e-9)


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError(f"{value!r} is neither true nor false")
    return value
