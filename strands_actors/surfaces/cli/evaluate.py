"""``eval``: run a policy in simulated episodes, and print a table of their results."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from strands_actors.caller.handle.sim_robot import SimRobot
from strands_actors.contract.extras import missing
from strands_actors.contract.loading import load
from strands_actors.contract.wire import Observation
from strands_actors.policies.registry import choose_provider, robot_facts
from strands_actors.policies.sources import Source, choose
from strands_actors.simulation.episodes import DrawnCamera, Episode, Settings, run_episode
from strands_actors.simulation.handle import World

from .errors import Problem
from .one_robot import OneRobot

FAILED = 1
RESULTS = "results.json"
PICTURE = (640, 480)
PLACES = ("width", "height", "view")
"""The settings of a camera that an evaluation uses."""


class Request(NamedTuple):
    """What an evaluation is asked to do.

    Attributes:
        chosen: The robot.
        policy: A name, a folder, a server or ``module:Class``.
        options: Keyword arguments for the policy.
        cameras: Settings of the cameras that the policy sees, by name.
        episodes: Number of episodes.
        seconds: Longest simulated time of an episode.
        seed: Seed of the first episode. Each further episode has a seed that is greater by 1.
        success: ``module:function`` that judges each step.
        scene: ``module:function`` that prepares each episode; None for the robot alone.
        instruction: Text for the policy.
        hz: Actions per second; None for the policy's or the driver's.
        out: Folder for the results and the films of failed episodes; None for neither.
    """

    chosen: OneRobot
    policy: str
    options: Mapping[str, Any]
    cameras: Mapping[str, Mapping[str, Any]]
    episodes: int
    seconds: float
    seed: int
    success: str
    scene: str | None
    instruction: str
    hz: float | None
    out: Path | None


class _Simulation:
    """The simulation of one episode."""

    def __init__(self, robot: SimRobot) -> None:
        self.robot = robot
        self.world: World = robot._world

    def observe(self) -> Observation:
        return self.robot._newest()

    def call(self, verb: Callable[..., Any], *args: Any) -> Any:
        return self.robot._call(verb, *args)


def evaluate(request: Request, as_json: bool) -> int:
    """Run all episodes, and print their results.

    Args:
        request: The evaluation.
        as_json: Print JSON.

    Returns:
        The exit code: 0 if all episodes could be run, also without success; 1 if scene or policy has failed in one.

    Raises:
        Problem: Nothing was started: the robot, the policy or a function is unknown.
    """
    if request.out is not None and (reason := missing("dataset", "a film of an episode (--out)")):
        raise Problem(f"eval: {reason}")
    # Functions of the user are in the current directory, which is not in the path of a console script.
    sys.path.insert(0, os.getcwd())
    try:
        source = choose(request.policy, request.options)
        success, scene = _function("success", request.success), request.scene and _function("scene", request.scene)
        robot = _robot(request.chosen)
        now: list[SimRobot] = [robot]
        policy = _make(source, request, robot, lambda: now[0])
    except (ImportError, TypeError, ValueError, ConnectionError, TimeoutError) as refusal:
        raise Problem(f"eval: {refusal}") from refusal
    hz = request.hz or source.hz or robot.driver.timing.control_hz
    if request.out is not None:
        request.out.mkdir(parents=True, exist_ok=True)
    settings = Settings(
        robot.driver.axes, robot.driver.table, hz, request.seconds, request.instruction, scene or None, success,
        request.out,
    )  # fmt: skip
    done: list[Episode] = []
    for number in range(request.episodes):
        with robot:
            done.append(run_episode(_Simulation(robot), policy, settings, number, request.seed + number))
        if not as_json:
            print(_line(done[-1]), flush=True)
        robot = now[0] = _robot(request.chosen)
    report = _report(request, robot.name, hz, done)
    if request.out is not None:
        (request.out / RESULTS).write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps(report) if as_json else _summary(report))
    return FAILED if any(str(episode.ended) in ("policy", "scene") for episode in done) else 0


def _robot(chosen: OneRobot) -> SimRobot:
    robot = chosen.make("eval")
    if not isinstance(robot, SimRobot):
        raise Problem("eval: an evaluation runs in a simulation. Unset STRANDS_ROBOT_MODE")
    return robot


def _function(option: str, place: str) -> Callable[..., Any]:
    try:
        loaded = load(place)
    except (ImportError, AttributeError, ValueError) as failure:
        raise ValueError(f"--{option} is {place!r}: {failure}. Give module:function") from failure
    if not callable(loaded):
        raise ValueError(f"--{option} is {place!r}, which is no function. Give module:function")
    function: Callable[..., Any] = loaded
    return function


def _make(source: Source, request: Request, robot: SimRobot, present: Callable[[], SimRobot]) -> Any:
    """Make the policy in this process. Its cameras are drawn from the simulation of the present episode."""
    if source.policy is not None:
        return source.policy
    provider, options = choose_provider(source.provider, "localhost", None, dict(source.options))
    facts = robot_facts(provider, robot.driver, robot.name, list(request.cameras))
    if provider.takes_cameras:
        facts["attach"] = lambda _, name: _camera(name, request.cameras[name], present)
    return load(provider.where)(**facts, **options)


def _camera(name: str, settings: Mapping[str, Any], present: Callable[[], SimRobot]) -> DrawnCamera:
    if unknown := sorted(set(settings) - set(PLACES)):
        raise ValueError(f"--camera {name}: an evaluation takes {', '.join(PLACES)}, no {', '.join(unknown)}")
    size = (settings.get("width", PICTURE[0]), settings.get("height", PICTURE[1]))
    return DrawnCamera(name, size, settings.get("view", name), present)


def _line(episode: Episode) -> str:
    detail = f": {episode.detail}" if episode.detail else ""
    film = f" ({episode.video})" if episode.video else ""
    done = (
        f"episode {episode.number:3d}  seed {episode.seed:3d}  {episode.steps:5d} steps  {episode.seconds:6.2f} s"
    )
    return f"{done}  {episode.ended}{detail}{film}"


def _report(request: Request, robot: str, hz: float, done: Sequence[Episode]) -> dict[str, Any]:
    won = sum(episode.success for episode in done)
    return {
        "robot": robot,
        "policy": request.policy,
        "success": request.success,
        "scene": request.scene,
        "hz": hz,
        "episodes": [episode._asdict() for episode in done],
        "successes": won,
        "success_rate": won / len(done),
    }


def _summary(report: Mapping[str, Any]) -> str:
    count = len(report["episodes"])
    return f"{report['robot']}: {report['policy']}: {report['successes']} of {count} episodes succeeded"


__all__ = ["Request", "evaluate"]
