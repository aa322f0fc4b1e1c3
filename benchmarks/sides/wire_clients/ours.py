"""The client of this package. Its code is the same for every robot."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.stage import at_home
from strands_actors import Robot

from .hand import BaseClient, wave

STEPS = {
    "xarm7": ("joint1", 0.03),
    "kinova_gen3": ("joint_1", 0.012),
    "kuka_iiwa": ("joint1", 0.012),
    "panda": ("joint1", 0.03),
    "fr3": ("fr3_joint1", 0.03),
    "spot": ("vx", 0.3),
    "rby1": ("torso_5", 0.03),
    "reachy_mini": ("head_yaw", 6.0),
    "microduck": ("vx", 0.15),
    "earthrover": ("linear", 0.3),
    "yahboom_m3pro": ("linear.x", 0.3),
    "booster_t1": ("left_elbow_pitch", 0.06),
    "crazyflie": ("vx", 0.2),
    "stretch3": ("lift", 0.02),
}
"""The commanded key and the size of a step, in the driver's units. It is small enough for every gate."""
SPEEDS = ("vx", "linear", "linear.x")
"""Keys that are commanded by velocity."""
FAR = {"panda": 1.0, "fr3": 1.0, "reachy_mini": 25.0}
"""Length of a single motion, for robots that move to a target by themselves."""
SETTLES_S = {"kinova_gen3": 0.3, "kuka_iiwa": 0.06, "panda": 0.7, "fr3": 0.7}
"""Time after which a step is finished, for arms that approach their target gradually."""
PATIENCE_S = 40.0


class Client(BaseClient):
    """The client of this package.

    ``scale`` is a factor for the size of steps, which must be smaller at a higher rate. ``options`` are passed to
    ``Robot``.
    """

    def __init__(self, robot: str, port: str, scale: float = 1.0, **options: Any) -> None:
        at_home()
        self.pause_s = SETTLES_S.get(robot, 0.0)
        self._name = robot
        self._robot: Any = Robot(robot, mode="real", port=port, **options)
        self._key, step = STEPS[robot]
        self._step = step * scale
        # On a busy computer the simulated robot may answer too late, so connecting is tried again.
        for _ in range(3):
            if (problem := self._robot.connect_eagerly()) is None:
                break
        if problem is not None:
            raise RuntimeError(problem)
        self._prepare()

    def _prepare(self) -> None:
        name = self._robot.driver.BEFORE_MOTION
        if name:
            self._until(lambda: self._robot.service(name), name)
        observation = self._robot.get_observation()
        self._others = dict(observation) if self._robot.driver.WHOLE_ACTIONS else {}
        self._base = 0.0 if self._key in SPEEDS else observation[self._key]

    def _until(self, ask: Callable[[], Any], action_name: str) -> None:
        until_s = time.monotonic() + PATIENCE_S
        while (answer := ask())["status"] != "success":
            if time.monotonic() > until_s:
                raise RuntimeError(f"{action_name}: {answer}")
            time.sleep(0.05)

    def setpoint(self, number: int) -> int:
        return self._send(self._step * wave(number))

    def _send(self, far: float) -> int:
        action = {**self._others, self._key: self._base + far}
        began_ns = time.monotonic_ns()
        answer = self._robot.send_action(action)
        if answer["status"] != "success":
            raise RuntimeError(str(answer))
        return began_ns

    def move(self, number: int) -> None:
        far = FAR.get(self._name)
        if far is None:
            self.setpoint(number)
        else:
            self._send(-far if self._base > 0 else far)

    def stop(self) -> None:
        self._robot.stop()

    def again(self) -> None:
        self._until(self._resume, "resume")
        self._prepare()

    def _resume(self) -> Any:
        """Resume the robot, and clear its reflex (the stop by an arm's own controller). On a busy computer,
        commands come late and trigger a reflex.
        """
        answer = self._robot.resume()
        if answer["status"] != "success" and "recover" in self._robot.driver.SERVICES:
            self._robot.recover()
        return answer

    def stream(self, hz: float, seconds: float) -> None:
        # This robot takes one motion at a time, and our process that talks to it sends the path in its own cycle.
        if self._robot.driver.WHOLE_ACTIONS:
            self.move(0)
            time.sleep(seconds)
        else:
            super().stream(hz, seconds)

    def pids(self) -> tuple[list[int], list[int]]:
        roles = {each["role"]: each["pid"] for each in self._robot.tree()["processes"]}
        wire = roles.pop("wire")
        children = Path(f"/proc/{wire}/task/{wire}/children").read_text().split()
        return [wire, *map(int, children)], list(roles.values())

    def close(self) -> None:
        self._robot.cleanup()
