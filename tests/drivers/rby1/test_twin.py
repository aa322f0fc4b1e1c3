"""Test the twin's robot by itself: power, servos, control manager, the right to command, the end of a command."""

from __future__ import annotations

import pytest

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.controlled_body import SharedBody
from strands_actors.drivers.rby1.commands import Finish, JointPosition, encode_command
from strands_actors.drivers.rby1.protocol import Control, JointOrder, Manager, ManagerOrder
from strands_actors.drivers.rby1.robots import TABLES
from strands_actors.drivers.rby1.twin.controller import Controller
from strands_actors.drivers.rby1.twin.requests import Request


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
        self.reasons: list[Finish] = []

    def finished(self, reason: Finish) -> None:
        self.reasons.append(reason)


def head(*rad: float, minimum_s: float = 0.1, hold_s: float = 0.3, priority: int = 1) -> Request:
    return Request.decode(encode_command({"head": JointPosition(rad, minimum_s, hold_s)}, priority))


def test_nothing_is_enabled_without_power_and_servos() -> None:
    robot = Robot()
    assert not robot.servo(".*", JointOrder.SERVO_ON), "servos do not start without power"
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


def test_a_command_takes_its_time_and_ends_after_its_hold_time() -> None:
    robot, client = Robot(), Client()
    robot.energise()
    robot.command(client, head(0.2, 0.1, minimum_s=0.4, hold_s=0.3))
    robot.wait(0.2)
    assert 0.03 < robot.plant.position_rad[-2] < 0.17
    robot.wait(0.3)
    assert robot.control is Control.EXECUTING and client.reasons == []
    robot.wait(0.3)
    assert robot.control is Control.IDLE and client.reasons == [Finish.OK]
    robot.wait(1.0)
    assert robot.plant.position_rad[-2:] == pytest.approx((0.2, 0.1), abs=0.02), (
        "the robot's default control holds the joint"
    )


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
    assert first.reasons == []
    assert robot.command(second, head(-0.2, 0.0, priority=5)) is None
    assert first.reasons == [Finish.PREEMPTED]
    robot.leave(first)
    assert robot.control is Control.EXECUTING, "the first client's command no longer runs"
    robot.leave(second)
    assert robot.control is Control.IDLE and second.reasons == []


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
    assert client.reasons == [Finish.CANCELED]
    assert robot.plant.position_rad[-2] == pytest.approx(at, abs=0.05)
    assert robot.manager == Manager.ENABLED


def test_the_button_takes_the_power_arms_drop_and_the_torso_stays() -> None:
    robot, client = Robot(), Client()
    robot.wait(0.5)
    rest = robot.plant.position_rad
    assert rest[9] == pytest.approx(-1.2, abs=0.01), "brakes hold a joint that was never powered"
    robot.energise()
    robot.wait(0.5)
    robot.command(client, head(0.5, 0.0, minimum_s=1.0))
    robot.press(True)
    assert client.reasons == [Finish.UNEXPECTED_STATE]
    assert robot.state().pressed and not robot.state().powered and robot.manager == Manager.IDLE
    assert not robot.power("48v", True), "power is refused before the button is released"
    robot.wait(2.0)
    now = robot.plant.position_rad
    assert now[:6] == pytest.approx(rest[:6], abs=0.02)
    assert abs(now[9] - rest[9]) > 0.3, "the elbow drops"
    robot.press(False)
    robot.energise()
    after = robot.plant.position_rad
    robot.wait(0.5)
    assert robot.plant.position_rad == pytest.approx(after, abs=0.1), (
        "the joints do not jump when they are energised again"
    )


def test_a_fault_ends_the_running_command_until_a_reset() -> None:
    robot, client = Robot(), Client()
    robot.energise()
    robot.command(client, head(0.5, 0.0))
    robot.fail(Manager.MAJOR_FAULT)
    assert client.reasons == [Finish.CONTROL_MANAGER_FAULT]
    robot.order_manager(ManagerOrder.ENABLE)
    assert robot.command(client, head(0.5, 0.0)) is Finish.CONTROL_MANAGER_FAULT
    robot.order_manager(ManagerOrder.RESET_FAULT)
    robot.order_manager(ManagerOrder.ENABLE)
    assert robot.command(client, head(0.5, 0.0)) is None


def test_the_simulation_controls_the_joints_while_no_client_does() -> None:
    robot = Robot()
    body = SharedBody(robot, lambda: robot.driven)
    robot.energise()
    assert set(body.commanders) == {Commander.WIRE}
    body.energise(True)
    assert set(body.commanders) == {Commander.WIRE}, "energised joints follow the wire"
    robot.cancel()
    assert set(body.commanders) == {Commander.NONE}
    body.energise(True)
    body.set_targets([*robot.plant.position_rad[:-1], 0.4])
    robot.wait(1.0)
    assert robot.plant.position_rad[-1] == pytest.approx(0.4, abs=0.03)
    robot.command(Client(), head(0.0, 0.45))
    assert set(body.commanders) == {Commander.WIRE}
    robot.wait(0.05)
    assert robot.plant.position_rad[-1] == pytest.approx(0.4, abs=0.06), "the joint moves on from its position"
