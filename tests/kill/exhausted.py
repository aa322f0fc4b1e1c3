"""Exhaust a resource while the robot moves, then kill processes, and read the wire log.

Most resources are taken away from one process, from outside. ``MACHINE`` are those that all processes of
the robot lack at the same time.
"""

from __future__ import annotations

import contextlib
import enum
import itertools
import os
import resource
import secrets
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import monotonic_ns

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.health.failure_detector import LONGEST_S
from strands_actors.kernel.health.processor import Life, life_of
from strands_actors.kernel.processes.process import FENCE_S, exists, wait_for_end_of
from strands_actors.supervisors.standby.watch import look_s, silent_s
from strands_actors.testing.bench import CAMERA, Bench, Caller
from strands_actors.testing.cells import (
    Expected,
    Outcome,
    ask_to_break,
    persevere,
    read,
    require_motion,
    until_safe,
    with_story,
)

from .broken_disk import Disk, broken, full_shared_memory
from .by_signal import sitecustomize as by_signal

TAKES_EFFECT_S = 0.15
"""Time between the exhaustion and the kill. A process that must end for it has ended by then."""
SETTLE_S = 0.4
GONE_S = 1.0
"""A standby that ends because it is exhausted has ended by then."""
REPLACED_S = 20.0
"""Timeout for the next standby, on a busy machine."""
READY_S = 4.0
"""Time until the next standby has its stop channel."""
GROUPS = Path("/sys/fs/cgroup")
_GROUP = f"strands-tests-{secrets.token_hex(4)}"  # in another container the same pid may exist


class Roles(enum.StrEnum):
    ROOT = "root"
    WIRE = "wire"
    STANDBY = "standby"
    EVERY = "every process"


class Lacks(enum.StrEnum):
    """The exhausted resource."""

    LEAK = "free files"  # all free descriptors are in use, but the reserve of the process is not
    FILES = "files"  # a limit of 0, so that a closed descriptor cannot be reused either
    TABLE = "system files"  # the whole system's table of open files is full
    MEMORY = "memory"  # address space
    THREADS = "threads"  # and processes
    DISK = "disk"  # no file may grow
    CPU = "cpu"  # the signal SIGXCPU
    GROUP_MEMORY = "cgroup memory"
    GROUP_CPU = "cgroup cpu"
    SHARED_MEMORY = "shared memory"  # /dev/shm is full, and a camera uses it
    RUN_DIRECTORY = "run directory"  # it is read-only
    CLOCK = "steady clock"  # the wall clock is set ahead by an hour, and then back


MACHINE = (Lacks.SHARED_MEMORY, Lacks.RUN_DIRECTORY, Lacks.CLOCK)
"""The robot moves on without these, until processes are killed. The role of a row is then the process that
must act."""

KILLED = {
    Roles.ROOT: (Roles.WIRE,),
    Roles.WIRE: (Roles.ROOT,),
    Roles.STANDBY: (Roles.ROOT, Roles.WIRE),
    Roles.EVERY: (Roles.WIRE,),
}
"""By exhausted role: the roles that are killed then, so that the exhausted process should act."""


@dataclass(frozen=True)
class Row:
    role: Roles
    lacks: Lacks

    def __str__(self) -> str:
        return f"{self.role}-{self.lacks}".replace(" ", "-")


def take(lacks: Lacks, pid: int) -> None:
    """Take a resource away from a process."""
    match lacks:
        case Lacks.LEAK:
            descriptors = {int(name) for name in os.listdir(f"/proc/{pid}/fd")}
            _limit(pid, resource.RLIMIT_NOFILE, next(free for free in itertools.count() if free not in descriptors))
        case Lacks.FILES:
            _limit(pid, resource.RLIMIT_NOFILE, 0)
        case Lacks.TABLE:
            os.kill(pid, by_signal.FULL_TABLE)
            while by_signal.FILTERED not in Path(f"/proc/{pid}/status").read_text():
                time.sleep(0.001)
        case Lacks.MEMORY:
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[0])
            _limit(pid, resource.RLIMIT_AS, pages * resource.getpagesize())
        case Lacks.THREADS if os.geteuid() == 0:  # RLIMIT_NPROC does not bind root
            _join("pids", pid, {"pids.max": 1})
        case Lacks.THREADS:
            _limit(pid, resource.RLIMIT_NPROC, 0)
        case Lacks.DISK:
            _limit(pid, resource.RLIMIT_FSIZE, 0)
        case Lacks.CPU:
            os.kill(pid, signal.SIGXCPU)  # the kernel does the same when RLIMIT_CPU is used up
        case Lacks.GROUP_MEMORY:
            _join("memory", pid, {"memory.limit_in_bytes": 1 << 16})
        case Lacks.GROUP_CPU:
            # 1 ms of each second, for real-time processes too.
            ordinary = {"cpu.cfs_period_us": 1_000_000, "cpu.cfs_quota_us": 1_000}
            _join("cpu", pid, {**ordinary, "cpu.rt_period_us": 1_000_000, "cpu.rt_runtime_us": 1_000})


