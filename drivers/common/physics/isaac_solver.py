"""Compute the physics with Isaac Sim (PhysX), which needs an RTX graphics card. Only for simulated robots with
``backend="isaac"``.

This code was never run on Isaac Sim. It uses the names in the documentation of Isaac Sim 5. The tests replace Isaac
Sim by a stand-in.

The model and its state stay in MuJoCo, as with the solver Newton. So all other code of a simulation is the
same for each solver. Isaac Sim receives the model once, as an MJCF file. For each step it receives gains, targets
and torques of the joints, and returns their positions and velocities. MuJoCo computes forces and sensors from them.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from .lean_mujoco import mujoco
from .paced_solver import Paced, without_dynamics

ROBOT = "/World/robot"
"""Path of the robot in the stage."""

_app: Any = None
"""The application. It runs once in a process, and must run before any other part of Isaac Sim is imported."""


class IsaacSolver(Paced):
    """Advance one model with Isaac Sim.

    Raises:
        ImportError: Isaac Sim is not installed.
        ValueError: The model is not supported. It must be a robot on a fixed base. Each joint must have one axis,
            and its own servo or motor.
    """

    def __init__(self, spec: Any, model: Any, data: Any) -> None:
        super().__init__()
        _check(model)
        _start()
        import isaacsim.core.api
        import isaacsim.core.prims
        import isaacsim.core.utils.stage
        import isaacsim.core.utils.types

        isaacsim.core.api.World.clear_instance()
        isaacsim.core.utils.stage.create_new_stage()
        step_s = float(model.opt.timestep)
        self._world = isaacsim.core.api.World(physics_dt=step_s, rendering_dt=step_s, stage_units_in_meters=1.0)
        self._world.get_physics_context().set_gravity(float(model.opt.gravity[2]))
        with tempfile.TemporaryDirectory(prefix="strands-actors-") as folder:
            _import(_written(spec, Path(folder)))
        self._robot = self._world.scene.add(isaacsim.core.prims.SingleArticulation(prim_path=ROBOT, name="robot"))
        self._world.reset()
        self._action = isaacsim.core.utils.types.ArticulationAction
        self._to_theirs(model)
        self._sent: tuple[Any, ...] = ()
        # The state NaN differs from every real state, so the first step sends the model's state to Isaac Sim.
        self._last_state = np.full(model.nq + model.nv, np.nan)

    def _to_theirs(self, model: Any) -> None:
        """Find each joint of the MuJoCo model in Isaac Sim, which orders the joints differently. Raise
        ``ValueError`` if the names differ."""
        names = list(self._robot.dof_names)
        ours = [model.joint(joint).name for joint in range(model.njnt)]
        if sorted(names) != sorted(ours):
            raise ValueError(f"Isaac Sim's importer gave the joints {', '.join(names)}, not {', '.join(ours)}")
        self._dof = np.array([names.index(name) for name in ours])
        self._joint = np.array([int(index) for index in model.actuator_trnid[:, 0]])
        self._ctrl = np.array([int(index) for index in model.actuator_ctrladr])
        self._gear = model.actuator_gear[:, 0].copy()
        self._slewed = np.flatnonzero(np.asarray(model.actuator_actadr) >= 0)
        self._act = np.array([int(model.actuator_actadr[servo]) for servo in self._slewed], dtype=int)
        # The largest speed of each servo's target, in units per second.
        self._slew = model.actuator_dynprm[self._slewed, 1].copy()

    def step(self, model: Any, data: Any, steps: int) -> None:
        began_s, step_s = time.monotonic(), float(model.opt.timestep)
        if not np.array_equal(self._last_state, np.concatenate((data.qpos, data.qvel))):
            self._put(np.arange(model.njnt), data.qpos, data.qvel)
        kp = self._send_gains(model)
        jammed = np.flatnonzero(data.eq_active)
        stuck = np.array([int(model.eq_obj1id[constraint]) for constraint in jammed], dtype=int)
        for _ in range(steps):
            away = data.ctrl[self._ctrl[self._slewed]] - data.act[self._act]
            data.act[self._act] += np.clip(away, -self._slew * step_s, self._slew * step_s)
            self._drive(model, data, kp)
            self._world.step(render=False)
            if len(stuck):
                self._put(stuck, model.qpos0[stuck] + model.eq_data[jammed, 0], np.zeros(len(stuck)))
        data.qpos[:] = self._robot.get_joint_positions()[self._dof]
        data.qvel[:] = self._robot.get_joint_velocities()[self._dof]
        self._last_state = np.concatenate((data.qpos, data.qvel))
        data.time += steps * step_s
        mujoco.mj_forward(model, data)
        self._took(steps, began_s)

    def _put(self, joints: Any, positions: Any, velocities: Any) -> None:
        """Set positions and velocities of joints directly: after a program has changed the state (for example by a
        reset), or for jammed joints."""
        self._robot.set_joint_positions(np.asarray(positions), joint_indices=self._dof[joints])
        self._robot.set_joint_velocities(np.asarray(velocities), joint_indices=self._dof[joints])

    def _send_gains(self, model: Any) -> Any:
        """Send the gains if they have changed, for example because torque was switched. Return the stiffness of
        each servo, at its joint."""
        squared = self._gear**2
        kp = -model.actuator_biasprm[:, 1] * squared
        limit = model.actuator_forcerange[:, 1] * np.abs(self._gear)
        limited = np.flatnonzero(model.actuator_forcelimited)
        stiffness, damping = np.zeros(model.nv), model.dof_damping.copy()
        stiffness[self._joint] = kp
        damping[self._joint] -= model.actuator_biasprm[:, 2] * squared
        now = (stiffness, damping, limit[limited])
        if not self._sent or not all(map(np.array_equal, self._sent, now)):
            self._sent = now
            controller = self._robot.get_articulation_controller()
            controller.set_gains(kps=self._theirs(stiffness), kds=self._theirs(damping))
            if len(limited):
                controller.set_max_efforts(limit[limited], joint_indices=self._dof[self._joint[limited]])
        return kp

    def _drive(self, model: Any, data: Any, kp: Any) -> None:
        """Send a position target to each servo that has stiffness, and a torque to each other motor."""
        requested = model.actuator_gainprm[:, 0] * data.ctrl[self._ctrl] + model.actuator_biasprm[:, 0]
        requested[self._slewed] = -model.actuator_biasprm[self._slewed, 1] * data.act[self._act]
        requested *= self._gear
        target, effort = data.qpos.copy(), data.qfrc_applied.copy()
        stiff = kp > 0
        target[self._joint[stiff]] = requested[stiff] / kp[stiff]
        effort[self._joint[~stiff]] += requested[~stiff]
        self._robot.apply_action(
            self._action(joint_positions=self._theirs(target), joint_efforts=self._theirs(effort))
        )

    def _theirs(self, values: Any) -> Any:
        """Return values that are given in MuJoCo's joint order in the joint order of Isaac Sim."""
        ordered = np.empty(len(values))
        ordered[self._dof] = values
        return ordered


