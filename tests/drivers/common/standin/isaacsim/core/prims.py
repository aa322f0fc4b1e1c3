from __future__ import annotations

from typing import Any

import numpy as np

import isaacsim


class Controller:
    def __init__(self, dofs: int) -> None:
        self.kps, self.kds = np.zeros(dofs), np.zeros(dofs)
        self.max_efforts = np.full(dofs, np.inf)

    def set_gains(self, kps: Any, kds: Any) -> None:
        isaacsim.calls.append(("gains", np.array(kps)))
        self.kps, self.kds = np.array(kps), np.array(kds)

    def set_max_efforts(self, values: Any, joint_indices: Any = None) -> None:
        self.max_efforts[joint_indices] = values


class SingleArticulation:
    def __init__(self, prim_path: str, name: str) -> None:
        self._path, self._ready = prim_path, False

    def initialize(self) -> None:
        self._ready = True
        self.dof_names = isaacsim.imported[self._path]
        self._controller = Controller(len(self.dof_names))
        self._at, self._speed, self._target, self._effort = np.zeros((4, len(self.dof_names)))

    def get_articulation_controller(self) -> Controller:
        assert self._ready, "reset the world first"
        return self._controller

    def get_joint_positions(self) -> Any:
        return self._at.copy()

    def get_joint_velocities(self) -> Any:
        return self._speed.copy()

    def set_joint_positions(self, positions: Any, joint_indices: Any = None) -> None:
        isaacsim.calls.append(("put", np.array(positions)))
        self._at[joint_indices] = positions

    def set_joint_velocities(self, velocities: Any, joint_indices: Any = None) -> None:
        self._speed[joint_indices] = velocities

    def apply_action(self, action: Any) -> None:
        self._target, self._effort = np.array(action.joint_positions), np.array(action.joint_efforts)

    def advance(self, dt: float) -> None:
        stiff = self._controller.kps > 0
        lag = (self._target - self._at) * min(1.0, 20.0 * dt)
        moved = np.where(stiff, lag, self._effort * dt)
        self._at, self._speed = self._at + moved, moved / dt