def _limit(pid: int, limit: int, value: int) -> None:
    _, hard = resource.prlimit(pid, limit)
    resource.prlimit(pid, limit, (value, hard))


def _join(controller: str, pid: int, settings: dict[str, int]) -> None:
    """Put a process into a new control group (version 1) with these settings."""
    group = GROUPS / controller / f"{_GROUP}-{pid}"
    group.mkdir()
    for name, value in settings.items():
        (group / name).write_text(str(value))
    (group / "cgroup.procs").write_text(str(pid))


def leave_groups() -> None:
    """Remove the control groups whose processes have ended."""
    for group in GROUPS.glob(f"*/{_GROUP}-*"):
        with contextlib.suppress(OSError):  # the process is still ending
            group.rmdir()


@contextlib.contextmanager
def can_get_signals() -> Iterator[None]:
    """Make ``Lacks.TABLE`` and ``Lacks.CLOCK`` possible for processes that are started in this context."""
    folder = str(Path(by_signal.__file__).parent)
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        sys.path.remove(folder)


@contextlib.contextmanager
def machine_lacks(lacks: Lacks, bench: Bench, caller: Caller) -> Iterator[None]:
    """Take a resource of ``MACHINE`` away from all processes of a robot."""
    match lacks:
        case Lacks.SHARED_MEMORY:
            with full_shared_memory(bench.template.pid):
                yield
        case Lacks.RUN_DIRECTORY:
            with broken(caller.run_dir, Disk.READ_ONLY):
                yield
        case Lacks.CLOCK:
            for number in by_signal.CLOCK_STEPS_S:
                for pid in {caller.process.pid, *caller.pids().values()}:
                    _set_clock(pid, number)
                time.sleep(TAKES_EFFECT_S)
            yield
        case _:
            yield


def _set_clock(pid: int, number: int) -> None:
    """Send a signal that sets the clock, and wait until the process has set it."""
    status = Path(f"/proc/{pid}/status")
    assert number in _signals(status, "SigCgt"), f"process {pid} would end"
    os.kill(pid, number)
    while number not in _signals(status, "SigIgn"):
        time.sleep(0.001)


def _signals(status: Path, mask: str) -> set[int]:
    line = next(line for line in status.read_text().splitlines() if line.startswith(mask))
    bits = int(line.split()[1], 16)
    return {number for number in range(1, signal.NSIG) if bits >> (number - 1) & 1}


def can_group(controller: str) -> bool:
    """Return whether this user may make control groups of version 1."""
    folder = GROUPS / controller
    return os.geteuid() == 0 and os.access(folder, os.W_OK) and (folder / "tasks").exists()


GROUPED = [
    lacks
    for lacks, controller in ((Lacks.GROUP_MEMORY, "memory"), (Lacks.GROUP_CPU, "cpu"))
    if can_group(controller)
]
"""Only where this user may make control groups of version 1."""


def processes(caller: Caller, role: Roles) -> list[int]:
    """Return the processes of a role.

    Raises:
        NotMoving: There is no such process.
    """
    if role is Roles.EVERY:
        return [caller.pid(each) for each in (Roles.ROOT, Roles.WIRE, Roles.STANDBY)]
    return [caller.pid(role)]


def _children(parent: int, name: str) -> list[int]:
    pids = Path(f"/proc/{parent}/task/{parent}/children").read_text().split()
    return [int(pid) for pid in pids if Path(f"/proc/{pid}/comm").read_text().startswith(name)]


