"""Test physics with a stand-in for Isaac Sim: the calls, their names and their order. This was never run on
Isaac Sim itself."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strands_actors import Robot
from strands_actors.drivers.common.physics import isaac_solver
from strands_actors.drivers.common.physics.isaac_solver import IsaacSolver
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.feetech.robots import TABLES
from tests.answers import json_of, until, why

STANDIN = Path(__file__).with_name("standin")
OWN = ("isaacsim", "omni")

CHAIN = """
<mujoco><worldbody>
<body><joint name="b" axis="0 1 0" damping="0.1"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/>
<body pos="0 0 -.4"><joint name="a" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02"/></body>
</body></worldbody>
<actuator><motor joint="a" gear="2"/><position joint="b" kp="20" kv="1" forcerange="-5 5"/></actuator></mujoco>
"""


@pytest.fixture
def isaac(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Install the stand-in for Isaac Sim, for child processes as well."""
    monkeypatch.syspath_prepend(str(STANDIN))
    monkeypatch.setattr(isaac_solver, "_app", None)
    import isaacsim

    yield isaacsim
    for name in [name for name in sys.modules if name.partition(".")[0] in OWN]:
        del sys.modules[name]


def on_isaac(plant: Plant) -> Plant:
    plant._solver = IsaacSolver(plant.spec, plant.model, plant.data)
    return plant


def test_a_motor_and_a_servo_drive_each_their_own_joint(isaac: Any) -> None:
    """The order of the joints differs from that of the actuators and that of Isaac Sim."""
    spec = mujoco.MjSpec.from_string(CHAIN)
    model = spec.compile()
    data = mujoco.MjData(model)
    solver = IsaacSolver(spec, model, data)
    data.ctrl[:] = 0.5, 0.3  # a's motor, b's servo
    solver.step(model, data, 1000)
    b, a = data.qpos
    assert (b, a) == (pytest.approx(0.3, abs=1e-3), pytest.approx(2 * 0.5 * 2.0))  # gear 2, for two seconds
    assert data.time == pytest.approx(2.0)
    (gains,) = [value for name, value in isaac.calls if name == "gains"]
    assert gains.tolist() == [20.0, 0.0] and isaac.calls[0] == ("app", {"headless": True})
    assert ("gravity", -9.81) in isaac.calls


def test_an_arm_of_ours_keeps_its_speed_lets_go_jams_and_goes_home(isaac: Any) -> None:
    arm = on_isaac(Plant.from_table(TABLES.table("so101")))
    for index in range(6):
        arm.set_torque(index, True)
    arm.set_target(0, 0.5)
    arm.step(20)
    assert 0.0 < arm.position_rad[0] < 0.1, "the joint is no faster than its servo"
    arm.step(2000)
    assert arm.position_rad[0] == pytest.approx(0.5, abs=0.01)
    arm.set_torque(0, False)
    arm.set_target(0, -0.5)
    arm.step(500)
    assert arm.position_rad[0] == pytest.approx(0.5, abs=0.01), "the released joint does not move"
    arm.set_torque(0, True)
    arm.set_stuck(0, True)
    arm.set_target(0, -0.5)
    arm.step(500)
    assert arm.position_rad[0] == pytest.approx(0.5, abs=0.01), "the seized joint does not move"
    arm.set_stuck(0, False)
    arm.go_home()
    home = arm.position_rad
    arm.step(1)
    assert np.allclose(arm.position_rad, home, atol=1e-3), "Isaac Sim has the home position"


@pytest.mark.parametrize(
    ("add", "says"),
    [
        ("<body><freejoint/><geom size='.1' mass='1'/></body>", "takes no free bodies"),
        ("<body><joint name='c'/><geom size='.1' mass='1'/></body>", "no coupled joints"),
    ],
)
def test_an_unsupported_model_is_refused_before_the_start(isaac: Any, add: str, says: str) -> None:
    text = CHAIN.replace("</worldbody>", add + "</worldbody>")
    if "coupled" in says:
        text = text.replace("</mujoco>", "<equality><joint joint1='a' joint2='c'/></equality></mujoco>")
    spec = mujoco.MjSpec.from_string(text)
    model = spec.compile()
    with pytest.raises(ValueError, match=says):
        IsaacSolver(spec, model, mujoco.MjData(model))
    assert not isaac.calls


def test_a_simulation_has_its_verbs(isaac: Any, run_dir: Path) -> None:
    def pan(steps: int) -> float:
        position: dict[str, float] = json_of(sim.step(steps))["position"]
        return position["shoulder_pan"]

    with Robot("so101", backend="isaac") as sim:
        assert json_of(sim.send_action({"shoulder_pan": 20.0}))["commanded"] == {"shoulder_pan": 20.0}
        until(lambda: abs(pan(50) - 20.0) < 1.0, "it is there")
        assert "takes no free bodies" in why(sim.add_object("cube"))
        json_of(sim.add_object("table", is_static=True, position=[0.5, 0, 0.0]))
        assert pan(1) == pytest.approx(20.0, abs=1.0)
        assert json_of(sim.reset())["position"]["shoulder_pan"] == pytest.approx(0.0, abs=1.0)
        assert pan(10) == pytest.approx(0.0, abs=1.0)
