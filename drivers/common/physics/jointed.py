"""Base class of all simulated bodies in MuJoCo. Joints have an index, can be jammed, and are simulated up to the
present time on request.

Only simulated robots import this module: no process of a real robot loads MuJoCo.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .lean_mujoco import PLAIN, mujoco
from .solver import Solver, new_solver

LONGEST_CATCH_UP_S = 0.25
"""``catch_up`` steps at most so much time in one call. The rest of a longer stall is dropped, not
replayed."""


class Jointed:
    """The joints of a model, by their index in ``joints``. Each joint has its own actuator."""

    def __init__(self, spec: Any, joints: Sequence[str], **jam: Any) -> None:
        """Compile the model. Each joint gets a constraint that can be switched on to jam the joint.

        Args:
            spec: The ``MjSpec``.
            joints: Names of the joints, in the order of the indices.
            jam: Options of MuJoCo's equality constraint: how stiffly a jammed joint keeps its position.
        """
        self.joints = tuple(joints)
        self.spec = spec
        for name in self.joints:
            # While this constraint is active, it jams the joint at its position.
            spec.add_equality(
                default=PLAIN.default,
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name=f"{name}_jam",
                name1=name,
                active=False,
                **jam,
            )
        self.model: Any = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self._solver: Solver = new_solver(spec, self.model, self.data)
        self._step_s = float(self.model.opt.timestep)
        self._origin_s: float | None = None
        self._is_paused = False
        # Position and orientation (quaternion) at which the robot was placed; None if it was not moved.
        self.placed: tuple[Any, Any] | None = None
        self._bind()

    def _bind(self) -> None:
        """Find the actuator of each joint. In real models the actuators may have another order and other names than
        the joints."""
        model = self.model
        actuator_of = {
            int(model.actuator_trnid[actuator, 0]): actuator
            for actuator in range(len(model.actuator_trnid))
            if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        }
        self._joint = [model.joint(name).id for name in self.joints]
        self._actuator = np.array([actuator_of[joint] for joint in self._joint])
        self._jam = [model.equality(f"{name}_jam").id for name in self.joints]
        self._qpos = np.array([int(model.jnt_qposadr[joint]) for joint in self._joint])
        self._dof = np.array([int(model.jnt_dofadr[joint]) for joint in self._joint])
        self._base = self._free_base()

    def _free_base(self) -> tuple[int, int] | None:
        """Return the addresses of the free joint of the robot's base in ``qpos`` and ``qvel``; None if its base is
        fixed or moves on joints of its own."""
        model = self.model
        bodies = {int(model.body_rootid[model.jnt_bodyid[joint]]) for joint in self._joint}
        first = int(model.body_jntadr[bodies.pop()]) if len(bodies) == 1 else -1
        if first < 0 or model.jnt_type[first] != mujoco.mjtJoint.mjJNT_FREE:
            return None
        return int(model.jnt_qposadr[first]), int(model.jnt_dofadr[first])

    @property
    def time_s(self) -> float:
        """Return the time that was simulated."""
        return float(self.data.time)

    @property
    def position_rad(self) -> tuple[float, ...]:
        return tuple(self.data.qpos[self._qpos].tolist())

    @property
    def velocity_rad_s(self) -> tuple[float, ...]:
        return tuple(self.data.qvel[self._dof].tolist())

    @property
    def effort_nm(self) -> tuple[float, ...]:
        """Return the torque of each joint's actuator. It does not include gravity."""
        return tuple(self.data.actuator_force[self._actuator].tolist())

    @property
    def base_xyz_m(self) -> tuple[float, ...]:
        """Return the position of a base that moves freely; empty for any other robot. So are the two below."""
        return () if self._base is None else tuple(self.data.qpos[self._base[0] :][:3].tolist())

    @property
    def base_orientation_wxyz(self) -> tuple[float, ...]:
        return () if self._base is None else tuple(self.data.qpos[self._base[0] + 3 :][:4].tolist())

    @property
    def base_gyro_rad_s(self) -> tuple[float, ...]:
        return () if self._base is None else tuple(self.data.qvel[self._base[1] + 3 :][:3].tolist())

    def set_stuck(self, index: int, on: bool) -> None:
        """Seize the gearbox of a joint, or free it. A seized joint keeps its position under any load."""
        address = self._qpos[index]
        self.model.eq_data[self._jam[index], 0] = self.data.qpos[address] - self.model.qpos0[address]
        self.data.eq_active[self._jam[index]] = on

    def catch_up(self, now_s: float) -> None:
        """Simulate up to the time ``now_s`` of any monotonic clock. The first call sets the origin of this
        clock."""
        if self._origin_s is None or self._is_paused:
            self._origin_s = now_s - self.data.time
        behind_s = now_s - self._origin_s - self.data.time
        longest_s = min(LONGEST_CATCH_UP_S, self._solver.max_steps * self._step_s)
        if behind_s > longest_s:
            self._origin_s += behind_s - longest_s
            behind_s = longest_s
        steps = int(behind_s / self._step_s + 1e-6)
        if steps > 0:
            self._solver.step(self.model, self.data, steps)

    def pause(self, on: bool) -> None:
        """Stop the simulated time, so that it advances only by ``step``, or let it run again."""
        self._is_paused = on

    def step(self, steps: int) -> None:
        """Compute this number of time steps at once, in addition to those that ``catch_up`` computes."""
        self._solver.step(self.model, self.data, steps)
        if self._origin_s is not None:
            self._origin_s -= steps * self._step_s

    def recompile(self) -> None:
        """Compile the model again, after ``spec`` has changed. Moving bodies keep moving.

        The servos keep their present gains, which differ from those in ``spec``.

        Raises:
            ValueError: The spec cannot be compiled. The model is unchanged.
        """
        before = self.model
        model, data = self.spec.recompile(before, self.data)
        for name in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "eq_data"):
            kept = getattr(before, name)
            getattr(model, name)[: len(kept)] = kept
        self._solver = new_solver(self.spec, model, data)
        self.model, self.data = model, data
        self._bind()
        mujoco.mj_forward(self.model, self.data)

    def set_clock_back(self, seconds: float) -> None:
        """Note that the time of the simulation was set back by ``seconds``, so that ``catch_up`` does not simulate
        this time again."""
        if self._origin_s is not None:
            self._origin_s += seconds

    def begin_anew(self) -> None:
        """Set the whole simulation back to its initial state."""
        self._rewind()

    def _rewind(self) -> None:
        """Set the model back to its initial state. The simulated time starts at 0 again."""
        mujoco.mj_resetData(self.model, self.data)
        self._origin_s = None
