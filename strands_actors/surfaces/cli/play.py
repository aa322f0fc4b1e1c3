"""``dataset play``: move a robot along an episode, from any terminal."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import trio

from strands_actors.caller import envelopes, moving, verbs
from strands_actors.caller.processes import NotConnected
from strands_actors.caller.tree import RobotTree
from strands_actors.contract.shown import harmless
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.played import Played, read_episode, rows_for
from strands_actors.surfaces.mesh.reach import reach

from .errors import Problem
from .orders import configuration

REFUSED = 1
RELEASE_S = 1.0


def play(root: Path, robot: str, episode: int, units: str, resume: bool, mesh: Path | None, as_json: bool) -> int:
    try:
        played = read_episode(root, episode)
    except DatasetError as problem:
        raise Problem(f"dataset play: {harmless(str(problem))}") from problem
    return trio.run(_play, played, robot, units, resume, mesh, as_json)


async def _play(played: Played, robot: str, units: str, resume: bool, mesh: Path | None, as_json: bool) -> int:
    try:
        async with reach(robot, configuration(mesh)) as tree:
            try:
                answer = await _move(tree, played, units, resume, as_json)
            finally:
                with trio.move_on_after(RELEASE_S, shield=True):  # its own program may have it again
                    released = await verbs.release(tree)
            failed = [one for one in (answer, released) if one["status"] != "success"]
            return _tell(robot, failed[0] if failed else answer, as_json)
    except DatasetError as problem:
        raise Problem(f"dataset play: {harmless(str(problem))}") from problem
    except ConnectionError as failure:  # nobody was asked
        raise Problem(str(failure)) from failure
    except (NotConnected, AskTimeout, Unreachable) as failure:
        return _refuse(robot, str(failure), as_json)


async def _move(tree: RobotTree, played: Played, units: str, resume: bool, as_json: bool) -> dict[str, Any]:
    rows = rows_for(tree.driver, played, units)
    if resume:
        resumed = await tree.resume()
        if isinstance(resumed, Refused):
            return envelopes.refused(resumed)
    if not as_json:
        task = f": {harmless(played.task)}" if played.task else ""
        print(f"{tree.robot}: {len(rows)} frames at {played.hz:g} fps{task}", flush=True)
    return await moving.move_along(tree, rows, played.hz, wait=True)


def _tell(robot: str, answer: dict[str, Any], as_json: bool) -> int:
    (told, *_) = answer["content"]
    if answer["status"] != "success":
        return _refuse(robot, told["text"], as_json)
    if as_json:
        print(json.dumps({"robot": robot, "played": True, **told["json"]}))
    else:
        print(f"{robot}: played to the end; it holds", flush=True)
    return 0


def _refuse(robot: str, why: str, as_json: bool) -> int:
    if as_json:
        print(json.dumps({"robot": robot, "played": False, "detail": why}))
    else:
        print(f"strands-actors: {why}", file=sys.stderr)
    return REFUSED