def _check(model: Any) -> None:
    """Raise ``ValueError`` for a model that Isaac Sim does not support."""
    turning = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    if not np.isin(model.jnt_type, turning).all():
        raise ValueError("backend 'isaac' takes no free bodies. Use a robot on a fixed base and static objects")
    driven = [int(joint) for joint in model.actuator_trnid[:, 0]]
    of_joints = np.isin(model.actuator_trntype, int(mujoco.mjtTrn.mjTRN_JOINT)).all()
    jams = np.isin(model.eq_type, int(mujoco.mjtEq.mjEQ_JOINT)) & (np.asarray(model.eq_obj2id) < 0)
    if not of_joints or len(set(driven)) < len(driven) or not jams.all():
        raise ValueError("backend 'isaac' takes no tendons and no coupled joints. Use one servo or motor per joint")


def _start() -> None:
    """Start Isaac Sim if it does not run. Raise ``ImportError`` if it is not installed."""
    global _app
    if _app is None:
        import isaacsim

        _app = isaacsim.SimulationApp({"headless": True})


def _written(spec: Any, folder: Path) -> str:
    """Write a model as a file for Isaac Sim's importer, with its meshes, and without the parts that only MuJoCo
    supports. Return the path."""
    theirs = without_dynamics(spec, range(len(spec.actuators)))
    for equality in list(theirs.equalities):
        theirs.delete(equality)
    for name, content in spec.assets.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    theirs.meshdir = str(folder if spec.assets else Path(spec.modelfiledir, spec.meshdir).resolve())
    theirs.compile()
    file = folder / "robot.xml"
    file.write_text(theirs.to_xml())
    return str(file)


def _import(file: str) -> None:
    """Import the model file into Isaac Sim's stage. Raise ``ValueError`` if the importer refuses it."""
    import isaacsim.core.utils.extensions

    isaacsim.core.utils.extensions.enable_extension("isaacsim.asset.importer.mjcf")
    import omni.kit.commands

    _, config = omni.kit.commands.execute("MJCFCreateImportConfig")
    config.set_fix_base(True)
    config.set_import_inertia_tensor(True)
    done, _ = omni.kit.commands.execute("MJCFCreateAsset", mjcf_path=file, import_config=config, prim_path=ROBOT)
    if not done:
        raise ValueError("Isaac Sim's importer does not accept this model. Isaac Sim's log has the reason")
