"""One cell of the kill matrix: break one process of a moving robot in one way, and read the wire.

``python -m strands_actors.testing.kill --robot so101 --repeats 20`` runs every cell, prints median and worst,
and ends with code 1 when one was unsafe or later than its published bound.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from time import monotonic_ns
from typing import Any, TypeVar

import trio
import trio.lowlevel

from strands_actors.factory import plan
from strands_actors.runtime.clock import MonotonicClock
from strands_actors.runtime.contract import Driver, Reason
from strands_actors.runtime.frames import TELL
from strands_actors.runtime.node import PREFIX, Node
from strands_actors.runtime.process import wait_for_end_of
from strands_actors.runtime.zenoh_mesh import ZenohMesh, unix_endpoint
from strands_actors.supervisors import addresses
from strands_actors.supervisors.census import ALLOW_FAULTS, Break
from strands_actors.supervisors.messages import LEASE_TTL_S

from .wirelog import Entry, WireLog

T = TypeVar("T")

VICTIMS = ("caller", "policy", "wire", "root")
FAULTS = ("exception", "exit", "SIGTERM", "SIGINT", "SIGKILL", "SIGSTOP", "spin")
LIVING = ("SIGSTOP", "spin")
"""Faults that leave the process there."""

SETTLE_S = 0.4
"""How long the wire is watched after the safe frame."""

STARTS = 3
"""A machine that pauses may stop the robot before anything was broken: then begin again."""


@dataclass(frozen=True)
class Outcome:
    """What the wire showed. Times in milliseconds, from the fault (or the death it led to)."""

    victim: str
    fault: str
    rung: str
    safe_ms: float
    bound_ms: float
    setpoints_after: int
    all_motors: bool
    gone_ms: float = 0.0  # a caller that ends by itself: from its last statement to its end

    @property
    def safe(self) -> bool:
        return self.all_motors and self.setpoints_after == 0


def driver_of(robot: str) -> Driver:
    """The driver of ``robot`` on its twin."""
    wanted = plan(robot, "real", transport="twin")
    return wanted.driver_class(wanted.robot, "", wanted.options)


def victims_of(driver: Driver) -> tuple[str, ...]:
    """A robot that runs no policies, or none apart from its caller, has no policy process."""
    return tuple(victim for victim in VICTIMS if victim != "policy" or not (driver.ROLLOUTS or driver.TASKS))


def bound_s(driver: Driver, victim: str, fault: str) -> float:
    """Published: the driver's after a death; after a freeze or a spin, what has to lapse before it too."""
    if fault not in LIVING:
        # An exception in a policy's own code is caught: the rollout ends, the process with it.
        return driver.bound_s
    timing = driver.timing
    beat_ttl_s = timing.beat_ttl_s
    caller_s = timing.oneshot_ttl_s or LEASE_TTL_S  # what it latched stands as long as its lease
    lapses_s = {"caller": caller_s, "policy": timing.stream_ttl_s, "wire": beat_ttl_s, "root": beat_ttl_s}
    return lapses_s[victim] + driver.bound_s


def expected_rung(driver: Driver, victim: str, fault: str) -> str:
    """The driver's, for the reason that the fault becomes."""
    living = fault in LIVING
    reasons = {
        "caller": Reason.LEASE if living else Reason.CALLER,
        "policy": Reason.EXPIRED if living else Reason.POLICY,
        "wire": Reason.WIRE,
        "root": Reason.ROOT,
    }
    return driver.ladder[reasons[victim]]


class NotMoving(Exception):
    """The caller ended before its robot moved."""


async def run_cell(victim: str, fault: str, robot: str = "so101") -> Outcome:
    """Start a robot, move it, break the victim, read the log. Ends everything it started."""
    for _ in range(STARTS - 1):
        with contextlib.suppress(NotMoving):
            return await _run_cell(victim, fault, robot)
    return await _run_cell(victim, fault, robot)


async def _run_cell(victim: str, fault: str, robot: str) -> Outcome:
    driver = driver_of(robot)
    motion = "loop" if victim == "caller" or driver.ROLLOUTS or driver.TASKS else "task"
    if driver.TASKS and (victim, fault) != ("caller", "spin"):  # a rollout goes on beside a thread that computes
        motion = "rollout"
    far = "10" if "degrees" in driver.unit else "0.1"
    with (
        tempfile.TemporaryDirectory(prefix="sa-") as directory,
        _caller(Path(directory), robot, motion, far) as caller,
    ):
        return await _break(caller, driver, victim, fault)


