"""Test the twin's computer and body. The test controls the clock."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import pytest

from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.protocol import Command
from strands_actors.drivers.unitree.robots import TABLES, model_of
from strands_actors.drivers.unitree.rpc import Request
from strands_actors.drivers.unitree.twin import safe_state_of
from strands_actors.drivers.unitree.twin.onboard import Onboard

ROBOTS = tuple(TABLES.robots)
STEP_S = 0.002


class Twin:
    """An ``Onboard`` with a clock that the test advances."""

    def __init__(self, robot: str, **options: Any) -> None:
        self.events: list[tuple[str, str]] = []
        self.model = model_of(robot)
        self.onboard = Onboard(self.model, lambda kind, text: self.events.append((kind, text)), **options)
        self.now_s = 100.0
        self.onboard.advance(self.now_s)
        self.home = self.onboard.state().q

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            self.onboard.advance(self.now_s)

    def command(self, q: Sequence[float], kp: float = 0.0, kd: float = 0.0, tau: float = 0.0) -> Command:
        count = len(self.model.joints)
        modes = tuple(joint.mode for joint in self.model.joints)
        zero = (0.0,) * count
        command = Command(self.onboard.machine, modes, tuple(q), zero, (tau,) * count, (kp,) * count, (kd,) * count)
        self.onboard.command(command, self.now_s)
        return command

    def ask(self, service: str, api: int, **parameter: Any) -> Any:
        response = self.onboard.serve(service, Request(1, api, json.dumps(parameter)))
        return None if response is None else (response.code, rpc.parsed(response.data or "{}"))

    @property
    def fell(self) -> bool:
        return any(kind == "fell" for kind, _ in self.events)


@pytest.mark.parametrize("robot", ROBOTS)
def test_it_stands_by_its_own_controller(robot: str) -> None:
    twin = Twin(robot)
    twin.run(3.0)
    assert not twin.fell
    state = twin.onboard.state()
    assert max(abs(dq) for dq in state.dq) < 0.1
    assert sum(axis * axis for axis in state.accelerometer) ** 0.5 == pytest.approx(9.81, abs=0.3)


def test_a_g1_stands_by_a_pd_policy() -> None:
    twin = Twin("unitree_g1")
    for _ in range(1500):
        twin.command(twin.home, kp=200.0, kd=6.0)
        twin.run(STEP_S)
    assert not twin.fell
    assert twin.onboard.body.height_m == pytest.approx(0.79, abs=0.02)


def test_without_torque_it_falls_and_damped_it_falls_later() -> None:
    """The figures are on the driver's page: how each safe state ends."""
    fallen_s: dict[str, float] = {}
    for safe_state, kd in (("zero_torque", 0.0), ("damp", 3.0)):
        twin = Twin("unitree_g1")
        twin.command(twin.home, kp=200.0, kd=6.0)
        twin.run(0.5)
        twin.command((0.0,) * 29, kd=kd)
        began_s = twin.now_s
        while not twin.fell:
            twin.run(STEP_S)
            assert twin.now_s < began_s + 5.0
        fallen_s[safe_state] = twin.now_s - began_s
    assert 0.3 < fallen_s["zero_torque"] < 0.7
    assert fallen_s["damp"] > 1.3 * fallen_s["zero_torque"]


def test_a_frame_without_torque_shows_its_safe_state() -> None:
    twin = Twin("unitree_g1")
    assert safe_state_of(twin.command(twin.home)) == "zero_torque"
    assert safe_state_of(twin.command(twin.home, kd=2.0)) == "damp"
    assert safe_state_of(twin.command(twin.home, kp=1.0)) == ""
    assert safe_state_of(twin.command(twin.home, tau=-1.0)) == ""


@pytest.mark.parametrize("fsm", [0, 1, 3, 702])
def test_a_g1_obeys_commands_in_three_states_only(fsm: int) -> None:
    twin = Twin("unitree_g1")
    twin.onboard.set_fsm(fsm)
    twin.command(twin.home, kp=200.0, kd=6.0)
    twin.run(3.0)
    assert twin.onboard.body.fallen  # it does not stand in these states
    assert ("fsm", str(fsm)) in twin.events


def test_a_change_of_state_ends_the_command() -> None:
    twin = Twin("unitree_g1")
    twin.command(twin.home)  # limp
    twin.onboard.set_fsm(500)
    twin.run(2.0)
    assert not twin.fell  # it stands by itself again


