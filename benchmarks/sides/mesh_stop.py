"""``mesh_stop PROGRAM LENGTH ROBOT PORT LOG``: measure the time from an e-stop until another process' robot
receives its first stop command. The e-stop is sent over the mesh (the network between robots and their users).

PROGRAM is the program that is measured: ``ours``, ``strands`` (strands-robots) or ``bare`` (one zenoh message to a
process that only has the vendor's SDK). LENGTH is ``short`` or ``long``. PORT is the port of the simulated robot,
and LOG the file of the frames that it has read.

Two processes have one robot each. This process sends the e-stop. Meanwhile the policy of its own robot answers
at once (``idle``) or does not return (``blocked``). The other process commands the simulated robot at PORT. It
starts its policy again after each stop.
"""

from __future__ import annotations

import json
import logging
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .stop import Policy, position
from .wire import Log

COUNT = {"short": 1, "long": 16}
CASES = ("idle", "blocked")
AGAIN_S = 0.5
MEET_S = 3.0
"""Time for two processes to find each other, in seconds."""
MOVING_S = 0.5
"""How long the other robot moves before it is stopped, in seconds."""

HERE = Path(__file__).resolve().parent


def robot_of(program: str, robot: str, port: str, name: str) -> Any:
    if program == "ours":
        from strands_actors import Robot

        return Robot(robot, mode="real", port=port, tool_name=name)
    logging.disable(logging.CRITICAL)
    os.environ["STRANDS_MESH_LOCAL_DEV"] = "true"
    from strands_robots import Robot as Reference

    return Reference(robot, mode="real", driver="strands", port=port, mesh=True, peer_id=name)


def keep_moving(program: str, robot: str, port: str) -> None:
    """Run the other process, the one that is stopped. It makes its robot move again after each stop."""
    arm = robot_of(program, robot, port, "other")
    problem = arm.connect_eagerly()
    if problem is not None:
        raise RuntimeError(problem)
    base = position(arm, robot)
    while True:
        if program == "ours" and arm.get_status()["content"][0]["json"].get("state") != "armed":
            arm.resume()
        if not arm.get_task_status()["content"][0]["json"]["running"]:
            arm.run_policy(Policy(robot, base, "idle"), duration=600.0)
        time.sleep(AGAIN_S)


@contextmanager
def other_process(program: str, robot: str, port: str) -> Iterator[None]:
    command = [sys.executable, "-m", "benchmarks.sides.mesh_stop", "other", program, robot, port]
    with tempfile.TemporaryFile() as errors, subprocess.Popen(command, stderr=errors) as process:
        try:
            yield
            if process.poll() is not None:
                errors.seek(0)
                raise RuntimeError(errors.read().decode()[-2000:])
        finally:
            process.kill()


def bare(length: str, port: str, log: Log) -> dict[str, float]:
    """Measure plain zenoh. The program ``bare`` runs no policy, so the cases ``idle`` and ``blocked`` get the same
    figure.
    """
    from .between import _session

    with tempfile.TemporaryDirectory() as directory:
        path = f"{directory}/other"
        command = [sys.executable, "-m", "benchmarks.sides.mesh_stop", "sdk", port, path]
        with subprocess.Popen(command) as process:
            try:
                until_s = time.monotonic() + MEET_S + 15.0
                while not os.path.exists(path):
                    if process.poll() is not None or time.monotonic() > until_s:
                        raise RuntimeError("the process with the vendor's SDK did not start")
                    time.sleep(0.02)
                session = _session([], [path])
                halt = session.declare_publisher("bench/stop")
                took = []
                for _ in range(2 * COUNT[length]):
                    wait_until_moving(log)
                    began_ns = time.monotonic_ns()
                    halt.put(b"stop")
                    took.append(first_safe_ms(log, began_ns))
            finally:
                process.kill()
    return dict.fromkeys((f"estop_{case}_ms" for case in CASES), statistics.median(took))


def with_sdk(port: str, path: str) -> None:
    """Send the same target by the vendor's SDK at the control rate. At a stop message, stop the arm, and continue
    1 s later.
    """
    from .between import _session
    from .setpoint import CYCLE_S, ur_arm

    control, _, again = ur_arm(port.partition(":")[0])
    stopped = threading.Event()
    session = _session([path], [])
    # Keep a reference to the subscriber. Without a reference, zenoh would end the subscription.
    _subscriber = session.declare_subscriber("bench/stop", lambda _: stopped.set())
    while True:
        again()
        if stopped.wait(CYCLE_S["ur5e"]):
            control.servoStop()
            time.sleep(1.0)
            stopped.clear()


def main(program: str, length: str, robot: str, port: str, log_path: str) -> None:
    if program == "bare":
        print(json.dumps(bare(length, port, Log(log_path))), flush=True)
        os._exit(0)
    if program == "ours":
        from benchmarks.stage import at_home
        from strands_actors.drivers import register_native_driver

        from .stamper import ROBOT, Stamper

        at_home()
        register_native_driver(ROBOT, Stamper)
        own = robot_of(program, ROBOT, f"{os.environ['STRANDS_ACTORS_RUN']}/frames", "issuer")
    else:
        sys.path.insert(0, str(HERE / "standins"))
        own = robot_of(program, "ur5e", "127.0.0.1", "issuer")
    problem = own.connect_eagerly()
    if problem is not None:
        raise RuntimeError(problem)
    figures = {}
    with other_process(program, robot, port):
        log = Log(log_path)
        if program == "ours":
            from strands_actors.surfaces.mesh import estop_button

            # The button joins the mesh here, before it is pressed, as strands-robots does.
            with estop_button(by="a benchmark") as press:
                figures = measure(own, press, log, COUNT[length])
        else:
            figures = measure(own, own.mesh.emergency_stop, log, COUNT[length])
    print(json.dumps(figures), flush=True)
    # A normal exit would wait for the blocked policies of strands-robots.
    os._exit(0)


def measure(own: Any, press: Callable[[], object], log: Log, count: int) -> dict[str, float]:
    figures = {}
    time.sleep(MEET_S)
    for case in CASES:
        took = []
        for _ in range(count):
            if own.get_status.__module__.startswith("strands_actors"):
                own.resume()
            policy = Policy("ur5e", 0.0, case)
            own.run_policy(policy, duration=60.0)
            wait_until_moving(log)
            if case == "blocked" and not policy.blocking.wait(5.0):
                raise RuntimeError("the policy of this process' robot was not called within 5 s")
            began_ns = time.monotonic_ns()
            press()
            took.append(first_safe_ms(log, began_ns))
            # Wait until the blocked policy of this process' robot has returned.
            time.sleep(3.0)
        figures[f"estop_{case}_ms"] = statistics.median(took)
    return figures


def first_safe_ms(log: Log, began_ns: int) -> float:
    safe = log.first("safe", began_ns, within_s=15.0)
    if safe is None:
        raise RuntimeError("the robot received no stop command within 15 s after the e-stop")
    return float(safe.t_ns - began_ns) / 1e6


def wait_until_moving(log: Log) -> None:
    until_s = time.monotonic() + 15.0
    began_ns = time.monotonic_ns()
    while log.first("setpoint", began_ns, within_s=0.0) is None:
        if time.monotonic() > until_s:
            raise RuntimeError("the other process' robot got no setpoint for 15 s, so it cannot be stopped")
        time.sleep(0.02)
    time.sleep(MOVING_S)


if __name__ == "__main__":
    if sys.argv[1] == "other":
        keep_moving(*sys.argv[2:])
    elif sys.argv[1] == "sdk":
        with_sdk(*sys.argv[2:])
    else:
        main(*sys.argv[1:])
