"""``steady WHO LENGTH FIFO``: how evenly a rollout's setpoints come. WHO: ours, strands, trio, python, relayed,
c. FIFO: yes or no.

Of each rate and load: the ``p99`` of how far the time between two setpoints is from the period, and the share of
setpoints that were ``late``: not there at all, or off by more than a quarter of the period. Loads: ``idle``;
``computing``, 30 ms of work in the same process for each 50 ms of actions; ``busy``, as many other processes as
cores that compute."""

from __future__ import annotations

import array
import contextlib
import functools
import itertools
import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.sides.policies import Busy, Still
from benchmarks.sides.wire import percentile

RATES = (30, 125, 500, 1000)
LOADS = ("idle", "computing", "busy")
SECONDS = {30: 3.0, 125: 1.5, 500: 1.0, 1000: 1.0}
SHORT = 0.6
"""Of these."""
SETTLE_S = 0.3
TRIES = 3
"""To connect: with every core taken a start may fail."""
PRIORITY = 11
HERE = Path(__file__).resolve().parent
NS = 1_000_000_000

SPIN = "import os; os.sched_setscheduler(0, 0, os.sched_param(0)); any(False for _ in iter(int, 1))"
"""With ordinary priority, though this process may not have it."""

Stamps = Sequence[int]
Play = Callable[[int, str, float], dict[str, Stamps]]
"""From rate, load and seconds to the times of setpoints in ns, of one kind or several."""
Side = Callable[[bool], contextlib.AbstractContextManager[Play]]
"""Told whether to run first."""


def steadiness(stamps_ns: Stamps, hz: int, seconds: float) -> dict[str, float]:
    """Of what came after the first ``SETTLE_S``."""
    period_us = 1e6 / hz
    if not stamps_ns:
        raise RuntimeError(f"no setpoint came at {hz} Hz")
    settled = [t_ns for t_ns in stamps_ns if t_ns > stamps_ns[0] + SETTLE_S * NS]
    off_us = [abs((after - before) / 1e3 - period_us) for before, after in itertools.pairwise(settled)]
    expected = hz * (seconds - SETTLE_S) - 2  # the first and the last are cut
    if not off_us:  # the rollout ended before
        return {"p99_us": seconds * 1e6, "late_pct": 100.0}
    on_time = sum(off <= period_us / 4 for off in off_us)
    return {"p99_us": percentile(off_us, 0.99), "late_pct": max(0.0, 100 * (1 - on_time / expected))}


@contextlib.contextmanager
def cores_taken(taken: bool) -> Iterator[None]:
    spinners = [
        subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range((os.cpu_count() or 1) if taken else 0)
    ]
    try:
        time.sleep(0.2 if taken else 0.0)
        yield
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()


def run_first() -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


# -- a C loop


