"""A script that moves a robot, and obeys orders from standard input.

The settings of ``main`` are:

* ``robot``, ``port``, ``cameras`` and further ``options`` of the robot. With the option ``gripper`` it moves the
  hand, too.
* ``attach``: True if a host keeps the robot. The script then attaches itself to it.
* ``driver``: ``module:Class``, or empty.
* ``motion``: ``loop`` (the script moves the first joint at 50 Hz), ``task`` (a policy process moves it),
  ``rollout`` (a policy in this process) or ``raise`` (the script raises the arm, and holds it there).
* ``far``: how far the joint moves, in the driver's units.
* ``trigger``: a file that makes the policy fail (``testing.policies``).

When the robot moves, the script prints the robot's processes (its tree) as one JSON line. Then it obeys these
orders:

* ``exception``, ``exit`` and ``spin`` make the script itself fail.
* ``stop`` stops the robot and prints the report.
* ``lower`` and ``estop`` order a stop or an e-stop, print when, and do not wait for its end.
* ``again MOTION`` resumes and moves the robot, and prints the tree.
* ``tree`` prints the tree.
"""

from __future__ import annotations

import json
import math
import os
import select
import sys
import threading
import time
from typing import Any

from strands_actors import Robot
from strands_actors.supervisors.introspection import fall
from strands_actors.surfaces.mesh import estop

from .registering import register

GRIPPER, OPENING, CLOSED_TO = "gripper", 80.0, 20.0
"""The hand of an arm that carries one (the option and the axis have this name). The script moves it between these
openings, in percent; a policy process closes it to the first one only."""
STEPS = 10
"""Steps of a task until the robot counts as moving."""
MOVED_S = 0.2
RAISED = {
    "so100": {"shoulder_lift": -15.0, "elbow_flex": 10.0, "wrist_flex": 15.0},
    "so101": {"shoulder_lift": -15.0, "elbow_flex": 10.0, "wrist_flex": 15.0},
    "koch": {"shoulder_lift": -15.0, "elbow_flex": -10.0, "wrist_flex": 15.0},
}
"""Poses from which an arm falls (degrees)."""
RAISE_S = 2.0
STANDS_S = 0.3


