"""Define which messages each process of a robot may send to the others.

    sender                                 may send
    root, wire, standby, cameras           their own messages, over their own links only
    policy process                         the messages of a policy run (the process runs user code)
    caller (the user's script)             all orders of an operator; its session needs a secret
    visitor (a program of the same user)   questions, stops and resumes, but no motion
    attached program (of the same user)    orders of an operator, to a robot that a host keeps
    other host                             questions to the gateway, and stops

The root knows which process is at the other end of a link, since it has started that process. The wire process has
a separate session for policies (``policy_access``).
"""

from __future__ import annotations

import functools

from strands_actors.kernel.channels.permissions import Channel, MessageTypes
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
from strands_actors.supervisors.root.messages import (
    AttachProgram,
    Describe,
    EpisodeKey,
    EpisodeState,
    Fence,
    GetState,
    TaskStatus,
)

from . import addresses
from .mesh.gateway_messages import Dated, Sync

READS: frozenset[type[Message]] = frozenset({GetObservation, GetSafety, GetStatus})
WRITES: frozenset[type[Message]] = READS | {Setpoint, Acquire, Release, Stop}
"""The messages that a policy may send to the gate. Every sender may send a stop."""
COMMANDS: frozenset[type[Message]] = WRITES | {Beat, Perform, Resume}
ORDERS: frozenset[type[Message]] = READS | {Stop, Resume}
"""The messages to the gate from senders that may not move the robot."""


def _of(robot: str, process: str, names: tuple[str, ...], instruments: bool = True) -> frozenset[str]:
    actors = addresses.of(robot)
    paths = (
        [actors.path(name) for name in names]
        + [actors.introspection(process)]
        + ([actors.instrument(process)] if instruments else [])
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
    """Return the permissions of the standby process. It may only send replies."""
    hosts = _of(robot, "standby", ("standby",), instruments=False)
    return Channel("", hosts, f"{PREFIX}/node/{robot}.standby.", {})


def of_camera(robot: str, name: str) -> Channel:
    """Return the permissions of the process of a camera. It may only send replies."""
    process = f"camera/{name}"
    hosts = _of(robot, process, (process,), instruments=False)
    return Channel("", hosts, f"{PREFIX}/node/{robot}.camera.{name}.", {})


def of_policy(robot: str, name: str) -> Channel:
    """Return the permissions of a policy process, for the root and the wire. The gate accepts its leases only on
    the link with this ``name``."""
    actors = addresses.of(robot)
    tells: dict[str, MessageTypes] = {actors.gate: WRITES, actors.tasks: frozenset({TaskStatus, EpisodeKey})}
    return Channel(
        name, _of(robot, "policy", ("policy",), instruments=False), f"{PREFIX}/node/{robot}.policy.", tells
    )


def of_caller(robot: str, node: str) -> Channel:
    """Return the permissions of the script that started the robot. It uses its link to the root, or a session that
    needs a secret. ``node`` is the script's address. A policy object may run in the script."""
    actors = addresses.of(robot)
    tells: dict[str, MessageTypes] = dict.fromkeys((actors.root, actors.tasks))
    tells |= {actors.gate: COMMANDS, actors.guardian: frozenset({Fence, GetState})}
    return Channel("", frozenset({actors.policy}), node, tells | _inside(robot))


def of_user(robot: str) -> Channel:
    """Return the permissions of visitors. These are programs of the same user that connect to a socket in the run
    directory. They may use any name. They get no lease, and cannot end the robot's processes or a task."""
    actors = addresses.of(robot)
    tells: dict[str, MessageTypes] = {
        actors.gate: ORDERS,
        actors.guardian: frozenset({Fence}),
        actors.root: frozenset({Describe}),
    }
    # The recorder reports the progress of an episode.
    tells[actors.tasks] = frozenset({EpisodeState})
    return Channel("a visitor", tells=tells | _inside(robot))


def of_attached(robot: str) -> Channel:
    """Return the permissions of the programs of the same user at the sockets of a robot that a host keeps. They may
    use any name. They may command the robot, under a lease, and run policies. They cannot end the robot's
    processes."""
    actors = addresses.of(robot)
    tells: dict[str, MessageTypes] = {
        actors.gate: COMMANDS,
        actors.guardian: frozenset({Fence}),
        actors.root: frozenset({Describe, AttachProgram}),
        actors.tasks: None,
    }
    return Channel("", tells=tells | _inside(robot))


def of_guests(robot: str, is_hosted: bool) -> Channel:
    """Return the permissions of other programs of the same user, at the sockets in the run directory."""
    return of_attached(robot) if is_hosted else of_user(robot)


def of_visitors(robot: str, process: str) -> tuple[str, ...]:
    """Return the addresses of the actors of one process that visitors may send messages to."""
    actors = addresses.of(robot)
    own = {"root": (actors.root, actors.guardian, actors.tasks), "wire": (actors.gate,)}[process]
    return (*own, *(f"{PREFIX}/{path(process)}" for path in (actors.introspection, actors.instrument)))


def shown(robot: str) -> str:
    """Return the topic on which a trace is published: sender, receiver and type of every message."""
    return f"{PREFIX}/{robot}/shown"


def _inside(robot: str) -> dict[str, MessageTypes]:
    """Return the addresses of the actors to which recorders and the command `strands-actors tree` may send any
    message."""
    actors = addresses.of(robot)
    paths = [path(process) for process in ("root", "wire") for path in (actors.introspection, actors.instrument)]
    return {f"{PREFIX}/{path}": None for path in paths}


# Cached, since each setpoint from another host needs it.
@functools.lru_cache(maxsize=64)
def of_elsewhere(robot: str, client: str) -> Channel:
    """Return the permissions of ``client``, a program on another host, for questions to the gateway."""
    requests: frozenset[type[Message]] = READS | {Sync, Dated, Describe}
    return Channel(client, frozenset(), f"{PREFIX}/node/{client}", {addresses.of(robot).gateway: requests})


def of_stops_elsewhere(robot: str) -> Channel:
    """Return the permissions for stops from other hosts. The sender may use any name."""
    return Channel(tells={addresses.of(robot).gateway_stop: frozenset({Stop})})