def test_a_quadruped_obeys_once_its_mode_is_released() -> None:
    twin = Twin("unitree_go2")
    twin.command(twin.home)
    twin.run(1.0)
    assert not twin.fell
    assert twin.ask("motion_switcher", rpc.CHECK_MODE) == (0, {"form": "0", "name": "normal"})
    assert twin.ask("motion_switcher", rpc.RELEASE_MODE) == (0, {})
    assert twin.ask("motion_switcher", rpc.CHECK_MODE) == (0, {"form": "0", "name": ""})
    twin.command(twin.home)
    twin.run(1.0)
    assert twin.fell


def test_a_released_mode_no_longer_answers() -> None:
    twin = Twin("unitree_g1")
    assert twin.ask("sport", rpc.GET_FSM_ID) == (0, {"data": 801})
    assert twin.ask("sport", rpc.SET_FSM_ID, data=1) == (0, {})
    assert twin.ask("sport", rpc.GET_FSM_ID) == (0, {"data": 1})
    assert twin.ask("sport", rpc.SET_VELOCITY, velocity=[0.1, 0, 0], duration=1.0) == (0, {})
    assert twin.ask("sport", rpc.SET_VELOCITY, velocity=[0.1]) == (rpc.BAD_DATA, {})
    assert twin.ask("sport", rpc.SET_FSM_ID, state=1) == (rpc.BAD_DATA, {})
    assert twin.ask("sport", 4711) == (rpc.NOT_IMPLEMENTED, {})
    twin.ask("motion_switcher", rpc.RELEASE_MODE)
    assert twin.ask("sport", rpc.GET_FSM_ID) is None
    twin.ask("motion_switcher", rpc.SELECT_MODE, name="ai")
    assert twin.ask("sport", rpc.GET_FSM_ID) == (0, {"data": 1})


def test_silence_damps_if_the_option_is_set() -> None:
    twin = Twin("unitree_g1", silence_s=0.1)
    twin.command(twin.home, kp=200.0, kd=6.0)
    twin.run(0.09)
    assert ("silence", "") not in twin.events
    twin.run(0.03)
    assert ("silence", "") in twin.events
    twin.run(3.0)
    assert twin.fell


def test_a_motor_without_supply_gives_nothing() -> None:
    twin = Twin("unitree_g1")
    elbow = twin.model.axes.index("left_elbow")
    twin.onboard.body.set_off(elbow, True)
    twin.command(twin.home, kp=200.0, kd=6.0)
    twin.run(1.0)
    assert twin.onboard.state().tau[elbow] == 0.0
    assert any(twin.onboard.state().tau)


def test_a_seized_joint_does_not_move() -> None:
    twin = Twin("unitree_go2")
    twin.ask("motion_switcher", rpc.RELEASE_MODE)
    calf = twin.model.axes.index("FR_calf_joint")
    twin.onboard.body.set_stuck(calf, True)
    twin.command([rad + 0.4 for rad in twin.home], kp=60.0, kd=5.0)
    twin.run(0.5)
    assert twin.onboard.state().q[calf] == pytest.approx(twin.home[calf], abs=0.1)
    other = twin.model.axes.index("FL_calf_joint")
    assert abs(twin.onboard.state().q[other] - twin.home[other]) > 0.2


def test_the_body_knows_its_joints_by_name() -> None:
    """The model's tree begins with the left legs, the wire of a Go2 with the right ones."""
    twin = Twin("unitree_go2")
    twin.ask("motion_switcher", rpc.RELEASE_MODE)
    target = list(twin.home)
    moved = twin.model.axes.index("RR_hip_joint")
    target[moved] += 0.3
    twin.command(target, kp=60.0, kd=5.0)
    twin.run(0.3)
    moves = [abs(now - before) for now, before in zip(twin.onboard.state().q, twin.home, strict=True)]
    assert max(range(len(moves)), key=moves.__getitem__) == moved


@pytest.mark.parametrize(("robot", "kg"), [
    ("unitree_g1", 33.34), ("unitree_go2", 15.2), ("unitree_h1", 51.4), ("unitree_h1_2", 67.0), ("b2", 83.5),
])  # fmt: skip
def test_the_model_has_the_robots_weight(robot: str, kg: float) -> None:
    assert float(sum(Twin(robot).onboard.body.model.body_mass)) == pytest.approx(kg, abs=0.05)


def test_a_command_for_another_machine_is_ignored() -> None:
    twin = Twin("unitree_g1")
    right = twin.command(twin.home, kp=200.0, kd=6.0)
    limp = right._replace(kp=(0.0,) * 29, kd=(0.0,) * 29)
    twin.onboard.command(limp._replace(machine=9), twin.now_s)
    twin.run(2.0)
    assert not twin.fell
    twin.onboard.command(limp, twin.now_s)
    twin.run(2.0)
    assert twin.fell
