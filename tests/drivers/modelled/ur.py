"""Walks of a UR controller's ports."""

from __future__ import annotations

from collections.abc import Iterator

from strands_actors.drivers.ur import protocol as p
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
