"""The robot's body: a MuJoCo model, joints driven by position servos, stepped to wall time on demand.

Imported by twins only: nothing of the runtime or of the wire process loads MuJoCo.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .door.body import Hand
from .model_rows import build
from .without_gl import mujoco

LONGEST_CATCH_UP_S = 0.25
"""Time that nobody looked at is stepped when somebody does, up to this: a longer stall is dropped, not
replayed."""


class Plant:
    """Joints by index, in the order of ``joints``.

    A servo follows its target with the joint's effort and, in a model of rows, the joint's speed at most.
    With torque off it has no gain at all, so that gravity has the arm. At first torque is off and joints
    are at ``home_rad`` (default: zero), or at the end of their range nearest to it.

    A joint has one hand on it. The wire's (``set_torque``, ``set_target``) takes it whenever it is energised there,
    and the simulation's (``take``, ``aim``) only what the wire does not hold.
    """

    def __init__(
        self,
        spec: Any,
        joints: Sequence[str],
        bandwidth_rad_s: float = 30.0,
        home_rad: Sequence[float] = (),
    ) -> None:
        self.joints = tuple(joints)
        self.spec = spec
        for name in self.joints:
            spec.add_equality(  # switched on, it jams the joint where it is
                type=mujoco.mjtEq.mjEQ_JOINT,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                name=f"{name}_jam",
                name1=name,
                active=False,
                solimp=[0.999, 0.9999, 0.001, 0.5, 2.0],
            )
        self.model: Any = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self._step_s = float(self.model.opt.timestep)
        self._origin_s: float | None = None
        self._bind()
        self._kp = self.model.dof_M0[self._dof] * bandwidth_rad_s**2
        self._kv = self.model.dof_M0[self._dof] * bandwidth_rad_s * 2  # critically damped
        self._hand = [Hand.NONE] * len(self.joints)
        self._home_rad = tuple(home_rad)
        self.go_home()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Plant:
        """The plant of one robot's table in ``robots.toml``."""
        joints = [joint["key"] for joint in table["joints"]]
        return cls(build(table), joints, float(table["bandwidth"]), table.get("home_rad", ()))

    def _bind(self) -> None:
        """Find each joint's servo by what it turns: in real models neither order nor name says so."""
        model = self.model
        servo_of = {
            int(model.actuator_trnid[servo, 0]): servo
            for servo in range(len(model.actuator_trnid))
            if model.actuator_trntype[servo] == mujoco.mjtTrn.mjTRN_JOINT
        }
        self._joint = [model.joint(name).id for name in self.joints]
        self._servo = [servo_of[joint] for joint in self._joint]
        self._control = [int(model.actuator_ctrladr[servo]) for servo in self._servo]
        self._state = [int(model.actuator_actadr[servo]) for servo in self._servo]  # -1: not rate-limited
        self._jam = [model.equality(f"{name}_jam").id for name in self.joints]
        self._qpos = [int(model.jnt_qposadr[joint]) for joint in self._joint]
        self._dof = [int(model.jnt_dofadr[joint]) for joint in self._joint]
        self._effort_nm = [float(model.actuator_forcerange[servo, 1]) for servo in self._servo]

    def go_home(self) -> None:
        """Everything as at first; time begins anew."""
        mujoco.mj_resetData(self.model, self.data)
        self._origin_s = None
        if self._home_rad:
            self.data.qpos[self._qpos] = self._home_rad
        for index, (joint, address) in enumerate(zip(self._joint, self._qpos, strict=True)):
            if self.model.jnt_limited[joint]:
                self.data.qpos[address] = np.clip(self.data.qpos[address], *self.model.jnt_range[joint])
            self.set_target(index, float(self.data.qpos[address]))
            self._pass_to(index, Hand.NONE)
        mujoco.mj_forward(self.model, self.data)

    @property
    def time_s(self) -> float:
        """Of the simulation."""
        return float(self.data.time)

    @property
    def position_rad(self) -> list[float]:
        values: list[float] = self.data.qpos[self._qpos].tolist()
        return values

    @property
    def velocity_rad_s(self) -> list[float]:
        values: list[float] = self.data.qvel[self._dof].tolist()
        return values

    @property
    def effort_nm(self) -> list[float]:
        """What the servos push with, not what gravity pulls."""
        values: list[float] = self.data.actuator_force[self._servo].tolist()
        return values

    @property
    def effort_limit_nm(self) -> list[float]:
        """What the servos can push with at most."""
        return list(self._effort_nm)

    def hand(self, index: int) -> Hand:
        return self._hand[index]

    def torque(self, index: int) -> bool:
        return self._hand[index] is not Hand.NONE

    def set_target(self, index: int, rad: float) -> None:
        self.data.ctrl[self._control[index]] = rad

    def set_torque(self, index: int, on: bool) -> None:
        """A servo that wakes up starts from where the joint is, whatever its target."""
        if on != (self._hand[index] is Hand.WIRE):
            self._pass_to(index, Hand.WIRE if on else Hand.NONE)

    def take(self, index: int, on: bool) -> None:
        """The simulation's torque. It holds the joint where it is, with all its effort."""
        if self._hand[index] is Hand.WIRE or on == (self._hand[index] is Hand.SIM):
            return
        if on:
            self.set_target(index, float(self.data.qpos[self._qpos[index]]))
            self.set_effort_share(index, 1.0)
        self._pass_to(index, Hand.SIM if on else Hand.NONE)

    def aim(self, index: int, rad: float) -> None:
        """The simulation's target."""
        if self._hand[index] is Hand.SIM:
            self.set_target(index, rad)

    def _pass_to(self, index: int, hand: Hand) -> None:
        self._hand[index] = hand
        on = hand is not Hand.NONE
        kp, kv = (float(self._kp[index]), float(self._kv[index])) if on else (0.0, 0.0)
        servo = self._servo[index]
        self.model.actuator_gainprm[servo, 0] = kp if self._state[index] < 0 else 0.0
        self.model.actuator_biasprm[servo, 1:3] = -kp, -kv
        if on and self._state[index] >= 0:
            self.data.act[self._state[index]] = self.data.qpos[self._qpos[index]]

    def set_effort_share(self, index: int, share: float) -> None:
        """Limit a servo to this share, 0..1, of its effort."""
        limit = self._effort_nm[index] * share
        self.model.actuator_forcerange[self._servo[index]] = -limit, limit

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
        if behind_s > LONGEST_CATCH_UP_S:
            self._origin_s += behind_s - LONGEST_CATCH_UP_S
            behind_s = LONGEST_CATCH_UP_S
        steps = int(behind_s / self._step_s + 1e-6)
        if steps > 0:
            mujoco.mj_step(self.model, self.data, steps)
