"""The body of an arm: a MuJoCo model with a position servo for each joint. Only for twins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .body import Hand
from .jointed import Jointed
from .lean_mujoco import mujoco
from .model_rows import build


class Plant(Jointed):
    """An arm on position servos.

    A servo follows its target with at most the joint's effort and, in a model of rows, the joint's speed.
    With torque off it has no gain, and gravity moves the arm. At first torque is off, and the joints are
    at ``home_rad`` or at the nearest end of their range.

    At most one side holds a joint. The wire (``set_torque``, ``set_target``) takes a joint whenever it is
    energised on the wire. The simulation (``take``, ``aim``) gets only joints that the wire does not hold.

    Args:
        spec: The ``MjSpec``.
        joints: Names of the joints, in the order of the indices.
        bandwidth_rad_s: Bandwidth of a servo without its own gains, in rad/s.
        home_rad: Position of each joint at first, in radians. The default is zero.
        gains: Stiffness and damping of each servo. Stiffness 0 uses the bandwidth.
        home_qpos: State of the whole model at first, with free bodies and passive joints.
    """

    def __init__(
        self,
        spec: Any,
        joints: Sequence[str],
        bandwidth_rad_s: float = 30.0,
        home_rad: Sequence[float] = (),
        gains: Sequence[tuple[float, float]] = (),
        home_qpos: Sequence[float] = (),
    ) -> None:
        super().__init__(spec, joints, solimp=[0.999, 0.9999, 0.001, 0.5, 2.0])
        self._kp = self.model.dof_M0[self._dof] * bandwidth_rad_s**2
        self._kv = self.model.dof_M0[self._dof] * bandwidth_rad_s * 2  # critically damped
        if gains:
            own = np.array([kp > 0 for kp, _ in gains])
            self._kp = np.where(own, [kp for kp, _ in gains], self._kp)
            self._kv = np.where(own, [kv for _, kv in gains], self._kv)
        self._hand = [Hand.NONE] * len(self.joints)
        self._home_rad = tuple(home_rad)
        self._home_qpos = tuple(home_qpos)
        self.go_home()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Plant:
        """Return the plant of a robot's table in ``robots.toml``."""
        joints = [joint["key"] for joint in table["joints"]]
        return cls(build(table), joints, float(table["bandwidth"]), table.get("home_rad", ()))

    def _bind(self) -> None:
        super()._bind()
        model = self.model
        self._control = [int(model.actuator_ctrladr[servo]) for servo in self._actuator]
        self._state = [int(model.actuator_actadr[servo]) for servo in self._actuator]  # -1: no limit of speed
        self._effort_nm = [float(model.actuator_forcerange[servo, 1]) for servo in self._actuator]

    def begin_anew(self) -> None:
        self.go_home()

    def go_home(self) -> None:
        """Set everything back to the start. Time starts at 0 again."""
        self._rewind()
        if self._home_rad:
            self.data.qpos[self._qpos] = self._home_rad
        self.data.qpos[: len(self._home_qpos)] = self._home_qpos
        if self._home_qpos and self.placed is not None:
            self._place_free_bodies(*self.placed)
        for index, (joint, address) in enumerate(zip(self._joint, self._qpos, strict=True)):
            if self.model.jnt_limited[joint]:
                self.data.qpos[address] = np.clip(self.data.qpos[address], *self.model.jnt_range[joint])
            self.set_target(index, float(self.data.qpos[address]))
            self._pass_to(index, Hand.NONE)
        mujoco.mj_forward(self.model, self.data)

    def _place_free_bodies(self, position: Any, turn: Any) -> None:
        """Put the free bodies of ``home_qpos`` at the place of the robot."""
        model, qpos = self.model, self.data.qpos
        for at in model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]:
            if at < len(self._home_qpos):
                moved, turned = np.zeros(3), np.zeros(4)
                mujoco.mju_rotVecQuat(moved, qpos[at : at + 3], turn)
                mujoco.mju_mulQuat(turned, turn, qpos[at + 3 : at + 7])
                qpos[at : at + 3], qpos[at + 3 : at + 7] = moved + position, turned

    @property
    def time_s(self) -> float:
        """Time of the simulation."""
        return float(self.data.time)

    @property
    def effort_limit_nm(self) -> list[float]:
        """The largest torque of each servo, in Nm."""
        return list(self._effort_nm)

    def hand(self, index: int) -> Hand:
        return self._hand[index]

    def torque(self, index: int) -> bool:
        return self._hand[index] is not Hand.NONE

    def set_target(self, index: int, rad: float) -> None:
        self.data.ctrl[self._control[index]] = rad

    def set_torque(self, index: int, on: bool) -> None:
        """Switch a servo's torque, from the wire. A servo that is switched on starts from the joint's
        position, whatever its target."""
        if on != (self._hand[index] is Hand.WIRE):
            self._pass_to(index, Hand.WIRE if on else Hand.NONE)

    def take(self, index: int, on: bool) -> None:
        """Switch a servo's torque, from the simulation. It holds the joint's position with all its
        effort."""
        if self._hand[index] is Hand.WIRE or on == (self._hand[index] is Hand.SIM):
            return
        if on:
            self.set_target(index, float(self.data.qpos[self._qpos[index]]))
            self.set_effort_share(index, 1.0)
        self._pass_to(index, Hand.SIM if on else Hand.NONE)

    def aim(self, index: int, rad: float) -> None:
        """Set a target in radians, from the simulation."""
        if self._hand[index] is Hand.SIM:
            self.set_target(index, rad)

    def push(self, nm: Sequence[float]) -> None:
        """Add these torques to those of the servos."""
        self.data.qfrc_applied[self._dof] = nm

    def pose_of(self, body: str, offset_m: Sequence[float]) -> tuple[float, ...]:
        """Return the place of a point of a body and the body's axes, as a 4 x 4 matrix, column by
        column."""
        rotation = self.data.body(body).xmat.reshape(3, 3)
        place = self.data.body(body).xpos + rotation @ np.asarray(offset_m)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, place
        return tuple(matrix.flatten("F").tolist())

    def _pass_to(self, index: int, hand: Hand) -> None:
        self._hand[index] = hand
        on = hand is not Hand.NONE
        kp, kv = (float(self._kp[index]), float(self._kv[index])) if on else (0.0, 0.0)
        servo = self._actuator[index]
        self.model.actuator_gainprm[servo, 0] = kp if self._state[index] < 0 else 0.0
        self.model.actuator_biasprm[servo, 1:3] = -kp, -kv
        if on and self._state[index] >= 0:
            self.data.act[self._state[index]] = self.data.qpos[self._qpos[index]]

    def set_effort_share(self, index: int, share: float) -> None:
        """Limit a servo to this share, 0..1, of its effort."""
        limit = self._effort_nm[index] * share
        self.model.actuator_forcerange[self._actuator[index]] = -limit, limit
