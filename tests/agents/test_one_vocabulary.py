"""For every driver, scripts and agents have the same calls. The test needs no list of them."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.caller.handle.async_robot import AsyncRobot
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.caller.handle.sim_robot import SimRobot
from strands_actors.caller.handle.vocabulary import verb_names
from strands_actors.caller.resolve.planning import plan
from strands_actors.contract.agent_verbs import undeclared, verbs_of
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.contract.tool_spec import tool_spec
from strands_actors.drivers.sim.driver import SimDriver
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import ALLOW
from strands_actors.supervisors.loading import build_driver
from strands_actors.surfaces.agents.approval import Approval, Request, approval_of
from strands_actors.surfaces.agents.calls import Call, read
from strands_actors.surfaces.agents.use import use
from tests.answers import why
from tests.motion.robots import drivers

REAL = drivers()


def every_driver() -> Iterator[tuple[str, Driver]]:
    """Yield each robot's driver, at each of its levels, and in simulation."""
    yield from REAL.items()
    for robot, driver in REAL.items():
        for name, where in type(driver).LEVELS.items():
            if name.partition(":")[0] == robot:
                walks: type[Driver] = load(where)
                yield name, walks(robot, "", walks.resolve(robot, {"level": name.partition(":")[2]}))
        if not driver.SIMULATION:
            robot_plan = plan(robot)
            yield f"{robot}:sim", build_driver(robot_plan.driver_class, robot_plan.robot, "", robot_plan.options)


DRIVERS = dict(every_driver())

SAMPLES: dict[str, Any] = {"string": "x", "number": 1.0, "boolean": True, "object": {}, "array": [90.0] * 6}


def asked(driver: Driver, name: str) -> Call:
    """Return an agent's call of this verb with all required inputs."""
    verb = next(verb for verb in verbs_of(driver) if verb.name == name)
    call = read(driver, {"action": name, **{key: SAMPLES[verb.inputs[key]["type"]] for key in verb.required}})
    assert isinstance(call, Call), call
    return call


@pytest.mark.parametrize("robot", DRIVERS)
def test_an_agent_can_ask_for_every_service_that_a_script_can_call(robot: str) -> None:
    driver = DRIVERS[robot]
    of_agents = {verb.name for verb in verbs_of(driver)}
    stops = {name for name, service in driver.SERVICES.items() if service.stops is not None}
    assert set(driver.SERVICES) - of_agents == stops - of_agents
    assert stops <= {"emergency_stop"}  # the only exception: an agent calls it `stop`
    assert {verb.name for verb in verbs_of(driver) if verb.does == "service"} <= set(driver.SERVICES)
    offered = tool_spec("tool", driver)["inputSchema"]["json"]["properties"]
    for name in undeclared(driver):
        assert name in offered["action"]["enum"]
        arguments = driver.SERVICES[name].arguments
        assert set(arguments) <= set(offered)
        assert asked(driver, name).kind == "motion"
        given = {key: SAMPLES[offered[key]["type"]] for key in arguments}
        assert isinstance(read(driver, {"action": name, **given}), Call)


@pytest.mark.parametrize("robot", DRIVERS)
def test_inputs_of_one_name_have_one_type(robot: str) -> None:
    """All verbs of a tool share one schema."""
    types: dict[str, str] = {}
    for verb in verbs_of(DRIVERS[robot]):
        for name, schema in verb.inputs.items():
            assert types.setdefault(name, schema["type"]) == schema["type"], (verb.name, name)


@pytest.mark.parametrize("robot", DRIVERS)
def test_every_verb_of_an_agent_is_a_method_of_the_handle(robot: str) -> None:
    """Services and verbs are found by ``__getattr__``. Others are methods."""
    driver = DRIVERS[robot]
    for verb in verbs_of(driver):
        by_name = verb.name in driver.SERVICES or verb.name in verb_names(driver)
        for handle in (RealRobot, SimRobot, AsyncRobot):
            assert by_name or hasattr(handle, verb.name), verb.name


HELD = [(robot, name) for robot, driver in DRIVERS.items() if not driver.SIMULATED for name in undeclared(driver)]


def tree_of(driver: Driver) -> Any:
    async def never(*_: object, **__: object) -> None:
        pytest.fail("it reached the robot")

    names = ("perform", "send_action", "stop", "resume", "status")
    return SimpleNamespace(robot=driver.robot, driver=driver, **dict.fromkeys(names, never))


@pytest.mark.parametrize(("robot", "name"), HELD)
def test_saf_014_a_service_that_is_not_declared_for_agents_needs_approval(
    robot: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(ALLOW, raising=False)
    driver = DRIVERS[robot]
    arguments = dict.fromkeys(driver.SERVICES[name].arguments, 0.1) if driver.SERVICES[name].acts else {}
    call = read(driver, {"action": name, **arguments})
    assert isinstance(call, Call)
    asked_for: list[Request] = []
    nobody = approval_of(type(driver), (), None, 1.0)
    refuses = approval_of(type(driver), (), lambda request: bool(asked_for.append(request)), 5.0)
    assert f"{name} needs an operator's approval" in why(trio.run(use, tree_of(driver), call, nobody, "agent"))
    assert "it was not given" in why(trio.run(use, tree_of(driver), call, refuses, "agent"))
    assert [request.verb for request in asked_for] == [name]


def test_there_are_such_services() -> None:
    assert {("crazyflie", "takeoff"), ("spot", "set_twist"), ("unitree_go2", "release_sport_mode")} <= set(HELD)


def test_saf_006_an_agents_emergency_stop_cuts_no_motors_in_the_air() -> None:
    call = read(DRIVERS["crazyflie"], {"action": "emergency_stop"})
    assert isinstance(call, Call) and (call.verb.name, call.kind) == ("stop", "stop")


def test_a_twist_of_zero_needs_no_approval() -> None:
    """It stops the robot."""

    async def run(twist: dict[str, float]) -> list[str]:
        done: list[str] = []

        async def send_action(action: dict[str, Any]) -> Refused:
            done.append("sent")
            return Refused("test", "a test")

        driver = DRIVERS["crazyflie"]
        tree: Any = SimpleNamespace(robot="crazyflie", driver=driver, send_action=send_action)
        call = read(driver, {"action": "set_twist", **twist})
        assert isinstance(call, Call)
        await use(tree, call, Approval(), "agent")
        return done

    assert trio.run(run, {"vx": 0.0}) == ["sent"]
    assert trio.run(run, {"vx": 0.1}) == []


def test_a_simulation_needs_no_approval() -> None:
    sims = [driver for name, driver in DRIVERS.items() if name.endswith(":sim")]
    assert sims and all(isinstance(driver, SimDriver) for driver in sims)
    assert not any(asked(driver, name).needs_approval for driver in sims for name in undeclared(driver))
    assert asked(REAL["crazyflie"], "takeoff").needs_approval
    assert not asked(DRIVERS["so101:sim"], "set_torque").needs_approval
    assert asked(REAL["so101"], "set_torque").needs_approval and asked(REAL["koch"], "set_torque").needs_approval


def test_the_refusal_of_a_service_names_the_level_that_has_it() -> None:
    refused = read(REAL["unitree_go2"], {"action": "stand_up"})
    assert isinstance(refused, Refused) and "level='low'" in refused.text and "sport" in refused.text
    refused = read(REAL["so101"], {"action": "stand_up"})
    assert (
        isinstance(refused, Refused)
        and refused.remedy == "use status, sensors, get_pose, move_to, set_torque, stop"
    )
