"""Walks of a UR controller's ports."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

from strands_actors.drivers.ur import protocol as p
from strands_actors.drivers.ur.twin import commands as c
from strands_actors.drivers.ur.twin.functions import Functions
from strands_actors.drivers.ur.twin.requests import DASHBOARD
from strands_actors.drivers.ur.twin.text_ports import Dashboard
from tests.drivers.ur.world import World

from .walk import Answer, Walk

OTHER_LINES = (
    "setuserrole operator",
    "generate flight report all",
    "generate support file /programs",
    "add to log",
    "polyscope",
    "unlock",
    "set remote control",
    "popups on",
    "",
)
OTHER_FUNCTIONS = (
    "force_mode",
    "end_force_mode",
    "servoc",
    "movec",
    "path_offset_enable",
    "set_conveyor_tick_count",
    "get_tcp_force",
    "tool_contact",
    "get_mass_matrix",
    "socket_open",
    "modbus_add_signal",
    "rpc_factory",
    "set_tool_communication",
    "encoder_enable_pulse_decode",
    "powerdown",
)


def ask_dashboard(world: World, line: str, rest: str) -> Answer:
    said = Dashboard(world.controller, "ur5e").answer(line + rest)
    reads = line.startswith(("get", "is", "poly", "robot", "safety", "running", "version", "program"))
    return Answer(not said.startswith(("could not", "File not", "Failed")), said if reads else b"")


def powered(world: World) -> None:
    world.controller.set_mode(p.RobotMode.POWER_OFF)


def idle(world: World) -> None:
    world.controller.set_mode(p.RobotMode.IDLE)


def started(world: World) -> None:
    world.start()


def protected(world: World) -> None:
    world.controller.set_safety(p.SafetyMode.PROTECTIVE_STOP)


def paused(world: World) -> None:
    world.start()
    world.controller.paused = True


def ask_function(world: World, name: str, arguments: str) -> Answer:
    world.text(f"{name}({arguments})\n")
    return Answer(not any("not available" in line for line in world.controller.log))


def ask_command(world: World, number: int, doubles: tuple[float, ...]) -> Answer:
    if world.controller.program is None:
        world.start()
    before = len(world.controller.log)
    world.command(number, *doubles)
    failed = len(world.controller.log) > before
    if failed:
        world.controller.log.clear()
    return Answer((not failed and world.controller.program is not None) or number == c.Command.STOP_SCRIPT)


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    log = frozenset(("quit", "clear operational mode", "play", "set operational mode", "load"))
    yield Walk(
        "dashboard",
        DASHBOARD,
        (*DASHBOARD.effects, *OTHER_LINES),
        World,
        ask_dashboard,
        {
            **dict.fromkeys(DASHBOARD.effects, ""),
            "load": " hold.urp",
            "popup": " text",
            "addtolog": " text",
            "set operational mode": " manual",
        },
        ("",),
        {
            "stop": started,
            "pause": started,
            "play": paused,
            "power on": powered,
            "brake release": idle,
            "unlock protective stop": protected,
        },
        # The dashboard itself keeps these: tests/drivers/ur/test_twin.py. A client sees "quit" by its connection.
        log - {"play"},
    )


def known_functions() -> set[str]:
    """Return the names of the functions that the twin carries out."""
    names = {name for name, _ in inspect.getmembers(Functions, inspect.isfunction) if not name.startswith("_")}
    return names | {"signal_async_progress"}
