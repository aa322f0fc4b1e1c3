"""Compute the physics with Newton's MuJoCo solver, which runs on Warp: on a graphics card, or on the processor if
there is no card. Only for simulated robots with ``backend="newton"``. Needs the extra ``[newton]``.

The model and its state stay in MuJoCo. So all other code of a simulation is the same for each solver. Before each
step the changes of the state are copied to Warp, and afterwards the motion is copied back. Warp compiles the solver
once per type of processor, in about a minute, and caches the result.

Warp's solver has no servo with a speed limit (MuJoCo's ``pid`` with ``slewmax``), which our robots need. So this
module moves the target of such a servo before each step, as MuJoCo does.
"""

from __future__ import annotations

import time
import warnings
from typing import Any

import numpy as np

from .lean_mujoco import mujoco
from .paced_solver import Paced, without_dynamics

CONTACTS, CONSTRAINTS = 128, 512
"""Room for contacts and constraints that may occur later. It is fixed when a model is taken."""

_BY_MODEL = ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange", "eq_data")
"""Fields of a model that our bodies change while it runs."""
_BY_STATE = ("qpos", "qvel", "eq_active", "qfrc_applied", "xfrc_applied", "qacc_warmstart")


class NewtonSolver(Paced):
    """Advance one model with Newton's solver.

    Raises:
        ImportError: Newton is not installed.
        ValueError: Newton's solver does not support this model.
    """

    def __init__(self, spec: Any, model: Any, data: Any) -> None:
        super().__init__()
        import newton
        import warp

        warp.config.quiet = True
        with warnings.catch_warnings():
            # Newton 1.8 was made for MuJoCo 3.17, and warns about other versions. The tests run it with MuJoCo 4.0.
            warnings.simplefilter("ignore")
            _, self._warp_mujoco = newton.solvers.SolverMuJoCo.import_mujoco()
        pid = np.asarray(model.actuator_dyntype) == mujoco.mjtDyn.mjDYN_PID
        self._limited = np.flatnonzero(pid & (np.asarray(model.actuator_actadr) >= 0))
        self._exchanged = np.flatnonzero(pid)
        # The largest speed of each servo's target, in units per second.
        self._slew = model.actuator_dynprm[self._limited, 1].copy()
        self._state = [int(model.actuator_actadr[servo]) for servo in self._limited]
        theirs = without_dynamics(spec, self._exchanged).compile()
        # A servo of type pid has two inputs, a target and a speed. This is the index of the target.
        self._ctrl = [int(index) for index in model.actuator_ctrladr]
        started = mujoco.MjData(theirs)
        mujoco.mj_forward(theirs, started)
        try:
            self._theirs = self._warp_mujoco.put_model(theirs)
        except NotImplementedError as error:
            raise ValueError(f"Newton's solver does not support this model: {error}") from None
        self._moving = self._warp_mujoco.put_data(theirs, started, nconmax=CONTACTS, njmax=CONSTRAINTS)
        self._sent: dict[str, Any] = {}
        # The first step compiles the solver, unless Warp has it in its cache.
        self._warp_mujoco.step(self._theirs, self._moving)

    def step(self, model: Any, data: Any, steps: int) -> None:
        self._send(model, data)
        step_s = float(model.opt.timestep)
        moving, began_s = self._moving, time.monotonic()
        ctrl, act = data.ctrl[self._ctrl], data.act
        _assign(moving.ctrl, ctrl)
        for _ in range(steps):
            for servo, state, slew in zip(self._limited, self._state, self._slew, strict=True):
                away = data.ctrl[self._ctrl[servo]] - act[state]
                act[state] += np.clip(away, -slew * step_s, slew * step_s)
                ctrl[servo] = act[state]
            if len(self._limited):
                _assign(moving.ctrl, ctrl)
            self._warp_mujoco.step(self._theirs, moving)
        data.qpos[:], data.qvel[:] = moving.qpos.numpy()[0], moving.qvel.numpy()[0]
        data.qacc_warmstart[:] = moving.qacc_warmstart.numpy()[0]
        data.time += steps * step_s
        # From the new positions and speeds, compute forces, sensors and the places of the bodies.
        mujoco.mj_forward(model, data)
        self._took(steps, began_s)

    def _send(self, model: Any, data: Any) -> None:
        gains = {name: getattr(model, name).copy() for name in _BY_MODEL}
        gains["actuator_gainprm"][self._exchanged, 0] = -gains["actuator_biasprm"][self._exchanged, 1]
        for name, now in gains.items():
            if name not in self._sent or not np.array_equal(self._sent[name], now):
                self._sent[name] = now
                _assign(getattr(self._theirs, name), now)
        for name in _BY_STATE:
            _assign(getattr(self._moving, name), getattr(data, name))


def _assign(array: Any, values: Any) -> None:
    """Copy values into a Warp array. Warp's arrays have one row per world (a copy of the simulation); there is a
    single world."""
    if array.size:
        array.assign(np.ascontiguousarray(values)[np.newaxis])
