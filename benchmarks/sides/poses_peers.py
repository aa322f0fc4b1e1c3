"""Solve poses with other libraries: ``python -m benchmarks.sides.poses_peers NAME FILE``.

It runs in the environment of the peers (``python -m benchmarks.peers poses``), without this package. FILE has the
arms and the poses, as ``benchmarks.sides.poses goals FILE`` writes them. Every library starts at the arm's home
position. If that leads to no solution, it starts again at a random position, up to ``STARTS`` times.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np

STARTS, STEPS = 40, 100
NEAR_M, NEAR_RAD = 1e-5, 1e-4
"""A search ends at this distance, as ours does."""
FOUND_M, FOUND_RAD = 1e-3, np.radians(0.5)
"""A pose counts as found within the goals of the benchmark."""
SLOW = 30
"""Number of poses of each arm for a library that needs tenths of a second for each."""


class Solver(ABC):
    """One library with one arm."""

    def __init__(self, arm: dict[str, Any]) -> None:
        self.low, self.high = np.array(arm["low"]), np.array(arm["high"])

    @abstractmethod
    def search(self, goal: Any, start: Any) -> Any:
        """Return joint positions (rad) from one start. The goal is a matrix of 4 x 4."""

    @abstractmethod
    def pose(self, rad: Any) -> Any:
        """Return the pose of the tool, a matrix of 4 x 4."""

    def off(self, goal: Any, rad: Any) -> tuple[float, float]:
        """Return the distance from the goal in m, and the turn in rad."""
        pose = self.pose(rad)
        cosine = (np.trace(pose[:3, :3].T @ goal[:3, :3]) - 1) / 2
        return float(np.linalg.norm(pose[:3, 3] - goal[:3, 3])), float(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def found(self, goal: Any, rad: Any) -> bool:
        far, turned = self.off(goal, rad)
        inside = np.all(rad >= self.low - 1e-6) and np.all(rad <= self.high + 1e-6)
        return bool(inside) and far < FOUND_M and turned < FOUND_RAD


class Pinocchio(Solver):
    """Its documented loop (damped least squares), with the joints clipped to their ranges."""

    DAMPING, GAIN = 1e-6, 0.5

    def __init__(self, arm: dict[str, Any]) -> None:
        import pinocchio

        super().__init__(arm)
        self._pin: Any = pinocchio
        self._model = pinocchio.buildModelFromXML(arm["urdf"])
        self._data = self._model.createData()
        self._frame = self._model.getFrameId("tool")

    def search(self, goal: Any, start: Any) -> Any:
        pin, rad, target = self._pin, start.copy(), self._pin.SE3(goal)
        for _ in range(STEPS):
            pin.framesForwardKinematics(self._model, self._data, rad)
            towards = self._data.oMf[self._frame].actInv(target)
            error = pin.log(towards).vector
            if np.linalg.norm(error[:3]) < NEAR_M and np.linalg.norm(error[3:]) < NEAR_RAD:
                break
            jacobian = pin.computeFrameJacobian(self._model, self._data, rad, self._frame)
            jacobian = -pin.Jlog6(towards.inverse()) @ jacobian
            square = jacobian @ jacobian.T + self.DAMPING * np.eye(6)
            step = -jacobian.T @ np.linalg.solve(square, error)
            rad = np.clip(rad + self.GAIN * step, self.low, self.high)
        return rad

    def pose(self, rad: Any) -> Any:
        self._pin.framesForwardKinematics(self._model, self._data, rad)
        return self._data.oMf[self._frame].homogeneous


class Mink(Solver):
    """A frame task with the limits of the joints, solved by daqp."""

    def __init__(self, arm: dict[str, Any]) -> None:
        import mink
        import mujoco

        super().__init__(arm)
        self._mink: Any = mink
        model = mujoco.MjModel.from_xml_string(arm["mjcf"])
        self._configuration = mink.Configuration(model)
        self._limits = [mink.ConfigurationLimit(model)]
        self._task = mink.FrameTask("tool", "body", position_cost=1.0, orientation_cost=1.0, lm_damping=1e-3)

    def search(self, goal: Any, start: Any) -> Any:
        self._configuration.update(start)
        self._task.set_target(self._mink.SE3.from_matrix(goal))
        for _ in range(STEPS):
            error = self._task.compute_error(self._configuration)
            if np.linalg.norm(error[:3]) < NEAR_M and np.linalg.norm(error[3:]) < NEAR_RAD:
                break
            velocity = self._mink.solve_ik(
                self._configuration, [self._task], 1.0, "daqp", damping=1e-9, limits=self._limits
            )
            self._configuration.integrate_inplace(velocity, 1.0)
        return self._configuration.q.copy()

    def pose(self, rad: Any) -> Any:
        self._configuration.update(rad)
        return self._configuration.get_transform_frame_to_world("tool", "body").as_matrix()


class Ikpy(Solver):
    """Its ``inverse_kinematics_frame`` with the whole orientation."""

    def __init__(self, arm: dict[str, Any]) -> None:
        from ikpy.chain import Chain

        super().__init__(arm)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "arm.urdf"
            file.write_text(arm["urdf"])
            chain = Chain.from_urdf_file(str(file), base_elements=arm["path"])
        self._active = np.array([link.joint_type == "revolute" for link in chain.links])
        self._chain = Chain(chain.links, active_links_mask=self._active)

    def search(self, goal: Any, start: Any) -> Any:
        solution = self._chain.inverse_kinematics_frame(
            goal, initial_position=self._all(start), orientation_mode="all"
        )
        return np.array(solution)[self._active]

    def pose(self, rad: Any) -> Any:
        return self._chain.forward_kinematics(self._all(rad))

    def _all(self, rad: Any) -> Any:
        values = np.zeros(len(self._active))
        values[self._active] = rad
        return values


LIBRARIES: dict[str, tuple[type[Solver], int | None]] = {
    "pinocchio": (Pinocchio, None),
    "mink": (Mink, None),
    "ikpy": (Ikpy, SLOW),
}


def matrix(goal: dict[str, Any]) -> Any:
    w, x, y, z = goal["quat"]
    pose = np.eye(4)
    pose[:3, 3] = goal["xyz"]
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return pose


def figures_of(name: str, arms: dict[str, Any]) -> dict[str, float]:
    made, count = LIBRARIES[name]
    figures: dict[str, float] = {}
    for robot, arm in arms.items():
        solver, generator = made(arm), np.random.default_rng(5)
        took_ms, off_mm, turned_deg = [], [], []
        goals = [matrix(goal) for goal in arm["goals"][:count]]
        for goal in goals:
            began_s = time.process_time()
            start = np.array(arm["home"])
            for _ in range(STARTS):
                rad = solver.search(goal, start)
                found = solver.found(goal, rad)
                if found:
                    break
                start = generator.uniform(solver.low, solver.high)
            took_ms.append((time.process_time() - began_s) * 1e3)
            if found:
                far, turned = solver.off(goal, rad)
                off_mm.append(far * 1e3)
                turned_deg.append(np.degrees(turned))
        figures |= {
            f"{robot}_found_pct": 100 * len(off_mm) / len(goals),
            f"{robot}_p50_ms": float(np.percentile(took_ms, 50)),
            f"{robot}_p95_ms": float(np.percentile(took_ms, 95)),
            f"{robot}_off_mm": max(off_mm, default=float("inf")),
            f"{robot}_turned_deg": float(max(turned_deg, default=float("inf"))),
        }
    return figures


def main() -> None:
    name, file, *_ = sys.argv[1:]
    arms = json.loads(Path(file).read_text())
    print(json.dumps(figures_of(name, arms)))


if __name__ == "__main__":
    main()
