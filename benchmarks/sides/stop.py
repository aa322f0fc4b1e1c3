"""``stop PROGRAM LENGTH ROBOT PORT LOG``: measure the time from a stop until the robot receives its first stop
command.

PROGRAM is ``ours`` or ``strands`` (strands-robots). LENGTH is ``short`` or ``long``. PORT is the port of the
simulated robot, and LOG the file of the frames that it has read. The G1 of strands-robots is not simulated (PORT
and LOG are empty). For it the time ends when strands-robots passes the command to a fake of Unitree's SDK.

A policy runs. It is ``idle`` (answers at once), ``blocked`` (does not return for seconds, as with a server that
hangs) or ``computing`` (30 ms of Python for each 50 ms of actions, in the caller's process). The figures ``stop``
are of ``stop()``, by which users and agents stop a robot, and the figures ``task`` of ``stop_task()``.
"""

from __future__ import annotations

import asyncio
import importlib
import inspect
import json
import statistics
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .policies import COMPUTE_S
from .wire import Frame, Log, percentile

COUNT = {"short": 2, "long": 4}
JOINT = {"so101": "shoulder_pan", "ur5e": "elbow_joint", "unitree_g1": "left_shoulder_pitch"}
STEP = {"so101": 0.1, "ur5e": 1e-4, "unitree_g1": 1e-4}
BLOCK_S = {"so101": 2.5, "ur5e": 2.5, "unitree_g1": 6.0}
"""How long a blocked policy blocks. The reference writes a G1's last frame when the policy has returned, and
those of other robots after a wait of 2 s."""
RUN_S = 0.4
CHUNK = 16
CASES = ("idle", "blocked", "computing")
VERBS = {"so101": ("stop",), "ur5e": ("stop", "task"), "unitree_g1": ("task",)}
"""The measured verbs. The reference's ``stop_task`` of a Feetech arm writes nothing, so it is not measured."""
HERE = Path(__file__).resolve().parent


class Policy:
    """A policy that is idle, blocked or computing (``CASES``). The event ``blocking`` is set when it begins to
    block.
    """

    def __init__(self, robot: str, base: float, case: str) -> None:
        self._joint, self._base, self._step, self._case = JOINT[robot], base, STEP[robot], case
        self._block_s = BLOCK_S[robot]
        self._actions = 0
        self.began_s = time.monotonic()
        self.blocking = threading.Event()

    def get_actions_sync(
        self, observation: Mapping[str, Any], instruction: str = "", **_: Any
    ) -> list[dict[str, float]]:
        if self._case == "computing":
            until_s = time.perf_counter() + COMPUTE_S
            while time.perf_counter() < until_s:
                pass
        if self._case == "blocked" and time.monotonic() - self.began_s > RUN_S / 2:
            self.blocking.set()
            time.sleep(self._block_s)
        self._actions += 1
        swing = self._actions % 20
        return [{self._joint: self._base + self._step * (swing + index / CHUNK)} for index in range(CHUNK)]


def position(arm: Any, robot: str) -> float:
    """Return the position of the robot's joint. The G1 of strands-robots reports no positions, so it is 0, as in
    the fake SDK.
    """
    observation = arm.get_observation() if hasattr(arm, "get_observation") else {}
    return float(observation.get(JOINT[robot], observation.get(f"{JOINT[robot]}.pos", 0.0)))


def begin(arm: Any, robot: str, case: str) -> Policy:
    policy = Policy(robot, position(arm, robot), case)
    answer = arm.run_policy(policy, duration=60.0)
    if answer["status"] != "success":
        raise RuntimeError(str(answer))
    return policy


