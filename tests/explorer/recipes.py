"""List events that are dangerous close together, with the seconds between them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from .kinds import (
    BUS_PEER,
    CALLER,
    EXHAUSTED,
    EXHAUSTION,
    NETWORK_PEER,
    OPERATORS,
    STREAM_PEER,
    TWIN_DATAGRAMS,
    TWIN_PORTS,
    TWIN_STREAMS,
)


class Step(NamedTuple):
    """One event of a recipe.

    Attributes:
        value: Least and greatest value of the event.
    """

    kind: str
    who: tuple[str, ...]
    value: tuple[float, float] = (0.0, 0.0)
    after: str = ""


ASKERS = (CALLER, *OPERATORS)
Recipe = tuple[Step, Step, tuple[float, float]] | tuple[Step, Step, tuple[float, float], Step, tuple[float, float]]


def _lost(kind: str) -> tuple[Recipe, ...]:
    """Return recipes of verbs that end a motion while the robot cannot be reached."""
    lost = Step(kind, ("",), (0.4, 1.6))
    return (
        (lost, Step("kill", ("root",)), (0.0, 0.2), Step("cleanup", (CALLER,)), (0.0, 0.3)),
        (lost, Step("freeze", ("root",)), (0.0, 0.2), Step("cleanup", (CALLER,)), (0.0, 0.3)),
        (lost, Step("release", (CALLER,)), (0.0, 0.4)),
        (lost, Step("stop task", ASKERS), (0.0, 0.4)),
        (Step("start task", (CALLER,), (0.5, 1.0)), lost, (0.1, 0.4), Step("stop task", ASKERS), (0.0, 0.4)),
    )


def _hostile(peer: Iterable[str]) -> tuple[Recipe, ...]:
    """Return recipes of a stop or a death while a broken peer sends."""
    return tuple(
        (Step(kind, ("",), (0.2, 1.5)), then, (0.0, 0.6))
        for kind in peer
        for then in (Step("stop", ASKERS), Step("kill", (CALLER, "root", "wire")))
    )


_ARMING: tuple[Recipe, ...] = (
    *(
        (Step("stop", ASKERS), Step("resume", ASKERS), (0.03, 0.3), then, (0.0, 0.15))
        for then in (
            Step("kill", (CALLER, "root", "wire")),
            Step("freeze", (CALLER, "root", "wire"), (0.0, 0.6)),
            Step("stop", ASKERS),
            Step("estop", ASKERS),
            Step("cleanup", (CALLER,)),
        )
    ),
    (
        Step("stop", ASKERS),
        Step("kill", ("wire",), after="Resume"),
        (0.0, 0.02),
        Step("resume", ASKERS),
        (0.03, 0.3),
    ),
    (
        Step("stop", ASKERS),
        Step("freeze", ("wire",), (0.0, 0.6), "Resume"),
        (0.0, 0.02),
        Step("resume", ASKERS),
        (0.03, 0.3),
    ),
    (Step("kill", ("root",), after="StateIs"), Step("resume", ASKERS), (0.0, 0.1)),
    *(
        (Step("service", ASKERS), then, (0.0, 0.3))
        for then in (
            Step("kill", (CALLER, "root", "wire")),
            Step("freeze", (CALLER, "root", "wire"), (0.0, 0.6)),
            Step("stop", ASKERS),
            Step("estop", ASKERS),
        )
    ),
)
"""A stop or a death at any moment of a verb that energises, which may take effect late."""
_EXHAUSTED: tuple[Recipe, ...] = tuple(
    (Step(kind, EXHAUSTED), then, (0.0, 0.5))
    for kind in EXHAUSTION
    for then in (Step("kill", (CALLER, "root", "wire")), Step("freeze", ("root", "wire")), Step("stop", ASKERS))
)
_LATE: tuple[Recipe, ...] = (
    (Step("hasty stream", (CALLER,), (0.3, 0.7)), Step("freeze", ("wire",), (0.002, 0.04), "Setpoint"), (0.0, 0.2)),
    (Step("slow mesh", ("",), (0.3, 0.9)), Step("hasty stream", ASKERS, (0.3, 0.7)), (0.0, 0.1)),
)
"""Setpoints that expire on their way."""
_BUS: tuple[Recipe, ...] = (
    (Step("lose replies", ("",)), Step("stop", ASKERS), (0.5, 1.2)),
    (Step("pull", ("",), (0.1, 0.5)), Step("mute", ("",)), (0.0, 0.1)),
    (Step("mute", ("",), (0.1, 1.5)), Step("release", (CALLER,)), (0.0, 0.7)),
    (Step("lose replies", ("",), (0.05, 0.5)), Step("freeze", (CALLER,)), (0.0, 0.4)),
    (Step("unload", ("",)), Step("oneshot", (CALLER,)), (0.05, 0.7)),
    (Step("unload", ("",)), Step("release", (CALLER,)), (0.0, 0.5)),
)
_PORTS = tuple(recipe for recipe in _BUS if recipe[0].kind != "unload")
_OF_ANY_WIRE: tuple[Recipe, ...] = (
    (Step("cleanup", (CALLER,)), Step("resume", OPERATORS), (-0.01, 0.09)),
    (Step("kill", (CALLER,)), Step("resume", OPERATORS), (-0.01, 0.09)),
    (
        Step("kill", ("wire",)),
        Step("start task", (CALLER,), (0.3, 0.6)),
        (-0.02, 0.1),
        Step("stop task", ASKERS),
        (0.002, 0.03),
    ),
    (Step("slow spawner", (CALLER,), (0.9, 1.3)), Step("start task", (CALLER,), (0.5, 2.0)), (0.0, 0.01)),
    (Step("estop", ASKERS), Step("restart", (CALLER,)), (0.0, 0.3)),
    (Step("start task", (CALLER,), (0.3, 1.0)), Step("attack", ("policy",)), (0.02, 0.3)),
    (Step("attack", ("policy",)), Step("stop", ASKERS), (0.0, 0.4)),
    (
        Step("lag", ("root",), (0.005, 0.03)),
        Step("freeze", ("wire",)),
        (0.0, 0.05),
        Step("kill", ("root",)),
        (0.1, 0.15),
    ),
    (Step("kill", ("root", "wire", "standby")), Step("kill", ("root", "wire", "standby")), (0.0, 0.05)),
    (Step("freeze", ("root", "wire", "standby")), Step("kill", ("root", "wire", "standby")), (0.0, 0.05)),
    (Step("freeze", ("root", "wire")), Step("freeze", ("root", "wire")), (0.0, 0.05)),
    (Step("freeze", ("root",), (0.05, 0.3)), Step("stop", ASKERS), (0.0, 0.2)),
    (Step("freeze", (CALLER,)), Step("kill", ("root",)), (0.0, 0.15)),
)
_SERVICE: tuple[Recipe, ...] = (
    (Step("out of reach", ("",), (0.05, 1.2)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("out of reach", ("",), (0.05, 1.2)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("slow service", ("",), (0.3, 1.5)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("slow service", ("",), (0.3, 1.5)), Step("freeze", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("stop", ASKERS), Step("resume", ASKERS), (0.0, 0.4)),
    (Step("kill", ("wire", "standby")), Step("resume", ASKERS), (0.0, 0.7)),
)
_SESSION: tuple[Recipe, ...] = (
    (Step("hold replies", ("",), (0.3, 1.2)), Step("stop", ASKERS), (0.1, 1.2)),
    (Step("pull", ("",), (0.1, 0.7)), Step("stop", ASKERS), (0.0, 0.9)),
    (Step("pull", ("",), (0.1, 0.7)), Step("resume", ASKERS), (0.0, 0.9)),
    (Step("stall", ("",), (0.02, 1.0)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("stall", ("",), (0.02, 1.0)), Step("release", (CALLER,)), (0.0, 0.6)),
    (Step("stall", ("",), (0.02, 1.0)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("resume", ASKERS), Step("stall", ("",), (0.02, 1.0)), (0.0, 0.02)),
    (Step("reset", ("",)), Step("kill", ("wire", "root")), (0.0, 0.2)),
    (Step("reset", ("",)), Step("stop", ASKERS), (0.0, 0.3)),
    (Step("mute", ("",), (0.1, 1.0)), Step("release", (CALLER,)), (0.0, 0.6)),
)
_NETWORK: tuple[Recipe, ...] = (
    (Step("lose replies", ("",), (0.1, 1.2)), Step("stop", ASKERS), (0.0, 1.2)),
    (Step("pull", ("",), (0.05, 0.7)), Step("stop", ASKERS), (0.0, 0.9)),
    (Step("pull", ("",), (0.05, 0.7)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.7)),
    (Step("stall", ("",), (0.02, 1.0)), Step("stop", ASKERS), (0.0, 0.6)),
    (Step("stall", ("",), (0.02, 1.0)), Step("kill", ("wire", "root", CALLER)), (0.0, 0.6)),
    (Step("late", ("",), (0.1, 0.7)), Step("kill", ("wire", CALLER)), (0.0, 0.5)),
    (Step("drop", ("",), (0.1, 0.7)), Step("release", (CALLER,)), (0.0, 0.5)),
    (Step("brown out", ("",)), Step("stop", ASKERS), (0.0, 0.5)),
)


def groups_of(robot: str) -> tuple[tuple[Recipe, ...], ...]:
    """Return the groups of a robot's recipes. First a group is drawn, then one of its recipes."""
    match robot:
        case "so101" | "so101_lowered":
            own, lost, peer = _BUS, "pull", BUS_PEER
        case _ if robot in TWIN_PORTS:
            own, lost, peer = _PORTS, "pull", BUS_PEER
        case "xarm7" | "ur5e" | "ur5e_script":
            own, lost, peer = _SESSION, "pull", STREAM_PEER
        case _ if robot in TWIN_STREAMS:
            own, lost, peer = _SESSION, "pull", STREAM_PEER
        case "unitree_go2":
            own, lost, peer = _NETWORK, "pull", NETWORK_PEER
        case _ if robot in TWIN_DATAGRAMS:
            own, lost, peer = _NETWORK, "pull", NETWORK_PEER
        case _:
            own, lost, peer = _SERVICE, "out of reach", {}
    return (
        own,
        own,
        _OF_ANY_WIRE,
        _OF_ANY_WIRE,
        _ARMING,
        _ARMING,
        _EXHAUSTED,
        _LATE,
        _lost(lost),
        _hostile(peer) or own,
    )