def motion_of(driver: Driver) -> str:
    return "rollout" if driver.TASKS else "loop" if driver.ROLLOUTS else "task"


def bound_s_of(driver: Driver, lacks: Lacks) -> float:
    """Return the bound: two processes act one after the other, each within its own bound.

    A resource of ``MACHINE`` is not needed for a stop, so it does not change the bound of the robot. A
    process without a processor is detected by its silence. It also needs a processor to end when it is
    killed, and the next process waits for that end.
    """
    if lacks in MACHINE:
        return driver.bound_s
    usual_s = 2 * driver.bound_s
    if lacks is not Lacks.GROUP_CPU:
        return usual_s
    return LONGEST_S + silent_s(driver.timing) + look_s(driver.timing) + FENCE_S + usual_s


def run_exhausted(bench: Bench, row: Row, settle_s: float = SETTLE_S) -> Outcome:
    """Move the robot, exhaust a role, kill others, and read the wire."""

    def trial(caller: Caller) -> Outcome:
        return trio.run(_exhaust, bench, caller, row, settle_s)

    extras = frozenset({CAMERA}) if row.lacks is Lacks.SHARED_MEMORY else frozenset()
    try:
        return persevere(bench, motion_of(bench.driver), trial, drop=True, extras=extras)
    finally:
        leave_groups()


async def _exhaust(bench: Bench, caller: Caller, row: Row, settle_s: float) -> Outcome:
    killed = [pid for role in KILLED[row.role] for pid in processes(caller, role)]
    queue = bench.queue(caller)
    exhausted_ns = monotonic_ns()
    with machine_lacks(row.lacks, bench, caller):
        if row.lacks is Lacks.LEAK:  # The process itself leaks, as a faulty program does.
            await ask_to_break(caller, row.role, "leak")
        elif row.lacks not in MACHINE:
            for pid in processes(caller, row.role):
                take(row.lacks, pid)
        await trio.sleep(TAKES_EFFECT_S)
        if row.lacks in MACHINE:
            require_motion(bench.log, monotonic_ns())
        elif row.role is Roles.STANDBY:
            await _replaced(caller)
        killed_ns = monotonic_ns()
        for pid in killed:
            with contextlib.suppress(ProcessLookupError):  # the process has already ended
                os.kill(pid, signal.SIGKILL)
        await until_safe(bench.log, exhausted_ns, queue)
        waited_ms = queue.waited_ms()
        bound_s = bound_s_of(bench.driver, row.lacks)
        await trio.sleep(settle_s + bound_s)
    require_motion(bench.log, exhausted_ns)
    fallbacks = bench.driver.fallbacks
    states = tuple(dict.fromkeys(fallbacks[reason] for reason in (Reason.WIRE, Reason.ROOT, Reason.FAULT)))
    if row.lacks is Lacks.LEAK and row.role is Roles.ROOT:
        assert life_of(caller.pid(row.role)) == Life(), "the root acts itself"
        assert exists(caller.pid(row.role)), "the root acts itself"
    expected = Expected(row.role, row.lacks, states, bound_s * 1e3)
    return with_story(read(bench.log, expected, exhausted_ns, killed_ns, 0.0, waited_ms), bench.log, exhausted_ns)


async def _replaced(caller: Caller) -> None:
    """Wait for the next standby, if the exhausted one ends."""
    before, root = caller.pid(Roles.STANDBY), caller.pid(Roles.ROOT)
    has_ended = False
    with trio.move_on_after(GONE_S):
        await wait_for_end_of(before)
        has_ended = True
    if has_ended:
        with trio.fail_after(REPLACED_S):
            while not _standby_of(root):  # noqa: ASYNC110  # another process changes this, so there is no event
                await trio.sleep(0.02)
        await trio.sleep(READY_S)


def _standby_of(root: int) -> bool:
    """Return whether a root has a standby: its child, or its spawner's."""
    for child in (root, *map(int, Path(f"/proc/{root}/task/{root}/children").read_text().split())):
        with contextlib.suppress(OSError):  # the process has ended meanwhile
            if _children(child, "strands-standby"):
                return True
    return False