def stop_once(arm: Any, robot: str, case: str, verb: Callable[[], object], log: Log, number: int) -> float | None:
    """Return the milliseconds from the call of the stop to the first stop command that the robot receives.

    Return None if the robot was stopped before the call. This happens on a busy computer, when a process waits for
    a processor and looks frozen.
    """
    policy = begin(arm, robot, case)
    if case != "blocked":
        time.sleep(RUN_S)
    # Stop as soon as the policy blocks. Without new setpoints, our processes soon stop the robot by themselves.
    elif not policy.blocking.wait(5.0):
        raise RuntimeError(f"the policy was not called within 5 s: {arm.get_task_status()}")
    # Stop at different times within a chunk of actions.
    time.sleep(0.003 * (number * 7 % 10))
    began_ns = time.monotonic_ns()
    verb()
    safe = log.first("safe", began_ns, within_s=10.0)
    before = [frame.kind for frame in log.frames if frame.t_ns < began_ns and frame.kind in ("setpoint", "safe")]
    if before[-1:] == ["safe"]:
        return None
    if safe is None:
        raise RuntimeError("the robot received no stop command within 10 s after the stop")
    return (safe.t_ns - began_ns) / 1e6


class FakeSdkLog(Log):
    """The frames that the fake SDK has received, as a log."""

    def __init__(self, received: list[tuple[int, float]]) -> None:
        super().__init__("")
        self._received = received

    def read(self) -> list[Frame]:
        new = self._received[len(self.frames) :]
        self.frames += [Frame(t_ns, "setpoint" if stiffness else "safe", "") for t_ns, stiffness in new]
        return self.frames


def ours(robot: str, port: str) -> tuple[Any, Callable[[str], Callable[[], object]], Callable[[], object]]:
    from benchmarks.stage import at_home
    from strands_actors import Robot

    at_home()
    arm = Robot(robot, mode="real", port=port)

    def again() -> None:
        answer = arm.resume()
        if answer["status"] != "success":
            raise RuntimeError(str(answer))

    return arm, {"stop": arm.stop, "task": arm.stop_task}.__getitem__, again


def strands(robot: str, port: str) -> tuple[Any, Callable[[str], Callable[[], object]], Callable[[], object]]:
    if robot == "unitree_g1":
        sys.path.insert(0, str(HERE / "standins"))
        importlib.import_module("unitree_sdk").install()
    from strands_robots import Robot

    arm = Robot(robot, mode="real", driver="strands", **({"port": port} if port else {}))

    def stop() -> None:
        async def run() -> None:
            answer = arm.stop()
            if inspect.isawaitable(answer):
                await answer

        asyncio.run(run())

    def again() -> None:
        """Wait until a blocked policy has returned. Before that, strands-robots starts no other policy."""
        until_s = time.monotonic() + 2 * BLOCK_S[robot]
        while arm.get_task_status()["content"][0]["json"]["running"] and time.monotonic() < until_s:
            time.sleep(0.02)
        if robot == "so101":
            arm._set_torque_envelope(True)

    return arm, {"stop": stop, "task": arm.stop_task}.__getitem__, again


def main(program: str, length: str, robot: str, port: str, log_path: str) -> None:
    arm, verb_of, again = {"ours": ours, "strands": strands}[program](robot, port)
    problem = arm.connect_eagerly()
    if problem is not None:
        raise RuntimeError(problem)
    log = Log(log_path) if log_path else FakeSdkLog(importlib.import_module("unitree_sdk").FRAMES)
    figures = {}
    for verb in VERBS[robot]:
        for case in CASES:
            took: list[float] = []
            for number in range(2 * COUNT[length]):
                stop_ms = stop_once(arm, robot, case, verb_of(verb), log, number)
                again()
                took += [] if stop_ms is None else [stop_ms]
                if len(took) == COUNT[length]:
                    break
            else:
                raise RuntimeError(f"{robot}, {case}: always stopped before the measured stop (busy computer?)")
            figures[f"{verb}_{case}_ms"] = statistics.median(took)
            figures[f"{verb}_{case}_worst_ms"] = percentile(took, 1.0)
    arm.cleanup()
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
