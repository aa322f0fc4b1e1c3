"""Simulations on Newton's solver have the same verbs and the same motion as on MuJoCo.

Run it separately with ``python -m tests newton``. Warp compiles its solver for a minute the first time and
is installed on few machines. Needs ``pip install 'strands-actors[newton]'``.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from strands_actors import Robot, register_robot
from strands_actors.drivers.common.physics.jointed import Jointed
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.newton_solver import NewtonSolver
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.solver import MujocoSolver, Solver
from strands_actors.drivers.feetech.robots import TABLES

CHAIN = """
<mujoco><option timestep="0.002" integrator="implicitfast"/><worldbody>
<body><joint name="a" axis="0 1 0" damping="0.1"/><geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/>
<body pos="0 0 -0.4"><joint name="b" axis="0 1 0" damping="0.1" range="-90 90"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02"/></body></body>
</worldbody><actuator><position joint="a" kp="20" kv="1"/></actuator></mujoco>
"""
STEPS = 520


def on_newton(body: Jointed) -> Jointed:
    body._solver = NewtonSolver(body.spec, body.model, body.data)
    return body


def test_a_chain_moves_as_in_mujoco() -> None:
    spec = mujoco.MjSpec.from_string(CHAIN)
    model = spec.compile()
    ends = []
    for newton in (True, False):
        data = mujoco.MjData(model)
        data.qpos[:], data.ctrl[0] = (0.5, 0.2), 1.0
        solver: Solver = NewtonSolver(spec, model, data) if newton else MujocoSolver()
        solver.step(model, data, STEPS)
        ends.append(data.qpos.copy())
    assert np.abs(ends[0] - ends[1]).max() < 1e-4
    assert abs(ends[0][0] - 0.5) > 0.1


def test_an_arm_of_ours_moves_as_in_mujoco_and_lets_go() -> None:
    """Its servos have a speed limit, and their gains are switched on and off."""

    def moved(arm: Jointed) -> list[tuple[float, ...]]:
        assert isinstance(arm, Plant)
        seen = []
        for index in range(6):
            arm.set_torque(index, True)
        arm.set_target(0, 0.5)
        for limp in (False, True):
            arm.set_torque(1, not limp)
            arm.step(100)
            seen.append(arm.position_rad)
        return seen

    table = TABLES.table("so101")
    ours, theirs = moved(Plant.from_table(table)), moved(on_newton(Plant.from_table(table)))
    assert np.abs(np.subtract(ours, theirs)).max() < 2e-3
    assert theirs[1][1] > theirs[0][1] + 0.05, "the limp joint has fallen"


def test_a_robot_takes_actions_and_steps(tmp_path: Path) -> None:
    model = tmp_path / "chain.xml"
    model.write_text(CHAIN)
    register_robot("chain_on_newton", model_xml=str(model))
    with Robot("chain_on_newton", backend="newton") as sim:
        assert sim.send_action({"a": 0.6})["status"] == "success"
        before_s = time.monotonic()
        while sim.get_observation().get("a", 0.0) < 0.05:  # empty while a busy processor is late
            sim.step(20)
            assert time.monotonic() < before_s + 240.0
