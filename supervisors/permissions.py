"""What each process of a tree may say to the others: in whose name, and to which actors.

The root knows whom it has started over which link; the wire has a session of its own for policies
(``policy_access``). A policy runs code of others, so it may say what a rollout needs and nothing
else. The tree's own caller knows the secret of its session and may do what an operator may; who
joins the run directory's sockets may look, stop and resume, but move nothing. What the parts of a
tree report to each other counts over their own link alone.
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
"""What a rollout tells the gate. A stop is refused to nobody."""
COMMANDS: frozenset[type[Message]] = WRITES | {Beat, Perform, Resume}
ORDERS: frozenset[type[Message]] = READS | {Stop, Resume}
"""What who writes nothing tells the gate."""


def _of(robot: str, process: str, names: tuple[str, ...], instruments: bool = True) -> frozenset[str]:
    at = addresses.of(robot)
    paths = (
        [at.path(name) for name in names]
        + [at.introspection(process)]
        + ([at.instrument(process)] if instruments else [])
    )
    return frozenset(f"{PREFIX}/{path}" for path in paths)


def of_wire(robot: str) -> Channel:
    """Return the channel whose other end is the wire process."""
    hosts = _of(robot, "wire", ("gate", "watchdog", "transport"))
    return Channel("", hosts, f"{PREFIX}/node/{robot}.wire.")


def of_root(robot: str) -> Channel:
    """Return the channel whose other end is the root process."""
    names = ("guardian", "root", "tasks", "safety", "commands", "telemetry", "pictures", "gateway", "gateway/stop")
    return Channel("", _of(robot, "root", names), f"{PREFIX}/node/{robot}.root.")


def of_standby(robot: str) -> Channel:
    """Return the channel whose other end is the standby process. It answers, and tells nobody
    anything."""
    hosts = _of(robot, "standby", ("standby",), instruments=False)
    return Channel("", hosts, f"{PREFIX}/node/{robot}.standby.", {})


def of_camera(robot: str, name: str) -> Channel:
    """Return the channel whose other end is a camera's process. It answers, and tells nobody
    anything."""
    process = f"camera/{name}"
    hosts = _of(robot, process, (process,), instruments=False)
    return Channel("", hosts, f"{PREFIX}/node/{robot}.camera.{name}.", {})


def of_policy(robot: str, name: str) -> Channel:
    """Return the channel whose other end is a policy process: in the root, and in the wire.
    ``name``: what its leases are bound to."""
    at = addresses.of(robot)
    tells: dict[str, Told] = {at.gate: WRITES, at.tasks: frozenset({TaskStatus, EpisodeKey})}
    return Channel(
        name, _of(robot, "policy", ("policy",), instruments=False), f"{PREFIX}/node/{robot}.policy.", tells
    )


def of_caller(robot: str, node: str) -> Channel:
    """Return the channel whose other end is the process that started the tree: of its link, and of
    the session that nobody enters without its secret. ``node``: its node's address. Its policy may
    be there."""
    at = addresses.of(robot)
    tells: dict[str, Told] = dict.fromkeys((at.root, at.tasks))
    tells |= {at.gate: COMMANDS, at.guardian: frozenset({Fence})}
    return Channel("", frozenset({at.policy}), node, tells | _inside(robot))


def of_user(robot: str) -> Channel:
    """Whoever comes in by a socket of the run directory, under any name: a program of this user.
    None of them has a lease, nor ends the tree or a task."""
    at = addresses.of(robot)
    tells: dict[str, Told] = {at.gate: ORDERS, at.guardian: frozenset({Fence}), at.root: frozenset({Describe})}
    tells[at.tasks] = frozenset({EpisodeState})  # a recorder says how far it is
    return Channel("a visitor", tells=tells | _inside(robot))


def of_visitors(robot: str, process: str) -> tuple[str, ...]:
    """The actors of one process that visitors reach, by address."""
    at = addresses.of(robot)
    own = {"root": (at.root, at.guardian, at.tasks), "wire": (at.gate,)}[process]
    return (*own, *(f"{PREFIX}/{path(process)}" for path in (at.introspection, at.instrument)))


def shown(robot: str) -> str:
    """Key on which visitors are told who tells whom what."""
    return f"{PREFIX}/{robot}/shown"


def _inside(robot: str) -> dict[str, Told]:
    """What recorders, and who wants to know, ask."""
    at = addresses.of(robot)
    paths = [path(process) for process in ("root", "wire") for path in (at.introspection, at.instrument)]
    return {f"{PREFIX}/{path}": None for path in paths}


@functools.lru_cache(maxsize=64)  # asked for with each setpoint
def of_elsewhere(robot: str, who: str) -> Channel:
    """Return the channel of questions to the gateway, asked by the node ``who``."""
    asks: frozenset[type[Message]] = READS | {Sync, Dated, Describe}
    return Channel(who, frozenset(), f"{PREFIX}/node/{who}", {addresses.of(robot).gateway: asks})


def of_stops_elsewhere(robot: str) -> Channel:
    """Whoever stops the robot from another host, under any name."""
    return Channel(tells={addresses.of(robot).gateway_stop: frozenset({Stop})})
