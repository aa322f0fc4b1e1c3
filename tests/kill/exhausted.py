"""Take a resource away from one process of a robot that moves, from outside, and see what the wire
shows when a process of it is killed then."""

from __future__ import annotations

import contextlib
import enum
import os
import resource
import signal
from collections.abc import Sequence
from pathlib import Path
from time import monotonic_ns

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.testing.bench import Bench, Caller
from strands_actors.testing.cells import Expected, Outcome, persevere, read, require_motion, told, until_safe

TAKES_EFFECT_S = 0.15
"""Between the exhaustion and the kill: a process that cannot live with it has ended by then."""
SETTLE_S = 0.4


class Roles(enum.StrEnum):
    ROOT = "root"
    WIRE = "wire"
    STANDBY = "standby"
    STOP = "stop process"  # the root's
    EVERY = "every process"


class Lacks(enum.StrEnum):
    LEAK = "all files in use"  # those that were free; what a process holds in reserve it can free
    FILES = "no file at all"  # a limit of 0: what is freed cannot be opened again either
    MEMORY = "no address space"
    DISK = "no byte of any file"
    CPU = "no processor time"


def take(lacks: Lacks, pid: int) -> None:
    """Take the resource away from a process."""
    match lacks:
        case Lacks.LEAK:
            _limit(pid, resource.RLIMIT_NOFILE, _first_free(pid))
        case Lacks.FILES:
            _limit(pid, resource.RLIMIT_NOFILE, 0)
        case Lacks.MEMORY:
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
            _limit(pid, resource.RLIMIT_AS, pages * resource.getpagesize())
        case Lacks.DISK:
            _limit(pid, resource.RLIMIT_FSIZE, 0)
        case Lacks.CPU:
            os.kill(pid, signal.SIGXCPU)  # as the kernel does when RLIMIT_CPU is used up


def _limit(pid: int, limit: int, value: int) -> None:
    _, hard = resource.prlimit(pid, limit)
    resource.prlimit(pid, limit, (value, hard))


def _first_free(pid: int) -> int:
    """Return the lowest number that no descriptor of a process has."""
    used = {int(name) for name in os.listdir(f"/proc/{pid}/fd")}
    return next(number for number in range(len(used) + 1) if number not in used)


def processes(caller: Caller, role: Roles) -> list[int]:
    """Return the processes of a role. Raise ``NotMoving`` when there is none."""
    if role is Roles.STOP:
        return _stop_processes(caller.pid("root"))
    if role is Roles.EVERY:
        own = [caller.pid(each) for each in (Roles.ROOT, Roles.WIRE, Roles.STANDBY)]
        return [*own, *_stop_processes(own[0]), *_stop_processes(own[2])]
    return [caller.pid(role)]


def _stop_processes(parent: int) -> list[int]:
    children = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(pid) for pid in children if Path(f"/proc/{pid}/comm").read_text().startswith("strands-stop")]


def motion_of(driver: Driver) -> str:
    return "rollout" if driver.TASKS else "loop" if driver.ROLLOUTS else "task"


def run_exhausted(
    bench: Bench, role: Roles, lacks: Lacks, killed: Sequence[Roles] = (Roles.WIRE,), settle_s: float = SETTLE_S
) -> Outcome:
    """Move the robot, exhaust a role, kill others, and read the wire. The robot is not used again."""

    def trial(caller: Caller) -> Outcome:
        return trio.run(_exhaust, bench, caller, role, lacks, killed, settle_s)

    return persevere(bench, motion_of(bench.driver), trial, drop=True)


async def _exhaust(
    bench: Bench, caller: Caller, role: Roles, lacks: Lacks, killed: Sequence[Roles], settle_s: float
) -> Outcome:
    pids = processes(caller, role)
    victims = [pid for each in killed for pid in processes(caller, each)]
    queue = bench.queue(caller)
    began_ns = monotonic_ns()
    for pid in pids:
        take(lacks, pid)
    await trio.sleep(TAKES_EFFECT_S)
    killed_ns = monotonic_ns()
    for pid in victims:
        with contextlib.suppress(ProcessLookupError):  # the exhaustion has ended it
            os.kill(pid, signal.SIGKILL)
    await until_safe(bench.log, began_ns, queue)
    stood_ms = queue.stood_ms()
    bound_s = bound_s_of(bench.driver)
    await trio.sleep(settle_s + bound_s)
    require_motion(bench.log, began_ns)
    fallbacks = bench.driver.fallbacks
    states = tuple(dict.fromkeys(fallbacks[reason] for reason in (Reason.WIRE, Reason.ROOT, Reason.FAULT)))
    expected = Expected(role, lacks, states, bound_s * 1e3)
    return told(read(bench.log, expected, began_ns, killed_ns, 0.0, stood_ms), bench.log, began_ns)


def bound_s_of(driver: Driver) -> float:
    """Two processes are gone, and none is frozen: the bound of the pair. A root that finds out only
    by a stop that fails has used its own first."""
    return 2 * driver.bound_s
