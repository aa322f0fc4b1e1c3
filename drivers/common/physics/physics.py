"""The body of a simulated arm: a MuJoCo model with a position servo for each joint."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .body import Commander
from .jointed import Jointed
from .lean_mujoco import mujoco
from .model_rows import build
from .onboard import Controller, Onboard
from .touch import Touch, TouchWatch


class Plant(Jointed):
    """A simulated arm on position servos.

    A servo follows its target with at most the joint's maximum effort. In a model from a table it also keeps the
    joint's maximum speed. With torque off the servo has no gain, and gravity moves the arm. At the start torque is
    off. The joints are at ``home_rad``, or at the nearest end of their range.

    Two sides can control a joint, but only one at a time. Commands in the robot's protocol (the "wire") call
    ``set_torque`` and ``set_target``, and have priority. The simulation calls ``energise`` and
    ``set_simulation_target``, and gets only joints that no such command has energised.

    Args:
        spec: The ``MjSpec``.
        joints: Names of the joints, in the order of the indices.
        bandwidth_rad_s: Bandwidth of a servo without its own gains, in rad/s.
        home_rad: Initial position of each joint, in radians. The default is zero.
        gains: Stiffness and damping of each servo. Stiffness 0 uses the bandwidth.
        home_qpos: Initial state of the whole model, with free bodies and passive joints.
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
        self._touch_watch: TouchWatch | None = None
        self._onboard: Onboard | None = None
        super().__init__(spec, joints, solimp=[0.999, 0.9999, 0.001, 0.5, 2.0])
        self._kp = self.model.dof_M0[self._dof] * bandwidth_rad_s**2
        # With this damping gain the servo is critically damped.
        self._kv = self.model.dof_M0[self._dof] * bandwidth_rad_s * 2
        if gains:
            own = np.array([kp > 0 for kp, _ in gains])
            self._kp = np.where(own, [kp for kp, _ in gains], self._kp)
            self._kv = np.where(own, [kv for _, kv in gains], self._kv)
        self._commander = [Commander.NONE] * len(self.joints)
        self._home_rad = tuple(home_rad)
        self._home_qpos = tuple(home_qpos)
        self.go_home()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> Plant:
        """Return the simulated arm of a robot's table in ``robots.toml``."""
        joints = [joint["key"] for joint in table["joints"]]
        plant = cls(build(table), joints, float(table["bandwidth"]), table.get("home_rad", ()))
        if table.get("lowers"):
            plant.watch_touches()
        return plant

    def watch_touches(self) -> None:
        """Note from now on when a link touches the floor (``take_touches``)."""
        self._touch_watch = TouchWatch(self._solver, self.model)
        self._solver = self._touch_watch

    @property
    def watches_touches(self) -> bool:
        return self._touch_watch is not None

    def take_touches(self) -> list[Touch]:
        """Return the touches of the floor since the last call."""
        if self._touch_watch is None:
            return []
        taken, self._touch_watch.touches = self._touch_watch.touches, []
        return taken

    def balance_by(self, controller: Controller) -> None:
        """Let a controller move the joints whenever they would only hold (``hold_by_controller``)."""
        self._onboard = Onboard(self._solver, controller, self._set_simulation_targets)
        self._solver = self._onboard

    def hold_by_controller(self, on: bool) -> bool:
        """Switch the controller on board on or off. Return False if the robot has none."""
        if self._onboard is None:
            return False
        self._onboard.switch(on)
        return True

    def _set_simulation_targets(self, values: Sequence[float]) -> None:
        for index, value in enumerate(values):
            self.set_simulation_target(index, value)

    def recompile(self) -> None:
        super().recompile()
        if self._touch_watch is not None:
            self.watch_touches()
        if self._onboard is not None:
            self._onboard.solver, self._solver = self._solver, self._onboard

    def _bind(self) -> None:
        super()._bind()
        model = self.model
        self._control = [int(model.actuator_ctrladr[servo]) for servo in self._actuator]
        # Index of each servo's internal state in MuJoCo; -1 for a servo without a speed limit.
        self._state = [int(model.actuator_actadr[servo]) for servo in self._actuator]
        self._effort_nm = [float(model.actuator_forcerange[servo, 1]) for servo in self._actuator]

    def begin_anew(self) -> None:
        self.go_home()

    def go_home(self) -> None:
        """Set the arm back to its initial state. The simulated time starts at 0 again."""
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
            self._pass_to(index, Commander.NONE)
        mujoco.mj_forward(self.model, self.data)

    def _place_free_bodies(self, position: Any, turn: Any) -> None:
        """Move the free bodies of ``home_qpos`` along with the robot, which was placed at ``position``."""
        model, qpos = self.model, self.data.qpos
        for address in model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]:
            if address < len(self._home_qpos):
                moved, turned = np.zeros(3), np.zeros(4)
                mujoco.mju_rotVecQuat(moved, qpos[address : address + 3], turn)
                mujoco.mju_mulQuat(turned, turn, qpos[address + 3 : address + 7])
                qpos[address : address + 3], qpos[address + 3 : address + 7] = moved + position, turned

    @property
    def time_s(self) -> float:
        """The simulated time in seconds."""
        return float(self.data.time)

    @property
    def effort_limit_nm(self) -> list[float]:
        """Maximum torque of each servo, in Nm."""
        return list(self._effort_nm)

    def commander(self, index: int) -> Commander:
        return self._commander[index]

    def torque(self, index: int) -> bool:
        return self._commander[index] is not Commander.NONE

    def set_target(self, index: int, rad: float) -> None:
        self.data.ctrl[self._control[index]] = rad

    def set_torque(self, index: int, on: bool) -> None:
        """Switch a servo's torque, on a command in the robot's protocol. With torque on, the servo starts at the
        joint's position, not at its old target."""
        if on != (self._commander[index] is Commander.WIRE):
            self._pass_to(index, Commander.WIRE if on else Commander.NONE)

    def energise(self, index: int, on: bool) -> None:
        """Switch a servo's torque, for the simulation. With torque on, the servo holds the joint's position with
        its maximum effort."""
        if self._commander[index] is Commander.WIRE or on == (self._commander[index] is Commander.SIM):
            return
        if on:
            self.set_target(index, float(self.data.qpos[self._qpos[index]]))
            self.set_effort_share(index, 1.0)
        self._pass_to(index, Commander.SIM if on else Commander.NONE)

    def set_simulation_target(self, index: int, rad: float) -> None:
        """Set a servo's target in radians, for the simulation."""
        if self._commander[index] is Commander.SIM:
            self.set_target(index, rad)

    def push(self, nm: Sequence[float]) -> None:
        """Apply these torques to the joints, in addition to those of the servos."""
        self.data.qfrc_applied[self._dof] = nm

    def pose_of(self, body: str, offset_m: Sequence[float]) -> tuple[float, ...]:
        """Return a 4 x 4 matrix, column by column: the axes of a body, and the position of a point that is fixed to
        it."""
        rotation = self.data.body(body).xmat.reshape(3, 3)
        place = self.data.body(body).xpos + rotation @ np.asarray(offset_m)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, place
        return tuple(matrix.flatten("F").tolist())

    def _pass_to(self, index: int, commander: Commander) -> None:
        self._commander[index] = commander
        on = commander is not Commander.NONE
        kp, kv = (float(self._kp[index]), float(self._kv[index])) if on else (0.0, 0.0)
        servo = self._actuator[index]
        self.model.actuator_gainprm[servo, 0] = kp if self._state[index] < 0 else 0.0
        self.model.actuator_biasprm[servo, 1:3] = -kp, -kv
        if on and self._state[index] >= 0:
            self.data.act[self._state[index]] = self.data.qpos[self._qpos[index]]

    def set_effort_share(self, index: int, share: float) -> None:
        """Limit a servo to this share (0..1) of its maximum effort."""
        limit = self._effort_nm[index] * share
        self.model.actuator_forcerange[self._actuator[index]] = -limit, limit