class Caller:
    """The robot that the script moves. The methods carry out the orders from standard input.

    The constructor connects the robot. It raises ``SystemExit`` if that fails three times, or if the robot
    cannot be prepared for commands.
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        if settings["driver"]:
            register(settings["driver"], settings["robot"])
        self._far = float(settings["far"])
        self._trigger: str = settings["trigger"]
        self._attached: bool = settings["attach"]
        self._grips = GRIPPER in settings["options"]
        self.robot: Any = (
            Robot(settings["robot"], attach=True)
            if self._attached
            else Robot(
                settings["robot"],
                mode="real",
                port=settings["port"],
                cameras=settings["cameras"] or None,
                **settings["options"],
            )
        )
        problem: str | None = "never tried"
        # If the simulated robot waits for a processor of a busy computer, it looks silent. So connecting is tried
        # again.
        for _ in range(3):
            problem = self.robot.connect_eagerly()
            if problem is None:
                break
        if problem is not None:
            raise SystemExit(problem)
        self._prepare()

    def _prepare(self) -> None:
        """Prepare the robot for commands, if this is necessary: a drone takes off."""
        name = self.robot.driver.BEFORE_MOTION
        if name and (answer := self.robot.service(name))["status"] != "success":
            raise SystemExit(f"{name}: {answer}")

    def begin(self, motion: str) -> None:
        """Move the robot, and print its processes (the tree) when it moves."""
        self._loops = motion == "loop"
        if motion == "raise":
            self._raise()
            self._print_tree()
            return
        problem = "the robot has no joint"
        observation = self.robot.get_observation()
        self._others = dict(observation) if self.robot.driver.WHOLE_ACTIONS else {}
        if self._grips:
            self._others[GRIPPER] = OPENING
        for joint, position in observation.items():
            self._joint, self._start = joint, position
            problem = self._move(motion)
            if not problem:
                self._print_tree()
                return
            # A robot that has fallen may have some joints at their end stops. At least one joint can still move.
            self.resume()
        raise SystemExit(problem)

    def _print_tree(self) -> None:
        """Print the robot's processes. The tree of a robot that a host keeps does not have the script."""
        tree = self.robot.tree()
        if self._attached:
            tree["processes"].append({"role": "caller", "pid": os.getpid(), "restarts": 0})
        print(json.dumps(tree), flush=True)

    def _raise(self) -> None:
        """Raise the arm, and wait until it stands. Raise ``SystemExit`` if it is refused."""
        answer = self.robot.move_to(RAISED[self.robot.driver.robot], seconds=RAISE_S)
        if answer["status"] != "success":
            raise SystemExit(f"the arm is not raised: {answer}")
        time.sleep(STANDS_S)

    def _move(self, motion: str) -> str:
        """Begin to move the robot. Return why it does not move, or an empty text if it moves."""
        self._began_s = time.monotonic()
        if motion == "task" and (problem := self._start_task()):
            return problem
        if motion == "rollout":
            # Each call returns 25 steps at once, because the computer may be busy. This is a twentieth of a second
            # for a robot with legs.
            self.robot.run_policy(lambda _: [self._swing()] * 25, duration=60.0)
        while time.monotonic() < self._began_s + MOVED_S:
            self.step()
            time.sleep(0.02)
        task = self.robot.get_task_status()["content"][0]["json"]
        if motion == "rollout" and not task["running"]:
            return f"the rollout has ended by itself: {task['exit_reason']}, {task['exit_detail']}"
        return ""

    def _start_task(self) -> str:
        """Start a policy. Return why the policy run has not begun, or an empty text if it has begun."""
        started = self.robot.start_task(
            "wave",
            policy_provider="strands_actors.testing.policies:Faulty",
            control_frequency=50,
            trigger=self._trigger,
            amplitude=self._far,
            joint=self._joint,
            others={name: value for name, value in self._others.items() if name != self._joint},
        )
        if started["status"] != "success":
            return f"no task: {started}"
        while (task := self.robot.get_task_status()["content"][0]["json"])["steps"] < STEPS:
            if not task["running"]:
                return f"the policy does not run: {task}"
            time.sleep(0.01)
        return ""

    def step(self) -> None:
        """Send the next setpoint, if the script itself moves the robot (motion ``loop``)."""
        if self._loops:
            self.robot.send_action(self._swing())

    def _swing(self) -> dict[str, float]:
        swing = (1.0 - math.cos(time.monotonic() - self._began_s)) / 2
        fingers = {GRIPPER: OPENING + (CLOSED_TO - OPENING) * swing} if self._grips else {}
        return {**self._others, self._joint: self._start + self._far * swing, **fingers}

    def again(self, motion: str) -> None:
        """Resume the robot, and move it by ``loop``, ``task`` or ``rollout``.

        Print its processes (the tree) when it moves.
        """
        self.resume()
        self.begin(motion)

    def resume(self) -> None:
        """Resume the robot and prepare it for commands. Try again for 10 s if this fails."""
        deadline_s = time.monotonic() + 10.0
        while (answer := self.robot.resume())["status"] != "success":
            if time.monotonic() > deadline_s:
                raise SystemExit(f"no resume: {answer}")
            time.sleep(0.05)
        self._prepare()

    def obey(self, line: str) -> None:
        """Carry out one order from standard input, as the head of this module lists them."""
        match line.split():
            case ["again", motion]:
                self.again(motion)
            case ["tree"]:
                self._print_tree()
            case ["stop"]:
                at_ns = time.monotonic_ns()
                answer = self.robot.stop()
                print(json.dumps({"at_ns": at_ns, "confirmed": answer["status"] == "success"}), flush=True)
            case ["lower" | "estop" as order]:
                target = self.robot.stop if order == "lower" else estop
                print(json.dumps({"at_ns": time.monotonic_ns()}), flush=True)
                threading.Thread(target=target, daemon=True).start()
            case [how]:
                print(json.dumps({"at_ns": time.monotonic_ns()}), flush=True)
                fall(how)


def main(settings: dict[str, Any]) -> None:
    """Move the robot, and obey orders until standard input ends.

    Args:
        settings: The settings, as the head of this module lists them.
    """
    caller = Caller(settings)
    caller.begin(settings["motion"])
    while True:
        caller.step()
        if select.select([sys.stdin], [], [], 0.02)[0]:
            line = sys.stdin.readline()
            if not line:
                return
            caller.obey(line)
