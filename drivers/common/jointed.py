"""What every body in MuJoCo does: its joints by index, stepped to wall time on demand, and jammed
on request.

Imported by twins only: nothing of the runtime or of the wire process loads MuJoCo.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .lean_mujoco import PLAIN, mujoco
from .solver import Solver, new_solver

LONGEST_CATCH_UP_S = 0.25
"""Time that nobody looked at is stepped when somebody does, up to this: a longer stall is dropped,
not replayed."""


class Jointed:
    """Joints by index, in the order of ``joints``, each with an actuator of its own."""

    def __init__(self, spec: Any, joints: Sequence[str], **jam: Any) -> None:
        """``jam``: how stiffly a seized joint stays where it is, in the words of MuJoCo's
        equalities."""
        self.joints = tuple(joints)
        self.spec = spec
        for name in self.joints:
            spec.add_equality(  # switched on, it jams the joint where it is
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
        self.placed: tuple[Any, Any] | None = None  # position and quaternion that the robot was put to
        self._bind()

    def _bind(self) -> None:
        """Find each joint's actuator by what it turns: in real models neither order nor name says
        so."""
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
        """Return what the actuators push with, not what gravity pulls."""
        return tuple(self.data.actuator_force[self._actuator].tolist())

    def set_stuck(self, index: int, on: bool) -> None:
        """A seized gearbox: the joint stays where it is whatever pulls."""
        address = self._qpos[index]
        self.model.eq_data[self._jam[index], 0] = self.data.qpos[address] - self.model.qpos0[address]
        self.data.eq_active[self._jam[index]] = on

    def catch_up(self, now_s: float) -> None:
        """Step to ``now_s``, on any clock that runs forward. The first call sets the clock."""
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
        """So many steps at once, which no clock has seen: it runs on from there."""
        self._solver.step(self.model, self.data, steps)
        if self._origin_s is not None:
            self._origin_s -= steps * self._step_s

    def recompile(self) -> None:
        """Take what was added to ``spec`` into the model. What moves goes on, and so do the servos:
        their gains are not the spec's. Raise ``ValueError``, with the model as it was."""
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
        """The simulation's time was set back by so much: nothing of that is to be caught up."""
        if self._origin_s is not None:
            self._origin_s += seconds

    def begin_anew(self) -> None:
        """Everything as at first."""
        self._rewind()

    def _rewind(self) -> None:
        """Everything as the model has it; time begins anew."""
        mujoco.mj_resetData(self.model, self.data)
        self._origin_s = None
