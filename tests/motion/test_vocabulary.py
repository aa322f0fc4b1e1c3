"""A script can call each command of an agent, by the same name and with the same arguments."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator

import pytest
import trio

from strands_actors import Robot, open_robot
from strands_actors.caller.handle.async_robot import AsyncRobot
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.caller.handle.sim_robot import SimRobot
from strands_actors.caller.handle.vocabulary import call_of, is_command, verb_names
from strands_actors.contract.tool_verbs import DURATION
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.agents.calls import Call
from strands_actors.testing import Twin
from tests.answers import json_of, until, why
from tests.trees import armed, connected

from .robots import drivers

DRIVERS = drivers()


@pytest.mark.parametrize("robot", DRIVERS)
def test_each_command_of_an_agent_is_a_method_of_every_handle(robot: str) -> None:
    driver = DRIVERS[robot]
    for name in filter(lambda name: is_command(driver, name), verb_names(driver)):
        assert name not in driver.SERVICES and name.isidentifier()
        for handle in (RealRobot, SimRobot, AsyncRobot):
            assert not hasattr(handle, name), "a method of the handle hides the command"


def test_argument_names_of_the_reference_are_accepted() -> None:
    """The arguments are those of the robot's own driver: ``move(linear_x, ..., duration_s)``."""
    call = call_of(DRIVERS["yahboom_m3pro"], "move", (0.2,), {"angular_z": 0.5, "duration_s": 2.0})
    assert isinstance(call, Call) and call.held_s == 2.0
    assert call.action == {"linear.x": 0.2, "linear.y": 0.0, "angular.z": 0.5}
    call = call_of(DRIVERS["earthrover"], "move", (0.5, -0.1, 3), {})
    assert isinstance(call, Call) and call.held_s == 3 and call.action == {"linear": 0.5, "angular": -0.1}
    call = call_of(DRIVERS["reachy_mini"], "goto", (), {"head_yaw": 10, "antenna_left": 20, "duration": 1.5})
    assert isinstance(call, Call) and call.held_s is None
    assert call.action == {"head_yaw": 10, "antenna_left": 20, "duration": 1.5}
    call = call_of(DRIVERS["yahboom_m3pro"], "home", (), {"time_ms": 900})
    assert isinstance(call, Call) and set(call.action) == {
        *(f"arm{at}" for at in range(1, 6)),
        "gripper",
        "time_ms",
    }


@pytest.mark.parametrize(
    ("values", "inputs", "message"),
    [
        ((0.1, 0.1, 1.0, 4), {}, "4 values were given"),
        ((0.1,), {"linear": 0.2}, "linear is given twice"),
        ((), {"speed": 0.2}, "there is no input 'speed'"),
        (("fast",), {}, "linear is 'fast'"),
    ],
)
def test_an_unknown_argument_of_a_command_is_refused(
    values: tuple[object, ...], inputs: dict[str, object], message: str
) -> None:
    refused = call_of(DRIVERS["earthrover"], "move", values, inputs)
    assert isinstance(refused, Refused) and message in refused.text, refused


def test_every_base_holds_a_move() -> None:
    holding = {robot for robot, driver in DRIVERS.items() for verb in driver.TOOL_VERBS if verb.lasts == DURATION}
    assert holding == {"earthrover", "yahboom_m3pro", "stretch", "stretch3", "spot", "crazyflie"}


@pytest.fixture(scope="module")
def rover(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[RealRobot, Twin]]:
    with Twin("earthrover", tmp_path_factory.mktemp("rover")) as twin:
        robot = Robot("earthrover", mode="real", port=twin.port)
        try:
            yield connected(robot), twin
        finally:
            robot.cleanup()


def test_a_rover_drives_for_the_given_time(rover: tuple[RealRobot, Twin]) -> None:
    robot, twin = rover
    armed(robot)
    began_ns = time.monotonic_ns()
    result = json_of(robot.move(0.3, 0.1, duration_s=1.5))
    assert result["commanded"] == {"linear": 0.3, "angular": 0.1} and result["took_s"] >= 1.4
    driving = [entry.t_ns for entry in twin.log.host("setpoint", began_ns)]
    assert driving[-1] - driving[0] > 1.2e9, "the motion lasts longer than one command"
    assert until(lambda: twin.log.host("safe", driving[-1]), "the last word is zero")
    assert "duration_s is 31" in why(robot.move(0.3, duration_s=31))
    assert why(robot.move(1.5, duration_s=1)).startswith("move: linear 1.5"), "refused before the motion begins"


def test_saf_006_a_stop_ends_a_held_move(rover: tuple[RealRobot, Twin]) -> None:
    robot, twin = rover
    armed(robot)
    began_ns = time.monotonic_ns()
    json_of(robot.move(0.3, duration_s=20.0, wait=False))
    until(lambda: len(twin.log.host("setpoint", began_ns)) > 5, "it drives")
    stopped_ns = time.monotonic_ns()
    json_of(robot.stop())
    time.sleep(0.5)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0


def test_an_agent_drives_for_as_long_as_it_asks(rover: tuple[RealRobot, Twin]) -> None:
    robot, twin = rover
    armed(robot)
    began_ns = time.monotonic_ns()
    json_of(asyncio.run(robot.use_tool({"action": "move", "linear": 0.2, "duration_s": 1.0}, "agent")))
    driving = [entry.t_ns for entry in twin.log.host("setpoint", began_ns)]
    assert driving[-1] - driving[0] > 0.7e9


def test_a_trio_program_moves_in_a_time_and_may_give_up(twin: Twin) -> None:
    async def main() -> None:
        async with open_robot("so101", "real", port=twin.port) as arm:
            here = (await arm.get_observation())["gripper"]
            there = 60.0 if here < 50 else 40.0
            json_of(await arm.move_to({"gripper": there}, seconds=0.5))
            with trio.move_on_after(0.5):
                await arm.move_to({"gripper": here}, seconds=20.0)
            assert not json_of(await arm.get_task_status())["running"], "cancelling the call ends the motion"

    trio.run(main)
