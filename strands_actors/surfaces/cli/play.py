"""``dataset play``: move a robot along an episode, from any terminal."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import trio

from strands_actors.caller.handle import envelopes, moving
from strands_actors.caller.session.tree import RobotTree
from strands_actors.contract.shown import harmless
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.played import Played, read_episode, rows_for

from .borrow import borrow, refuse
from .errors import Problem
from .one_robot import OneRobot
from .remedies import of_motion, with_remedy

OURS = "strands_"
"""Prefix of a robot's type in a dataset of this package."""


def play(root: Path, robot: str, episode: int, units: str, resume: bool, mesh: Path | None, as_json: bool) -> int:
    """Move a robot along an episode of a dataset. Return 1 if it did not reach the end, else 0."""
    done: dict[str, Any] = {}
    try:
        played = read_episode(root, episode)
        reason = trio.run(borrow, robot, mesh, lambda tree: _move(tree, played, units, resume, as_json, done))
    except DatasetError as problem:
        raise Problem(f"dataset play: {harmless(str(problem))}") from problem
    if reason:
        return refuse(robot, "played", reason, as_json)
    if as_json:
        print(json.dumps({"robot": robot, "played": True, **done}))
    else:
        print(f"{robot}: played to the end; it holds", flush=True)
    return 0


def play_on_twin(root: Path, robot: str | None, episode: int, units: str, as_json: bool) -> int:
    """Start a simulated robot behind its real driver, and move it along an episode. Return 1 if it did not reach
    the end, else 0.

    Args:
        root: The folder of the dataset.
        robot: The robot's type. None: the type that the dataset states.
        episode: The number of the episode.
        units: The unit of the dataset's numbers, if the dataset does not state it.
        as_json: Print JSON.
    """
    try:
        played = read_episode(root, episode)
        robot = robot or played.robot_type.removeprefix(OURS)
        if not robot:
            raise Problem("dataset play: the dataset states no robot. Give its type, such as so101")
        twin = OneRobot(robot, None, True, None, None).make("dataset play")
        try:
            rows = rows_for(twin.driver, played, units)
            if reason := twin.connect_eagerly():
                return refuse(robot, "played", reason, as_json)
            answer = twin.move_along(rows, played.hz, True)
        finally:
            twin.cleanup()
    except (DatasetError, ValueError, TypeError) as problem:
        raise Problem(f"dataset play: {harmless(str(problem))}") from problem
    content = answer["content"][0]
    if answer["status"] != "success":
        return refuse(robot, "played", content["text"], as_json)
    if as_json:
        print(json.dumps({"robot": robot, "played": True, **content["json"]}))
    else:
        print(f"{robot}: the twin played {len(rows)} frames to the end", flush=True)
    return 0


async def _move(
    tree: RobotTree, played: Played, units: str, resume: bool, as_json: bool, done: dict[str, Any]
) -> str:
    """Move the robot along the episode. Return why it did not reach the end, or an empty text.

    The result of the motion is added to the dict ``done``.
    """
    rows = rows_for(tree.driver, played, units)
    if resume:
        resumed = await tree.resume()
        if isinstance(resumed, Refused):
            return with_remedy(resumed, of_motion(tree.robot, resume)).text
    if not as_json:
        task = f": {harmless(played.task)}" if played.task else ""
        print(f"{tree.robot}: {len(rows)} frames at {played.hz:g} fps{task}", flush=True)
    moved = await moving.move_along(tree, rows, played.hz, wait=True)
    answer = envelopes.with_remedy(moved, of_motion(tree.robot, resume))
    (content, *_) = answer["content"]
    if answer["status"] != "success":
        return str(content["text"])
    done.update(content["json"])
    return ""
