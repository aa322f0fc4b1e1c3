"""What each process of a tree may say to the others: in whose name, and to which actors.

The root knows whom it has started over which link; the wire has a session of its own for policies
(``policy_access``). A policy runs code of others, so it may say what a rollout needs and nothing
else. Whoever joins the mesh of this user, and the tree's own caller, may do what an operator may;
what the parts of a tree report to each other counts over their own link alone.
"""

from __future__ import annotations

from strands_actors.kernel.channels.permissions import Channel, Told
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import PREFIX
from strands_actors.supervisors.gate.messages import (
    Acquire,
    Beat,
    GetObservation,
    GetStatus,
    Perform,
    Release,
    Resume,
    Setpoint,
    Stop,
)
from strands_actors.supervisors.root.messages import Describe, EpisodeKey, Fence, TaskStatus

from . import addresses
from .mesh.gateway_messages import Dated, Sync

WRITES: frozenset[type[Message]] = frozenset({Setpoint, Acquire, Release, GetObservation, GetStatus, Stop})
"""What a rollout tells the gate. A stop is refused to nobody."""
COMMANDS: frozenset[type[Message]] = WRITES | {Beat, Perform, Resume}


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
    """Return the channel whose other end is the process that started the tree. ``node``: its node's
    address. Its policy may be there."""
    return of_user(robot)._replace(hosts=frozenset({addresses.of(robot).policy}), nodes=node)


def of_user(robot: str) -> Channel:
    """Whoever joins the mesh of this user, under any name."""
    at = addresses.of(robot)
    tells: dict[str, Told] = dict.fromkeys((at.root, at.tasks))
    tells |= {at.gate: COMMANDS, at.guardian: frozenset({Fence})}
    for process in ("root", "wire"):
        tells |= {f"{PREFIX}/{path(process)}": None for path in (at.introspection, at.instrument)}
    return Channel(tells=tells)


def of_elsewhere(robot: str) -> Channel:
    """Whoever reaches the gateway from another host, under any name."""
    at = addresses.of(robot)
    asks: frozenset[type[Message]] = frozenset({Sync, Dated, GetObservation, GetStatus, Describe})
    return Channel(tells={at.gateway: asks, at.gateway_stop: frozenset({Stop})})
