"""``stop``, ``estop`` and ``resume`` over the mesh, for this user's robots and those that ``--mesh`` names.

* If a robot of this user does not answer on the mesh, the command sends direct messages to the robot's
  processes. This also ends a frozen process.
* If there is no robot to stop, that is an error. The user must notice that an e-stop has reached no robot.
* A mesh configuration that cannot be used does not prevent a stop of this user's robots.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec
import trio

from strands_actors.caller.processes import directory
from strands_actors.caller.processes.run_directory import notes
from strands_actors.caller.processes.strays import strays
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import STOP_S, MeshClient, open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig
from strands_actors.surfaces.mesh.outcome import Outcome

from . import operate
from .errors import Problem
from .remedies import OF_RESUME, with_remedy

NOT_CONFIRMED = 1


def stop(robot: str | None, every: bool, mesh: Path | None, as_json: bool) -> int:
    """Stop one robot or all robots. If a name and ``--all`` are both given, stop all, so that a stop is never
    refused. Return the exit code."""
    return trio.run(_run, None if every else robot, every, mesh, as_json, _stop)


def estop(robot: str | None, every: bool, mesh: Path | None, as_json: bool) -> int:
    """E-stop one robot. Without a name, or with ``--all``, e-stop every robot. Return the exit code."""
    return trio.run(_run, None if every else robot, every or robot is None, mesh, as_json, _estop)


def resume(robot: str | None, every: bool, mesh: Path | None, as_json: bool) -> int:
    return trio.run(_run, robot, every, mesh, as_json, _resume)


def configuration(mesh: Path | None) -> MeshConfig:
    """Return the mesh configuration of the option ``--mesh``, or else of ``STRANDS_ACTORS_MESH``. Raise
    ``Problem`` if it cannot be used."""
    try:
        return MeshConfig.of(mesh)
    except ValueError as error:
        raise Problem(str(error)) from error


class RobotResult(msgspec.Struct, frozen=True):
    """The result for one robot: ``line`` for the user, ``facts`` for JSON."""

    robot: str
    done: bool
    line: str
    facts: dict[str, Any]


async def _run(
    robot: str | None,
    every: bool,
    mesh: Path | None,
    as_json: bool,
    verb: Callable[[MeshClient, list[str] | None], Awaitable[list[RobotResult]]],
) -> int:
    if (robot is None) != every:
        raise Problem("no robot is given. Name a robot, or give --all")
    to_stop = verb is not _resume
    async with open_mesh(mesh if to_stop else configuration(mesh), to_stop=to_stop) as client:
        if verb is not _estop:  # An e-stop is sent at once, and again to robots that appear later.
            await client.settle()
        results = await verb(client, None if every else [str(robot)])
        running = ", ".join(client.robots)
    if not results:
        missing = "no robot" if every else f"no robot {robot!r}"
        raise Problem(f"{missing} is on the mesh of this user{f'. There are {running}' if running else ''}")
    if as_json:
        print(json.dumps({"robots": [{"robot": each.robot, "done": each.done, **each.facts} for each in results]}))
    else:
        for each in results:
            print(f"{each.robot}: {each.line}", file=sys.stdout if each.done else sys.stderr, flush=True)
    return 0 if all(each.done for each in results) else NOT_CONFIRMED


async def _stop(client: MeshClient, robots: list[str] | None) -> list[RobotResult]:
    async def stop_robot(robot: str) -> RobotResult:
        return await _insist(await client.stop(robot, operate.by()), operate.VERBS["stop"])

    results = await _each(client, robots, stop_robot, [stray.robot for stray in strays()])
    return [*results, *map(_tell, client.not_looked_for())]


async def _estop(client: MeshClient, robots: list[str] | None) -> list[RobotResult]:
    only = "*" if robots is None else robots[0]
    outcomes = await client.estop(operate.by(), robot=only)
    if any(outcome.outcome != "safe" for outcome in outcomes):
        outcomes = await client.estop(operate.by(), STOP_S, only)
    return [await _insist(outcome, operate.VERBS["e-stop"]) for outcome in outcomes]


async def _resume(client: MeshClient, robots: list[str] | None) -> list[RobotResult]:
    async def resume_robot(robot: str) -> RobotResult:
        if robot not in client.robots:
            return _lift(robot)
        answer = await client.resume(robot, operate.by())
        if isinstance(answer, Refused):
            answer = with_remedy(answer, OF_RESUME)
            return RobotResult(robot, False, answer.text, {"code": str(answer.code), "detail": answer.text})
        return RobotResult(robot, True, f"armed at the measured position, epoch {answer['epoch']}", answer)

    try:
        locked = operate.locked()
    except OSError as error:  # If the locks cannot be read, running robots can still be resumed.
        unread = RobotResult(
            "the locks of e-stops", False, f"the locks cannot be read: {error}", {"detail": str(error)}
        )
        return [*await _each(client, robots, resume_robot), unread]
    return await _each(client, robots, resume_robot, locked)


def _lift(robot: str) -> RobotResult:
    """Lift the lock that an e-stop has left on a robot that is not running. Return the result."""
    done, line = operate.lift(robot)
    return RobotResult(robot, done, line, {"lifted": done, "detail": line})


async def _each(
    client: MeshClient,
    robots: list[str] | None,
    verb: Callable[[str], Awaitable[RobotResult]],
    others: Iterable[str] = (),
) -> list[RobotResult]:
    """Carry out a verb (stop or resume) on several robots at the same time, and return the result of each.

    Args:
        client: A client of the mesh, which knows the robots on the mesh.
        robots: The names of the robots to act on. None for all.
        verb: Function that acts on one robot.
        others: The names of further robots, which are not on the mesh.
    """
    results: list[RobotResult] = []

    async def run(robot: str) -> None:
        results.append(await verb(robot))

    async with trio.open_nursery() as nursery:
        for robot in {*client.robots, *others}:
            if robots is None or robot in robots:
                nursery.start_soon(run, robot)
    return sorted(results, key=lambda each: each.robot)


async def _insist(outcome: Outcome, verb: operate.Verb) -> RobotResult:
    """If a robot of this user did not answer on the mesh, send the verb (stop or e-stop) directly to the
    robot's processes. If they cannot be reached, end these processes."""
    if outcome.outcome != "unreachable":
        return _tell(outcome)
    lost = [stray for stray in strays() if stray.robot == outcome.robot]
    if lost:
        done, line = await operate.end(lost, lock=verb is operate.VERBS["e-stop"])
        return RobotResult(outcome.robot, done, line, {"outcome": "unconfirmed", "detail": line})
    try:
        note = next((note for note in notes() if note.robot == outcome.robot), None)
    except OSError:  # The run directory cannot be used. The outcomes already report this.
        note = None
    if note is None:
        return _tell(outcome)
    async with directory.join() as joined:
        done, line = await verb(joined, note)
    return RobotResult(outcome.robot, done, line, {"outcome": "safe" if done else "unreachable", "detail": line})


def _tell(outcome: Outcome) -> RobotResult:
    facts = msgspec.to_builtins(outcome)
    del facts["robot"]
    if outcome.outcome != "safe":
        line = f"NOT CONFIRMED: {outcome.detail or outcome.outcome}. Cut its power if it still moves"
    elif not outcome.motors:
        line = f"{outcome.safe_state} already, before this stop"
    else:
        by = " by the stop channel" if outcome.path == "stop_channel" else ""
        line = f"{outcome.safe_state}, {len(outcome.motors)} motors confirmed in {outcome.took_ms:.1f} ms{by}"
    if outcome.locked and outcome.outcome == "safe":
        line += operate.locked_until(outcome.robot, outcome.note)
    return RobotResult(outcome.robot, outcome.outcome == "safe", line, facts)
