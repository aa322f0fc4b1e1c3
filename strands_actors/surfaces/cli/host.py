"""``up``, ``status``, ``reload``, ``down``: the host, which keeps robots for scripts that come and go."""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path

import msgspec
import trio

from strands_actors.kernel.processes.identity import take_name
from strands_actors.surfaces.host.fleet import BadFleet, Fleet
from strands_actors.surfaces.host.fleet_file import read_fleet
from strands_actors.surfaces.host.host import AnotherHost, keep_robots, only_host
from strands_actors.surfaces.host.keeper import Phase, RobotStatus
from strands_actors.surfaces.host.messages import HostStatus, Verb
from strands_actors.surfaces.host.orders import NoHost, order

from .errors import Problem

BAD, NOT_UP = 2, 1
"""Exit codes: the file has faults; a robot is not up."""


def up(file: Path, check: bool, new_adapters: bool, as_json: bool) -> int:
    """Keep the robots of a file until Ctrl-C or ``down``. With ``check`` only look for faults of the file.

    Returns:
        The exit code.

    Raises:
        Problem: Another host runs.
    """
    try:
        fleet = read_fleet(file.absolute())
    except BadFleet as bad:
        if as_json:
            print(json.dumps({"faults": [fault._asdict() for fault in bad.faults]}))
        print(f"{bad}\nstrands-actors: nothing was started", file=sys.stderr)
        return BAD
    if check:
        names = ", ".join(fleet.robots)
        print(
            json.dumps({"faults": [], "robots": list(fleet.robots)}) if as_json else f"no faults. Robots: {names}"
        )
        return 0
    return _keep(fleet, new_adapters, as_json)


def _keep(fleet: Fleet, new_adapters: bool, as_json: bool) -> int:
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)

    def on_ready(status: HostStatus) -> None:
        # This may go to a log that others read.
        show(_without_tokens(status), as_json)
        if not as_json:
            print("scripts attach by name: Robot(NAME, attach=True). Ctrl-C ends the host", flush=True)

    try:
        with only_host():
            take_name("host", "host")
            trio.run(keep_robots, fleet, new_adapters, on_ready)
    except AnotherHost as another:
        raise Problem(str(another)) from another
    return 0


def status(as_json: bool) -> int:
    """Show the robots of the host. Return 1 if one is not up. Raise ``Problem`` if no host answers."""
    answer = _give(Verb.STATUS)
    show(answer, as_json)
    return 0 if all(robot.phase == Phase.UP for robot in answer.robots) else NOT_UP


def reload(as_json: bool) -> int:
    """Let the host read its file again.

    Returns:
        0; 1 if a robot is not up; 2 if the file has faults, and nothing was changed.

    Raises:
        Problem: No host answers.
    """
    answer = _give(Verb.RELOAD)
    show(answer, as_json)
    if answer.faults:
        for fault in answer.faults:
            print(f"{answer.file}:{fault.line}: {fault.text}", file=sys.stderr)
        print("strands-actors: nothing was changed", file=sys.stderr)
        return BAD
    if not as_json:
        print(f"changed: {', '.join(answer.changed) or 'nothing'}")
    return 0 if all(robot.phase == Phase.UP for robot in answer.robots) else NOT_UP


def down(as_json: bool) -> int:
    """Make all robots safe, and end the host. Raise ``Problem`` if no host answers."""
    names = [robot.name for robot in _give(Verb.DOWN).robots]
    print(json.dumps({"down": names}) if as_json else f"down: {', '.join(names) or 'no robot'}")
    return 0


def _give(verb: Verb) -> HostStatus:
    try:
        return order(verb)
    except NoHost as none:
        raise Problem(f"{verb}: {none}") from none


def _without_tokens(status: HostStatus) -> HostStatus:
    services = {
        name: msgspec.structs.replace(service, address=service.address.partition("?")[0])
        for name, service in status.services.items()
    }
    return msgspec.structs.replace(status, services=services)


def show(answer: HostStatus, as_json: bool) -> None:
    """Print the status of a host."""
    if as_json:
        print(json.dumps(msgspec.to_builtins(answer)), flush=True)
        return
    width = max((len(robot.name) for robot in answer.robots), default=0)
    for robot in answer.robots:
        print(f"{robot.name:<{width}}  {robot.type:<8}  {_state(robot)}")
    print(f"host: process {answer.pid}, {answer.file}")
    for name, service in answer.services.items():
        print(f"{name}: {service.address or service.problem}")
    if answer.problem:
        print(f"adapters: {answer.problem}")
    sys.stdout.flush()


def _state(robot: RobotStatus) -> str:
    """Return the state of a robot in a few words."""
    parts = [robot.state or robot.phase]
    if robot.locked_by:
        parts.append(f"e-stopped by {robot.locked_by}")
    if robot.holder:
        parts.append(f"commanded by {robot.holder}")
    if robot.reason:
        parts.append(robot.reason)
    if robot.retry_s:
        parts.append(f"next attempt in {robot.retry_s:.0f} s")
    return " · ".join(parts)
