"""Test the twin's controller. The test controls the clock."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin.model import HOME_RAD
from strands_actors.drivers.ur.twin.script import program_of
from strands_actors.drivers.ur.twin.text_ports import Dashboard
from tests.drivers.ur.world import SCRIPT, World


@pytest.fixture
def world() -> Iterator[World]:
    yield World()


def test_a_program_takes_its_time_to_start(world: World) -> None:
    world.controller.start_program(program_of(SCRIPT, world.controller))
    world.run(0.02)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    world.run(0.1)
    assert world.answer == c.READY


def test_servo_follows_and_keeps_the_last_goal(world: World) -> None:
    world.start()
    world.command(c.Command.SERVO_J, 0.2, *HOME_RAD[1:])
    assert world.answer == c.READY
    world.run(1.0)
    assert abs(world.pan - 0.2) < 0.01


def test_servo_stop_stops_and_reports_done(world: World) -> None:
    world.start()
    for step in range(1, 51):
        world.command(c.Command.SERVO_J, 0.02 * step, *HOME_RAD[1:])
        world.run(0.006)
    world.command(c.Command.SERVO_STOP, 10.0)
    assert world.answer == c.READY, "the stop is done after the braking time"
    world.run(0.5)
    assert world.answer == c.DONE
    stood = world.pan
    assert 0.3 < stood < 1.5
    world.run(0.5)
    assert abs(world.pan - stood) < 1e-3
    world.command(c.Command.NONE)
    assert world.answer == c.READY


def test_speed_never_expires_by_itself(world: World) -> None:
    world.start()
    world.command(c.Command.SPEED_J, 0.2, 0, 0, 0, 0, 0, 5.0)
    world.run(2.0)
    assert abs(world.pan - 0.4) < 0.05


def test_speeds_that_are_streamed_add_up_and_accelerate(world: World) -> None:
    """As speedj_example of ur-rtde: each cycle a little faster, for two seconds."""
    world.start()
    for number in range(1000):
        world.command(c.Command.SPEED_J, 0.0005 * number, 0, 0, 0, 0, 0, 0.5)
        world.run(0.002)
    assert abs(world.pan - 0.5) < 0.03
    world.command(c.Command.SPEED_J, 0, 0, 0, 0, 0, 0, 0.5)
    world.run(2.0)
    assert abs(world.pan - 0.75) < 0.03, "it brakes for a second"


def test_move_is_done_when_it_is_there(world: World) -> None:
    world.start()
    world.command(c.Command.MOVE_J, 0.3, *HOME_RAD[1:], 1.0, 1.0)
    world.run(0.1)
    assert world.answer == c.READY
    world.run(2.0)
    assert world.answer == c.DONE
    assert abs(world.pan - 0.3) < 0.005


def test_saf_013_the_watchdog_stops_the_program(world: World) -> None:
    world.start()
    world.command(c.Command.SET_WATCHDOG, 10.0)
    world.command(c.Command.SPEED_J, 0.5, 0, 0, 0, 0, 0, 5.0)
    world.run(0.08)
    assert world.controller.runtime_state == p.RuntimeState.PLAYING
    world.run(0.04)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    assert world.events == ["watchdog"]
    stood = world.run(0.3), world.pan
    world.run(0.5)
    assert abs(world.pan - stood[1]) < 1e-3


def test_a_watchdog_that_is_fed_lets_it_go_on(world: World) -> None:
    world.start()
    world.command(c.Command.SET_WATCHDOG, 10.0)
    world.run(0.5, feed=True)
    assert world.controller.runtime_state == p.RuntimeState.PLAYING


@pytest.mark.parametrize("mode", [mode for mode in p.SafetyMode if mode not in p.MOVABLE_SAFETY])
def test_a_safety_stop_ends_the_program_and_takes_no_other(world: World, mode: p.SafetyMode) -> None:
    world.start()
    world.command(c.Command.SPEED_J, 0.5, 0, 0, 0, 0, 0, 5.0)
    world.run(0.2)
    world.controller.set_safety(mode)
    world.run(0.3)
    stood = world.pan
    world.controller.start_program(program_of(SCRIPT, world.controller))
    world.run(0.5)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    assert abs(world.pan - stood) < 1e-3
    world.controller.set_safety(p.SafetyMode.NORMAL)
    world.run(0.5)
    assert abs(world.pan - stood) < 1e-3, "no motion continues by itself"


def test_brakes_hold_the_arm_without_power(world: World) -> None:
    world.controller.set_mode(p.RobotMode.POWER_OFF)
    world.run(1.0)
    assert all(abs(a - b) < 1e-2 for a, b in zip(world.controller.plant.position_rad, HOME_RAD, strict=True))


def test_stopj_replaces_the_program(world: World) -> None:
    world.start()
    world.command(c.Command.SPEED_J, 0.5, 0, 0, 0, 0, 0, 5.0)
    world.run(0.2)
    world.controller.start_program(program_of(p.STOP_SCRIPT, world.controller))
    world.run(1.0)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    assert world.controller.is_steady()


def test_the_dashboard_brings_the_arm_up(world: World) -> None:
    dashboard = Dashboard(world.controller, "ur5e")
    assert dashboard.answer("power off") == "Powering off"
    assert dashboard.answer("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.answer("power on") == "Powering on"
    assert dashboard.answer("brake release") == "Brake releasing"
    assert dashboard.answer("robotmode") == "Robotmode: RUNNING"
    world.start()
    assert dashboard.answer("running") == "Program running: true"
    assert dashboard.answer("stop") == p.DASHBOARD_STOPPED
    assert dashboard.answer("running") == "Program running: false"
    world.controller.set_safety(p.SafetyMode.PROTECTIVE_STOP)
    assert dashboard.answer("safetymode") == "Safetymode: PROTECTIVE_STOP"
    dashboard.answer("unlock protective stop")
    assert dashboard.answer("safetymode") == "Safetymode: NORMAL"
    assert "could not understand" in dashboard.answer("dance")


def test_a_pause_ends_with_its_program(world: World) -> None:
    dashboard = Dashboard(world.controller, "ur5e")
    assert dashboard.answer("pause") == "Failed to execute: pause"
    world.start()
    assert dashboard.answer("pause") == "Pausing program"
    assert dashboard.answer("programState").startswith("PAUSED")
    assert dashboard.answer("stop") == p.DASHBOARD_STOPPED
    world.start()
    dashboard.answer("pause")
    world.controller.start_program(program_of(p.STOP_SCRIPT, world.controller))
    world.run(1.0)
    assert dashboard.answer("programState").startswith("STOPPED"), (
        "a program that replaces a paused one is not paused"
    )
    world.start()
    world.command(c.Command.SERVO_J, 0.2, *HOME_RAD[1:])
    dashboard.answer("pause")
    world.run(0.5)
    stood = world.pan
    assert dashboard.answer("play") == "Starting program"
    world.run(1.0)
    assert abs(world.pan - 0.2) < 0.01 < abs(stood - 0.2), "after play the program goes on"


def test_local_control_takes_no_programs(world: World) -> None:
    world.controller.remote = False
    world.controller.start_program(program_of(SCRIPT, world.controller))
    world.run(0.2)
    assert world.controller.runtime_state == p.RuntimeState.STOPPED
    assert "local control" in world.controller.log[-1]


def test_the_dashboard_answers_its_other_lines(world: World) -> None:
    dashboard = Dashboard(world.controller, "ur5e")
    assert dashboard.answer("get loaded program") == "No program loaded"
    assert dashboard.answer("play") == "Failed to execute: play"
    assert dashboard.answer("load none.urp") == "File not found: none.urp"
    assert dashboard.answer("load hold.urp") == "Loading program: hold.urp"
    assert dashboard.answer("get loaded program") == "Loaded program: /programs/hold.urp"
    assert dashboard.answer("isProgramSaved") == "true hold.urp"
    assert dashboard.answer("play") == "Starting program"
    world.run(0.1)
    assert dashboard.answer("programState") == "PLAYING hold.urp"
    assert dashboard.answer("popup look here") == "showing popup"
    assert dashboard.answer("addToLog said so") == "Added log message"
    assert list(world.controller.log)[-2:] == ["popup: look here", "said so"]
    assert dashboard.answer("addToLog") == "No log message to add"
    assert dashboard.answer("get operational mode") == "NONE"
    assert dashboard.answer("set operational mode automatic") == "Operational mode 'automatic' is set"
    assert dashboard.answer("get operational mode") == "AUTOMATIC"
    assert "Failed" in dashboard.answer("set operational mode sideways")
    assert "NONE" in dashboard.answer("clear operational mode")
    assert dashboard.answer("load installation default.installation").startswith("Loading installation")
    assert dashboard.answer("version").startswith("5.")
    for line in ("setUserRole operator", "generate flight report all", "generate support file /programs"):
        assert dashboard.answer(line) == f"could not understand: '{line}'"
    assert dashboard.answer("restart safety") == "Restarting safety"
    assert dashboard.answer("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.answer("shutdown") == "Shutting down"
