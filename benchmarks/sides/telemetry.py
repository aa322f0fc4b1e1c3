"""``telemetry PROGRAM LENGTH``: measure how many robots can publish their states so that all reach a subscriber in
time.

PROGRAM is ``ours`` or ``strands`` (strands-robots). LENGTH is ``short`` or ``long``.

Each robot (without hardware, in this process) publishes ten states per second to a subscriber in another
process. Robots are added in steps, until more than 1 % of the states are missing, or the 99th percentile of
their age on arrival exceeds 50 ms. The figures per robot are those of the first step.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

from .wire import percentile, processor_s

STATE_HZ = 10.0
STEPS = {"short": (2,), "long": (4, 8, 16, 24, 32, 48, 64)}
WINDOW_S = 4.0
SETTLE_S = 1.5
LOST_PCT, AGE_MS = 1.0, 50.0
KEY = "strands/*/state"
HERE = Path(__file__).resolve().parent


# -- the process that subscribes to the states


class Window:
    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._ages: dict[str, list[float]] = defaultdict(list)

    def take(self, payload: bytes) -> None:
        now_s = time.time()
        state = json.loads(payload)
        with self._lock:
            self._ages[state["peer_id"]].append((now_s - state["t"]) * 1e3)

    def measure(self, robots: int) -> dict[str, float]:
        with self._lock:
            self._ages.clear()
        began_s = time.monotonic()
        time.sleep(WINDOW_S)
        with self._lock:
            took_s = time.monotonic() - began_s
            ages = [age for of_robot in self._ages.values() for age in of_robot]
            full = STATE_HZ * took_s - 1
            lost = sum(max(0.0, full - len(of_robot)) for of_robot in self._ages.values())
            lost += full * (robots - len(self._ages))
        return {"lost_pct": 100 * lost / (full * robots), "age_p99_ms": percentile(ages or [1e6], 0.99)}


def listen(program: str) -> None:
    window = Window()
    with contextlib.ExitStack() as stack:
        (listen_ours if program == "ours" else listen_strands)(window, stack)
        print("ready", flush=True)
        for line in sys.stdin:
            print(json.dumps(window.measure(int(line))), flush=True)
    os._exit(0)


def listen_ours(window: Window, stack: contextlib.ExitStack) -> None:
    import trio

    from strands_actors.caller.session.portal import portal
    from strands_actors.surfaces.mesh import open_mesh

    ready = threading.Event()

    async def join() -> None:
        async with open_mesh() as client:
            client.subscribe(KEY, lambda received: window.take(bytes(received.payload)))
            ready.set()
            await trio.sleep_forever()

    stack.callback(portal().submit(join).cancel)
    ready.wait(10.0)


def listen_strands(window: Window, stack: contextlib.ExitStack) -> None:
    prepare_strands()
    from strands_robots.mesh.session import get_session

    session = get_session()
    stack.callback(session.declare_subscriber(KEY, lambda sample: window.take(bytes(sample.payload))).undeclare)


# -- the robots


def prepare_strands() -> None:
    logging.disable(logging.CRITICAL)
    os.environ["STRANDS_MESH_LOCAL_DEV"] = "true"
    sys.path.insert(0, str(HERE / "standins"))


def strands_robot(number: int) -> Any:
    from strands_robots import Robot

    return Robot("ur5e", mode="real", driver="strands", port="127.0.0.1", mesh=True, peer_id=f"arm{number}")


def our_robot(number: int) -> Any:
    from strands_actors import Robot

    from .stamper import ROBOT

    path = f"{os.environ['STRANDS_ACTORS_RUN']}/frames{number}"
    # The control rate, an option of the robot's driver.
    options: dict[str, Any] = {"hz": 30.0}
    return Robot(ROBOT, mode="real", port=path, tool_name=f"arm{number}", **options)


def processes() -> list[int]:
    """Return the pids of this process and all its descendants."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    pids, new = set(), {os.getpid()}
    while new:
        pids |= new
        new = {pid for pid, parent in parents.items() if parent in pids} - pids
    return sorted(pids)


def memory_mb(pids: list[int]) -> float:
    """Return the memory of these processes in MB. Memory that several of them share counts once (proportional set
    size).
    """
    total_kb = 0
    for pid in pids:
        with contextlib.suppress(OSError):
            lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
            total_kb += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:"))
    return total_kb / 1e3


def cpu_s(pids: list[int]) -> float:
    total = 0.0
    for pid in pids:
        with contextlib.suppress(OSError):
            total += processor_s(pid)
    return total


def threads() -> int:
    """Return the number of threads of this process, including those that are not Python's."""
    return len(list(Path("/proc/self/task").iterdir()))


def main(program: str, length: str) -> None:
    if program == "ours":
        from benchmarks.stage import at_home
        from strands_actors.drivers import register_native_driver

        from .stamper import ROBOT, Stamper

        at_home()
        register_native_driver(ROBOT, Stamper)
        start = our_robot
    else:
        prepare_strands()
        start = strands_robot
    command = [sys.executable, "-m", "benchmarks.sides.telemetry", "listen", program]
    with tempfile.TemporaryFile() as errors:
        listener = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        try:
            figures = ramp(start, listener, STEPS[length])
        except Exception:
            errors.seek(0)
            sys.stderr.write(errors.read().decode()[-2000:])
            raise
        finally:
            listener.kill()
    print(json.dumps(figures), flush=True)
    # The robots' other processes notice that this process has ended, and end, too.
    os._exit(0)


def ask(listener: subprocess.Popen[str], line: str = "") -> str:
    assert listener.stdin is not None and listener.stdout is not None
    if line:
        listener.stdin.write(line + "\n")
        listener.stdin.flush()
    answer = listener.stdout.readline()
    if not answer:
        raise RuntimeError("the process that subscribes to the states has ended. Its errors are above")
    return answer


def ramp(start: Any, listener: subprocess.Popen[str], steps: tuple[int, ...]) -> dict[str, float]:
    ask(listener)
    robots: list[Any] = []
    first: dict[str, float] = {}
    most = 0
    # The first robot also starts parts that all robots share, so it is not counted.
    start_one(start, robots)
    below = processes()
    base_threads, base_mb = threads(), memory_mb([pid for pid in below if pid != listener.pid])
    for count in steps:
        try:
            while len(robots) < count:
                start_one(start, robots)
        except ConnectionError:
            # The computer cannot start another robot, which is a limit, too.
            break
        time.sleep(SETTLE_S)
        pids = [pid for pid in processes() if pid != listener.pid]
        used_s, began_s = cpu_s(pids), time.monotonic()
        measured = json.loads(ask(listener, str(count)))
        share = 100 * (cpu_s(pids) - used_s) / (time.monotonic() - began_s)
        if not first:
            first = {
                "threads_per_robot": (threads() - base_threads) / (count - 1),
                "memory_per_robot_mb": (memory_mb(pids) - base_mb) / (count - 1),
                "cpu_per_robot_pct": share / count,
                "age_p99_ms": measured["age_p99_ms"],
                "lost_pct": measured["lost_pct"],
            }
        if measured["lost_pct"] > LOST_PCT or measured["age_p99_ms"] > AGE_MS:
            break
        most = count
    return first | {"robots_per_core": most / (os.cpu_count() or 1)}


def start_one(start: Any, robots: list[Any]) -> None:
    robot = start(len(robots))
    problem = robot.connect_eagerly()
    if problem is not None:
        raise ConnectionError(problem)
    robots.append(robot)


if __name__ == "__main__":
    if sys.argv[1] == "listen":
        listen(sys.argv[2])
    else:
        main(*sys.argv[1:])
