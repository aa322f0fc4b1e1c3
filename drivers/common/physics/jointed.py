"""The base of every body in MuJoCo. It addresses joints by index, steps to wall time on demand, and
can jam a joint.

Only twins import it: neither the runtime nor the wire process loads MuJoCo.
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
    """Joints by index, in the order of ``joints``. Each has its own actuator."""

    def __init__(self, spec: Any, joints: Sequence[str], **jam: Any) -> None:
        """Compile the model, with a switchable jam for every joint.

        Args:
            spec: The ``MjSpec``.
            joints: Names of the joints, in the order of the indices.
            jam: Options of MuJoCo's equalities. They set how stiffly a jammed joint stays in place.
        """
        self.joints = tuple(joints)
        self.spec = spec
        for name in self.joints:
            spec.add_equality(  # active, it jams the joint at its position
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
        self.placed: tuple[Any, Any] | None = None  # position and quaternion at which the robot was placed
        self._bind()

    def _bind(self) -> None:
        """Find each actuator by the joint that it drives. In real models neither the order nor the names
        of the actuators match those of the joints."""
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

    @property
    def position_rad(self) -> tuple[float, ...]:
        return tuple(self.data.qpos[self._qpos].tolist())

    @property
    def velocity_rad_s(self) -> tuple[float, ...]:
        return tuple(self.data.qvel[self._dof].tolist())

    @property
    def effort_nm(self) -> tuple[float, ...]:
        """Return the torques of the actuators, without gravity."""
        return tuple(self.data.actuator_force[self._actuator].tolist())

    def set_stuck(self, index: int, on: bool) -> None:
        """Seize the gearbox of a joint, or free it. A seized joint keeps its position under any load."""
        address = self._qpos[index]
        self.model.eq_data[self._jam[index], 0] = self.data.qpos[address] - self.model.qpos0[address]
        self.data.eq_active[self._jam[index]] = on

    def catch_up(self, now_s: float) -> None:
        """Step to ``now_s``, on any monotonic clock. The first call sets the origin."""
        if self._origin_s is None:
            self._origin_s = now_s - self.data.time
        behind_s = now_s - self._origin_s - self.data.time
        longest_s = min(LONGEST_CATCH_UP_S, self._solver.at_most * self._step_s)
        if behind_s > longest_s:
            self._origin_s += behind_s - longest_s
            behind_s = longest_s
        steps = int(behind_s / self._step_s + 1e-6)
        if steps > 0:
            self._solver.step(self.model, self.data, steps)

    def step(self, steps: int) -> None:
        """Make this number of steps at once. The clock does not count them."""
        self._solver.step(self.model, self.data, steps)
        if self._origin_s is not None:
            self._origin_s -= steps * self._step_s

    def recompile(self) -> None:
        """Compile the additions to ``spec`` into the model.

        Motion continues. The servos keep their gains, which were changed after the spec was made.

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
        """Note that the time of the simulation was set back. ``catch_up`` does not step that time again."""
        if self._origin_s is not None:
            self._origin_s += seconds

    def begin_anew(self) -> None:
        """Set everything back to the start."""
        self._rewind()

    def _rewind(self) -> None:
        """Set everything back to the model's initial state. Time starts at 0 again."""
        mujoco.mj_resetData(self.model, self.data)
        self._origin_s = None