@dataclass
class _Running:
    process: subprocess.Popen[str]
    tree: dict[str, Any]
    log: WireLog
    trigger: Path
    run_dir: Path

    def pid(self, role: str) -> int:
        found: int = next(entry["pid"] for entry in self.tree["processes"] if entry["role"] == role)
        return found

    def line(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        text = self.process.stdout.readline()
        if not text:
            raise NotMoving("the caller ended before its robot moved")
        told: dict[str, Any] = json.loads(text)
        return told

    def policy_broke_ns(self) -> int:
        told = Path(f"{self.trigger}.t")
        return int(told.read_text() or 0) if told.exists() else 0

    def tell(self, how: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(how + "\n")
        self.process.stdin.flush()


@contextlib.contextmanager
def _caller(directory: Path, robot: str, motion: str, far: str) -> Iterator[_Running]:
    log, trigger = directory / "wire.ndjson", directory / "trigger"
    environment = {
        **os.environ,
        "STRANDS_ACTORS_TWIN_LOG": str(log),
        "STRANDS_ACTORS_RUN": str(directory / "run"),
        ALLOW_FAULTS: "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
    }
    with subprocess.Popen(
        [sys.executable, "-m", "strands_actors.testing.caller", robot, motion, far, str(trigger)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as process:
        running = _Running(process, {}, WireLog(log), trigger, directory / "run")
        try:
            running.tree = running.line()
            yield running
        finally:
            process.kill()
            for entry in running.tree.get("processes", ()):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(entry["pid"], signal.SIGKILL)


async def _break(running: _Running, driver: Driver, victim: str, fault: str) -> Outcome:
    pid = running.pid(victim)
    died_ns: list[int] = []

    async def watch() -> None:
        await wait_for_end_of(pid)
        died_ns.append(monotonic_ns())

    async with trio.open_nursery() as nursery:
        nursery.start_soon(watch)
        await trio.lowlevel.checkpoint()
        began_ns = await _inflict(running, victim, fault, pid)
        await _until_safe(running.log, began_ns)
        await trio.sleep(SETTLE_S)
        if fault == "SIGSTOP" and victim != "caller":
            # A frozen process that is let go again must not write: it was fenced, or has no way to.
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
            await trio.sleep(SETTLE_S)
        nursery.cancel_scope.cancel()
    rung = expected_rung(driver, victim, fault)
    bound_ms = bound_s(driver, victim, fault) * 1e3
    safe = next((entry for entry in running.log.host("safe", began_ns) if is_rung(entry, rung)), None)
    first = running.log.first_safe(began_ns)
    if safe is None or first is None:
        return Outcome(victim, fault, rung, float("inf"), bound_ms, -1, False)
    caller_died = victim == "caller" and fault not in LIVING
    since_ns = died_ns[0] if caller_died and died_ns else began_ns
    return Outcome(
        victim,
        fault,
        rung,
        max(0.0, (safe.t_ns - since_ns) / 1e6),
        bound_ms,
        running.log.setpoints_after_safe(began_ns),
        True,
        (died_ns[0] - began_ns) / 1e6 if caller_died and died_ns else 0.0,
    )


async def _inflict(running: _Running, victim: str, fault: str, pid: int) -> int:
    """Break the victim; the time at which it broke."""
    if fault.startswith("SIG"):
        began_ns = monotonic_ns()
        os.kill(pid, getattr(signal, fault))
        return began_ns
    if victim == "caller":
        running.tell(fault)
        began: int = (await trio.to_thread.run_sync(running.line))["at_ns"]
        return began
    if victim == "policy":
        running.trigger.write_text(fault)
        return await _until(running.policy_broke_ns)
    return await _ask_to_break(running, victim, fault)


async def _ask_to_break(running: _Running, victim: str, fault: str) -> int:
    robot = running.tree["robot"]
    node = Node(f"kill.{os.getpid()}", MonotonicClock())
    mesh = await ZenohMesh.open(connect=[unix_endpoint(str(running.run_dir / f"{robot}.{victim}.sock"))])
    try:
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            mesh.attach(node)
            await nursery.start(mesh.run)
            address = f"{PREFIX}/{addresses.of(robot).census(victim)}"

            def tell() -> int | None:
                # the time before: what it causes may be on the wire before we run again
                began_ns = monotonic_ns()
                return began_ns if node.send_frame(address, TELL, 0, node.address, Break(fault)) else None

            began_ns = await _until(tell)
            nursery.cancel_scope.cancel()
    finally:
        await trio.to_thread.run_sync(mesh.close)
    return began_ns


async def _until_safe(log: WireLog, since_ns: int) -> None:
    with contextlib.suppress(trio.TooSlowError):
        await _until(lambda: log.first_safe(since_ns))


async def _until(look: Callable[[], T | None]) -> T:
    """Look until there is something to see, for 5 s."""
    with trio.fail_after(5.0):
        while not (seen := look()):  # noqa: ASYNC110  # another process's doing: there is no event
            await trio.sleep(0.002)
    return seen


def is_rung(entry: Entry, rung: str) -> bool:
    """Whether a safe frame brings the whole robot to ``rung``; on a wire that does not say, each does."""
    return entry.rung is None or entry.rung == rung


def _summary(outcomes: list[Outcome]) -> dict[str, Any]:
    times = sorted(outcome.safe_ms for outcome in outcomes)
    first = outcomes[0]
    return {
        "victim": first.victim,
        "fault": first.fault,
        "rung": first.rung,
        "trials": len(outcomes),
        "median_ms": round(statistics.median(times), 1),
        "worst_ms": round(times[-1], 1),
        "bound_ms": round(first.bound_ms),
        "setpoints_after": sum(outcome.setpoints_after for outcome in outcomes),
        "gone_worst_ms": round(max(outcome.gone_ms for outcome in outcomes), 1),
        "safe": all(outcome.safe and outcome.safe_ms <= outcome.bound_ms for outcome in outcomes),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="so101")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--victim", choices=VICTIMS, action="append")
    parser.add_argument("--fault", choices=FAULTS, action="append")
    options = parser.parse_args()
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell's background job ignores it, and so its children
    every_safe = True
    victims = victims_of(driver_of(options.robot))
    for victim in options.victim or victims:
        for fault in options.fault or FAULTS:
            row = _summary([trio.run(run_cell, victim, fault, options.robot) for _ in range(options.repeats)])
            every_safe = every_safe and row["safe"]
            print(json.dumps(row), flush=True)
    return 0 if every_safe else 1


if __name__ == "__main__":
    sys.exit(main())
