"""Test the twin's robot by itself: power, servos, control manager, the right to command, the end of a command."""

from __future__ import annotations

import pytest

from strands_actors.drivers.common.physics.body import Hand
from strands_actors.drivers.common.physics.controlled_body import LedBody
from strands_actors.drivers.rby1.commands import Command, Finish, JointPosition
from strands_actors.drivers.rby1.protocol import Control, JointOrder, Manager, ManagerOrder
from strands_actors.drivers.rby1.robots import TABLES
from strands_actors.drivers.rby1.twin.controller import Controller


class Robot(Controller):
    """A controller with its own clock."""

    def __init__(self) -> None:
        self.clock_s = 100.0
        super().__init__(TABLES.table("rby1"), now_s=lambda: self.clock_s)

    def wait(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.004)):
            self.clock_s += 0.004
            self.tick()

    def energise(self) -> None:
        assert self.power(".*", True) and self.servo(".*", JointOrder.SERVO_ON)
        self.order_manager(ManagerOrder.ENABLE)
        assert self.manager == Manager.ENABLED


class Client:
    def __init__(self) -> None:
        self.told: list[Finish] = []

    def finished(self, why: Finish) -> None:
        self.told.append(why)


def head(*rad: float, minimum_s: float = 0.1, hold_s: float = 0.3, priority: int = 1) -> Command:
    return Command({"head": JointPosition(rad, minimum_s, hold_s)}, priority)


def test_nothing_is_enabled_without_power_and_servos() -> None:
    robot = Robot()
    assert not robot.servo(".*", JointOrder.SERVO_ON), "without power"
    robot.order_manager(ManagerOrder.ENABLE)
    assert robot.manager == Manager.IDLE
    assert robot.command(Client(), head(0.1, 0.1)) is Finish.CONTROL_MANAGER_IDLE
    robot.energise()
    assert robot.command(Client(), head(0.1, 0.1)) is None


def test_names_are_regular_expressions() -> None:
    robot = Robot()
    assert robot.power("48v", True) and robot.supplies == {"5v": False, "12v": False, "24v": False, "48v": True}
    assert robot.servo("head_.*", JointOrder.SERVO_ON)
    assert [name for name, on in zip(robot.info.joints, robot.servos, strict=True) if on] == ["head_0", "head_1"]
    assert not robot.runs
    assert not robot.power("(", True) and not robot.servo("(", JointOrder.SERVO_ON)


def test_a_command_takes_its_time_and_is_held_as_long_as_it_says() -> None:
    robot, client = Robot(), Client()
    robot.energise()
    robot.command(client, head(0.2, 0.1, minimum_s=0.4, hold_s=0.3))
    robot.wait(0.2)
    assert 0.03 < robot.plant.position_rad[-2] < 0.17
    robot.wait(0.3)
    assert robot.control is Control.EXECUTING and client.told == []
    robot.wait(0.3)
    assert robot.control is Control.IDLE and client.told == [Finish.OK]
    robot.wait(1.0)
    assert robot.plant.position_rad[-2:] == pytest.approx((0.2, 0.1), abs=0.02), "its default control holds it"


def test_no_joint_turns_quicker_than_it_can() -> None:
    robot = Robot()
    robot.energise()
    robot.command(Client(), head(1.5, 0.0, minimum_s=0.01, hold_s=5.0))
    robot.wait(0.2)
    assert robot.plant.position_rad[-2] < 3.14 * 0.2 + 0.05
    robot.wait(0.8)
    assert robot.plant.position_rad[-2] == pytest.approx(1.5, abs=0.03)


def test_of_two_the_higher_priority_is_obeyed() -> None:
    robot, first, second = Robot(), Client(), Client()
    robot.energise()
    robot.command(first, head(0.2, 0.0, priority=5))
    assert robot.command(second, head(-0.2, 0.0, priority=4)) is Finish.PREEMPTED
    assert first.told == []
    assert robot.command(second, head(-0.2, 0.0, priority=5)) is None
    assert first.told == [Finish.PREEMPTED]
    robot.leave(first)
    assert robot.control is Control.EXECUTING, "it is not the first one's any more"
    robot.leave(second)
    assert robot.control is Control.IDLE and second.told == []


def test_a_target_past_the_range_is_not_begun() -> None:
    robot = Robot()
    robot.energise()
    assert robot.command(Client(), head(1.6, 0.0)) is Finish.INITIALIZED_FAILED
    assert robot.control is Control.IDLE


def test_cancel_halts_where_it_is() -> None:
    robot, client = Robot(), Client()
    robot.energise()
    robot.command(client, head(1.0, 0.0, minimum_s=1.0))
    robot.wait(0.5)
    at = robot.plant.position_rad[-2]
    robot.cancel()
    robot.wait(1.0)
    assert client.told == [Finish.CANCELED]
    assert robot.plant.position_rad[-2] == pytest.approx(at, abs=0.05)
    assert robot.manager == Manager.ENABLED


def test_the_button_takes_the_power_arms_drop_and_the_torso_stays() -> None:
    robot, client = Robot(), Client()
    robot.wait(0.5)
    rest = robot.plant.position_rad
    assert rest[9] == pytest.approx(-1.2, abs=0.01), "brakes hold what was never powered"
    robot.energise()
    robot.wait(0.5)
    robot.command(client, head(0.5, 0.0, minimum_s=1.0))
    robot.press(True)
    assert client.told == [Finish.UNEXPECTED_STATE]
    assert robot.state().pressed and not robot.state().powered and robot.manager == Manager.IDLE
    assert not robot.power("48v", True), "before it is released"
    robot.wait(2.0)
    now = robot.plant.position_rad
    assert now[:6] == pytest.approx(rest[:6], abs=0.02)
    assert abs(now[9] - rest[9]) > 0.3, "an elbow"
    robot.press(False)
    robot.energise()
    after = robot.plant.position_rad
    robot.wait(0.5)
    assert robot.plant.position_rad == pytest.approx(after, abs=0.1), "no jump when it is energised again"


def test_a_fault_ends_what_runs_until_it_is_reset() -> None:
    robot, client = Robot(), Client()
    robot.energise()
    robot.command(client, head(0.5, 0.0))
    robot.fail(Manager.MAJOR_FAULT)
    assert client.told == [Finish.CONTROL_MANAGER_FAULT]
    robot.order_manager(ManagerOrder.ENABLE)
    assert robot.command(client, head(0.5, 0.0)) is Finish.CONTROL_MANAGER_FAULT
    robot.order_manager(ManagerOrder.RESET_FAULT)
    robot.order_manager(ManagerOrder.ENABLE)
    assert robot.command(client, head(0.5, 0.0)) is None


def test_a_simulation_has_the_joints_while_nobody_drives_them() -> None:
    robot = Robot()
    body = LedBody(robot, lambda: robot.driven)
    robot.energise()
    assert set(body.hands) == {Hand.WIRE}
    body.take(True)
    assert set(body.hands) == {Hand.WIRE}, "what is energised on the wire follows the wire"
    robot.cancel()
    assert set(body.hands) == {Hand.NONE}
    body.take(True)
    body.aim([*robot.plant.position_rad[:-1], 0.4])
    robot.wait(1.0)
    assert robot.plant.position_rad[-1] == pytest.approx(0.4, abs=0.03)
    robot.command(Client(), head(0.0, 0.45))
    assert set(body.hands) == {Hand.WIRE}
    robot.wait(0.05)
    assert robot.plant.position_rad[-1] == pytest.approx(0.4, abs=0.06), "from where it is"
