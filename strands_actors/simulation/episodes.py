"""Evaluate a policy in a simulation, in episodes that can be repeated.

Each episode has its own simulation. The simulated time is stopped while the policy computes, so the result does not
depend on the speed of the computer. A scene function prepares the simulation, with random numbers of the episode's
seed. The robot's own gate checks each action, as on a real robot.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.wire import Observation
from strands_actors.kernel.user_code import describe_failure
from strands_actors.supervisors.policy import as_infer, prepare

from . import film
from .evaluation import STEP_S, Failed
from .handle import Pose, World

if TYPE_CHECKING:
    from strands_actors.caller.handle.sim_robot import SimRobot
    from strands_actors.surfaces.cameras import Frame

FILM_FPS = 10
FILM_SIZE = film.Size(320, 240)
START_S = 1.5
"""Simulated time for the move to the start pose of an episode."""


class Ended(StrEnum):
    """Why an episode ended."""

    SUCCESS = "success"
    TIME = "time"  # its time has passed
    REFUSED = "refused"  # the gate refused an action
    POLICY = "policy"  # the policy raised an exception, or gave no action
    SCENE = "scene"  # the functions for scene or success raised an exception, or the simulation failed


class Moment(NamedTuple):
    """The state of an episode, for a success function.

    Attributes:
        time_s: Simulated time since the episode began.
        positions: Position of each joint, in the driver's units.
        objects: x, y, z in metres, then the orientation w, x, y, z, of each object that the scene has added.
        start: The objects when the episode began.
    """

    time_s: float
    positions: Mapping[str, float]
    objects: Mapping[str, Sequence[float]]
    start: Mapping[str, Sequence[float]]


class Episode(NamedTuple):
    """The result of an episode. ``detail`` is the reason for an end that is no success; ``video`` is the film."""

    number: int
    seed: int
    success: bool
    ended: Ended
    steps: int
    seconds: float
    detail: str = ""
    video: str = ""


Scene = Callable[["SimRobot", random.Random], Mapping[str, float] | None]
"""Prepares a simulation: adds objects and cameras, sets the light. It may return targets by joint, at which the
robot is when the episode begins."""
Success = Callable[[Moment], object]


class Simulation(Protocol):
    """What an episode needs of its simulation, in addition to the handle."""

    robot: SimRobot
    world: World

    def observe(self) -> Observation: ...
    def call(self, verb: Callable[..., Any], *args: Any) -> Any: ...


class Settings(NamedTuple):
    """The settings of all episodes.

    Attributes:
        axes: Names of the robot's axes.
        table: The robot's axes.
        hz: Actions per second.
        seconds: Longest simulated time of an episode.
        instruction: Text for the policy.
        scene: Prepares each episode; None for the robot alone.
        success: Judges each step.
        videos: Folder for films of failed episodes; None for no films.
    """

    axes: Sequence[str]
    table: Sequence[Any]
    hz: float
    seconds: float
    instruction: str
    scene: Scene | None
    success: Success
    videos: Path | None


class DrawnCamera:
    """Reads a camera of a simulation. Each picture is drawn when it is read.

    Args:
        camera: Name of the camera.
        size: Width and height in pixels.
        view: The view of the scene that it shows.
        simulation: Returns the simulation of the present episode.
    """

    def __init__(self, camera: str, size: tuple[int, int], view: str, simulation: Callable[[], SimRobot]) -> None:
        self.camera = camera
        self._size, self._view, self._simulation = size, view, simulation
        self._drawn = 0

    def newest(self, max_age_s: float | None = None) -> Frame:
        """Return a picture of the present state."""
        import numpy as np

        from strands_actors.surfaces.cameras import Frame

        picture = self._simulation().render(*self._size, self._view)
        self._drawn += 1
        return Frame(np.asarray(picture), time.monotonic_ns(), self._drawn)


def run_episode(simulation: Simulation, policy: Any, settings: Settings, number: int, seed: int) -> Episode:
    """Run one episode in a new simulation, and return its result. It raises nothing that policy or scene raise."""
    episode = _Running(simulation, policy, settings, seed)
    ended, detail = episode.run()
    seconds = round(episode.steps / settings.hz, 3)
    result = Episode(number, seed, ended is Ended.SUCCESS, ended, episode.steps, seconds, detail)
    if settings.videos is None or result.success or not episode.poses:
        return result
    file = settings.videos / f"episode-{number:03d}{film.MP4}"
    film.write(file, episode.pictures(), FILM_FPS, FILM_SIZE)
    return result._replace(video=str(file))


class _Running:
    def __init__(self, simulation: Simulation, policy: Any, settings: Settings, seed: int) -> None:
        self._simulation, self._policy, self._settings = simulation, policy, settings
        self._seed = seed
        self._start: Mapping[str, Sequence[float]] = {}
        self.steps = 0
        self.poses: list[Pose] = []

    def run(self) -> tuple[Ended, str]:
        """Run the episode. Return why it ended, and the detail."""
        try:
            if reason := self._prepare_scene():
                return Ended.SCENE, reason
        # The user's function may raise anything. It ends this episode only.
        except Exception as error:
            return Ended.SCENE, describe_failure(error)
        try:
            infer = as_infer(self._policy)
            prepare(self._policy, self._settings.axes, self._settings.hz, self._settings.table)
            if callable(reset := getattr(self._policy, "reset", None)):
                reset(self._seed)
        except Exception as error:
            return Ended.POLICY, describe_failure(error)
        return self._follow(infer)

    def pictures(self) -> Any:
        """Draw the poses of the episode, one after the other."""
        simulation = self._simulation
        for pose in self.poses:
            yield simulation.call(simulation.world.render, *FILM_SIZE, None, pose.qpos)

    def _prepare_scene(self) -> str:
        simulation, settings = self._simulation, self._settings
        robot = simulation.robot
        if reason := robot.connect_eagerly():
            return reason
        simulation.call(simulation.world.change, "pause", True)
        # Some time has passed since the start of the simulation, more on a slow computer.
        _checked(robot.reset())
        targets = None if settings.scene is None else settings.scene(robot, random.Random(self._seed))
        if targets:
            _checked(robot.step(round(START_S / STEP_S), dict(targets)))
        self._start = simulation.call(simulation.world.objects)
        return ""

    def _follow(self, infer: Callable[..., Sequence[Mapping[str, Any]]]) -> tuple[Ended, str]:
        simulation, settings = self._simulation, self._settings
        show_reading = getattr(self._policy, "set_reading", None)
        most = max(1, round(settings.seconds * settings.hz))
        every = max(1, round(settings.hz / FILM_FPS))
        while self.steps < most:
            try:
                reading = simulation.observe()
                if show_reading is not None:
                    show_reading(reading)
                positions = dict(zip(settings.axes, reading.position, strict=True))
                chunk = infer(positions, settings.instruction)[: most - self.steps]
            except Exception as error:
                return Ended.POLICY, describe_failure(error)
            if not chunk:
                return Ended.POLICY, "it gave no action"
            for action in chunk:
                if settings.videos is not None and self.steps % every == 0:
                    self.poses.append(simulation.call(simulation.world.pose))
                answer = simulation.robot.step(self._physics_steps(), as_python(dict(action)))
                if answer["status"] == "error":
                    return Ended.REFUSED, answer["content"][0]["text"]
                self.steps += 1
                try:
                    if self._is_success(answer["content"][0]["json"]["position"]):
                        return Ended.SUCCESS, ""
                except Exception as error:
                    return Ended.SCENE, describe_failure(error)
        return Ended.TIME, f"{settings.seconds:g} s have passed"

    def _physics_steps(self) -> int:
        """Return the time steps of the next action. Their sum over all actions has no rounding error."""
        per_action = 1 / (self._settings.hz * STEP_S)
        return max(1, round((self.steps + 1) * per_action) - round(self.steps * per_action))

    def _is_success(self, positions: Mapping[str, float]) -> bool:
        simulation = self._simulation
        objects = simulation.call(simulation.world.objects) if self._start else {}
        time_s = self.steps / self._settings.hz
        return bool(self._settings.success(Moment(time_s, positions, objects, self._start)))


def _checked(answer: Mapping[str, Any]) -> None:
    if answer["status"] == "error":
        raise Failed(answer["content"][0]["text"])


__all__ = ["DrawnCamera", "Ended", "Episode", "Moment", "Scene", "Settings", "Success", "run_episode"]
