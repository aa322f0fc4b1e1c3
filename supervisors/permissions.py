"""The messages that each process of a tree may send to the others.

    sender                                 may send
    root, wire, standby, cameras           their own messages, over their own links only
    policy process                         the messages of a rollout (it runs user code)
    caller, by the secret of its session   the orders of an operator
    visitor, by the run directory          questions, stops and resumes, but no motion
    other host                             questions to the gateway, and stops

The root knows which process is at the other end of a link, since it has started it. The wire has a session for
policies (``policy_access``).
"""

from __future__ import annotations

import functools

from strands_actors.kernel.channels.permissions import Channel, Told
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import PREFIX
from strands_actors.supervisors.gate.messages import (
    Acquire,
    Beat,
    GetObservation,
    GetSafety,
    GetStatus,
    Perform,
    Release,
    Resume,
    Setpoint,
    Stop,
)
from strands_actors.supervisors.root.messages import Describe, EpisodeKey, EpisodeState, Fence, TaskStatus

from . import addresses
from .mesh.gateway_messages import Dated, Sync

READS: frozenset[type[Message]] = frozenset({GetObservation, GetSafety, GetStatus})
WRITES: frozenset[type[Message]] = READS | {Setpoint, Acquire, Release, Stop}
"""The messages of a rollout to the gate. Every sender may send a stop."""
COMMANDS: frozenset[type[Message]] = WRITES | {Beat, Perform, Resume}
ORDERS: frozenset[type[Message]] = READS | {Stop, Resume}
"""The messages to the gate from senders that write nothing."""


def _of(robot: str, process: str, names: tuple[str, ...], instruments: bool = True) -> frozenset[str]:
    at = addresses.of(robot)
    paths = (
        [at.path(name) for name in names]
        + [at.introspection(process)]
        + ([at.instrument(process)] if instruments else [])
    )
    return frozenset(f"{PREFIX}/{path}" for path in paths)


def of_wire(robot: str) -> Channel:
    """Return the permissions of the wire process."""
    hosts = _of(robot, "wire", ("gate", "watchdog", "transport"))
    return Channel("", hosts, f"{PREFIX}/node/{robot}.wire.")


def of_root(robot: str) -> Channel:
    """Return the permissions of the root process."""
    names = ("guardian", "root", "tasks", "safety", "commands", "telemetry", "pictures", "gateway", "gateway/stop")
    return Channel("", _of(robot, "root", names), f"{PREFIX}/node/{robot}.root.")


def of_standby(robot: str) -> Channel:
    """Return the permissions of the standby process. It only sends replies."""
    hosts = _of(robot, "standby", ("standby",), instruments=False)
    return Channel("", hosts, f"{PREFIX}/node/{robot}.standby.", {})


def of_camera(robot: str, name: str) -> Channel:
    """Return the permissions of a camera's process. It only sends replies."""
    process = f"camera/{name}"
    hosts = _of(robot, process, (process,), instruments=False)
    return Channel("", hosts, f"{PREFIX}/node/{robot}.camera.{name}.", {})


def of_policy(robot: str, name: str) -> Channel:
    """Return the permissions of a policy process, for the root and the wire. Its leases are bound to ``name``."""
    at = addresses.of(robot)
    tells: dict[str, Told] = {at.gate: WRITES, at.tasks: frozenset({TaskStatus, EpisodeKey})}
    return Channel(
        name, _of(robot, "policy", ("policy",), instruments=False), f"{PREFIX}/node/{robot}.policy.", tells
    )


def of_caller(robot: str, node: str) -> Channel:
    """Return the permissions of the process that started the tree, over its link, and over its session, which
    needs a secret. ``node`` is the address of its node. A policy object may run there."""
    at = addresses.of(robot)
    tells: dict[str, Told] = dict.fromkeys((at.root, at.tasks))
    tells |= {at.gate: COMMANDS, at.guardian: frozenset({Fence})}
    return Channel("", frozenset({at.policy}), node, tells | _inside(robot))


def of_user(robot: str) -> Channel:
    """Return the permissions of visitors: programs of the same user that connect to a socket of the run
    directory, under any name. They get no lease, and end neither the tree nor a task."""
    at = addresses.of(robot)
    tells: dict[str, Told] = {at.gate: ORDERS, at.guardian: frozenset({Fence}), at.root: frozenset({Describe})}
    tells[at.tasks] = frozenset({EpisodeState})  # progress of a recorder
    return Channel("a visitor", tells=tells | _inside(robot))


def of_visitors(robot: str, process: str) -> tuple[str, ...]:
    """Return the addresses of the actors in one process that visitors can reach."""
    at = addresses.of(robot)
    own = {"root": (at.root, at.guardian, at.tasks), "wire": (at.gate,)}[process]
    return (*own, *(f"{PREFIX}/{path(process)}" for path in (at.introspection, at.instrument)))


def shown(robot: str) -> str:
    """Return the topic of the trace: sender, receiver and type of every message."""
    return f"{PREFIX}/{robot}/shown"


def _inside(robot: str) -> dict[str, Told]:
    """Return the addresses that recorders and `strands-actors tree` ask."""
    at = addresses.of(robot)
    paths = [path(process) for process in ("root", "wire") for path in (at.introspection, at.instrument)]
    return {f"{PREFIX}/{path}": None for path in paths}


@functools.lru_cache(maxsize=64)  # needed for each setpoint
def of_elsewhere(robot: str, who: str) -> Channel:
    """Return the permissions of the node ``who`` for questions to the gateway."""
    asks: frozenset[type[Message]] = READS | {Sync, Dated, Describe}
    return Channel(who, frozenset(), f"{PREFIX}/node/{who}", {addresses.of(robot).gateway: asks})


def of_stops_elsewhere(robot: str) -> Channel:
    """Return the permissions for stops from other hosts, under any name."""
    return Channel(tells={addresses.of(robot).gateway_stop: frozenset({Stop})})