def c_loop(program: str, fifo: bool, hz: int, load: str, seconds: float) -> dict[str, Stamps]:
    command = [program, str(hz), str(seconds), str(int(fifo)), str(int(load == "computing"))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {"": [int(line) for line in done.stdout.split()]}


@contextlib.contextmanager
def c(fifo: bool) -> Iterator[Play]:
    with tempfile.TemporaryDirectory() as directory:
        program = str(Path(directory) / "steady")
        subprocess.run(["gcc", "-O2", "-pthread", "-o", program, str(HERE / "steady.c")], check=True)
        yield functools.partial(c_loop, program, fifo)


# -- loops of Python


def python_loop(hz: int, load: str, seconds: float) -> dict[str, Stamps]:
    """Of one thread that does nothing else: clock_nanosleep, and the interpreter around it."""
    stamps, start = [], time.monotonic()
    with computing_beside(hz, load):
        for step in range(1, round(hz * seconds)):
            time.sleep(max(0.0, start + step / hz - time.monotonic()))
            stamps.append(time.monotonic_ns())
    return {"": stamps}


def relayed_loop(hz: int, load: str, seconds: float) -> dict[str, Stamps]:
    """As ``python_loop``, with the stamp taken by another process, which is told at each tick."""
    ours, theirs = socket.socketpair()
    with tempfile.NamedTemporaryFile() as file:
        stamper = os.fork()
        if stamper == 0:
            ours.close()
            stamps = array.array("q")
            while theirs.recv(1):
                stamps.append(time.monotonic_ns())
            Path(file.name).write_bytes(stamps.tobytes())
            os._exit(0)
        theirs.close()
        start = time.monotonic()
        with ours, computing_beside(hz, load):
            for step in range(1, round(hz * seconds)):
                time.sleep(max(0.0, start + step / hz - time.monotonic()))
                ours.send(b"x")
        os.waitpid(stamper, 0)
        return {"": array.array("q", Path(file.name).read_bytes())}


def trio_loop(hz: int, load: str, seconds: float) -> dict[str, Stamps]:
    import trio

    async def main() -> list[int]:
        stamps, start = [], trio.current_time()
        for step in range(1, round(hz * seconds)):
            await trio.sleep_until(start + step / hz)
            stamps.append(time.monotonic_ns())
        return stamps

    with computing_beside(hz, load):
        return {"": trio.run(main)}


@contextlib.contextmanager
def computing_beside(hz: int, load: str) -> Iterator[None]:
    end = threading.Event()
    thread = threading.Thread(target=compute, args=(Busy(hz), end))
    if load == "computing":
        thread.start()
    try:
        yield
    finally:
        end.set()
        if load == "computing":
            thread.join()


def compute(policy: Still, end: threading.Event) -> None:
    """As a rollout asks: a chunk for every 50 ms."""
    while not end.is_set():
        began_s = time.monotonic()
        policy.get_actions_sync({})
        end.wait(max(0.0, 0.05 - (time.monotonic() - began_s)))


def in_this_process(play: Play) -> Side:
    @contextlib.contextmanager
    def side(fifo: bool) -> Iterator[Play]:
        if fifo:
            run_first()
        yield play

    return side


# -- the reference


def strands_rollout(hz: int, load: str, seconds: float) -> dict[str, Stamps]:
    from rtde_control import FRAMES  # the stand-in
    from strands_robots import Robot

    arm = Robot("ur5e", mode="real", driver="strands", port="127.0.0.1", control_frequency=hz)
    must(arm.connect_eagerly())
    FRAMES.clear()
    arm.run_policy(policy_of(load, hz), duration=seconds)
    wait_for_the_end(arm, seconds)
    arm.cleanup()
    return {"": [t_ns for t_ns, _ in FRAMES]}


@contextlib.contextmanager
def strands(fifo: bool) -> Iterator[Play]:
    if fifo:
        run_first()
    sys.path.insert(0, str(HERE / "standins"))
    yield strands_rollout


# -- ours


def our_rollout(fifo: bool, path: str, hz: int, load: str, seconds: float) -> dict[str, Stamps]:
    from benchmarks.sides.stamper import RECORD, ROBOT
    from strands_actors import Robot

    Path(path).unlink(missing_ok=True)
    robot = Robot(ROBOT, mode="real", port=path, hz=hz, fifo=fifo)
    with contextlib.ExitStack() as stack:
        stack.callback(robot.cleanup)
        must(next((None for _ in range(TRIES) if robot.connect_eagerly() is None), "it does not start"))
        answer = robot.run_policy(policy_of(load, hz), duration=seconds, control_frequency=float(hz))
        if answer["status"] != "success":
            raise RuntimeError(str(answer))
        wait_for_the_end(robot, seconds)
    frames = [frame for frame in struct.iter_unpack(RECORD.format, Path(path).read_bytes()) if not frame[2]]
    fresh = [after[0] for before, after in itertools.pairwise(frames) if after[1] != before[1]]
    return {"": fresh, "wire_": [frame[0] for frame in frames]}


@contextlib.contextmanager
def ours(fifo: bool) -> Iterator[Play]:
    from benchmarks.sides.stamper import ROBOT, Stamper
    from benchmarks.stage import at_home
    from strands_actors.drivers import register_native_driver

    at_home()
    register_native_driver(ROBOT, Stamper)
    if fifo:
        run_first()
    with tempfile.TemporaryDirectory() as directory:
        yield functools.partial(our_rollout, fifo, f"{directory}/frames")


# -- all of them


def policy_of(load: str, hz: int) -> Still:
    return Busy(hz) if load == "computing" else Still(hz)


def must(problem: str | None) -> None:
    if problem is not None:
        raise RuntimeError(problem)


def wait_for_the_end(robot: Any, seconds: float) -> None:
    time.sleep(seconds + 0.2)
    until_s = time.monotonic() + 5.0
    while robot.get_task_status()["content"][0]["json"]["running"] and time.monotonic() < until_s:
        time.sleep(0.05)


SIDES = {
    "ours": ours,
    "strands": strands,
    "trio": in_this_process(trio_loop),
    "python": in_this_process(python_loop),
    "relayed": in_this_process(relayed_loop),
    "c": c,
}


def main(who: str, length: str, scheduling: str) -> None:
    share = SHORT if length == "short" else 1.0
    figures: dict[str, float] = {}
    with SIDES[who](scheduling == "yes") as play:
        for hz, load in itertools.product(RATES, LOADS):
            seconds = SECONDS[hz] * share
            with cores_taken(load == "busy"):
                played = play(hz, load, seconds)
            for kind, stamps in played.items():
                found = steadiness(stamps, hz, seconds)
                figures |= {f"{kind}{hz}hz_{load}_{name}": value for name, value in found.items()}
    print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
