"""SAF-024: one process of a robot has exhausted a resource, and then another process is killed.

The resources are files, memory, threads, disk and processor time. The wire must show the safe state:
the exhausted process writes it, or it ends and the next process writes it. All processes of the robot
lack a resource of ``MACHINE`` at once (shared memory, the run directory, a steady clock). No stop needs one
of these, so each process must be able to stop the robot within its usual bound.

Processes and wires are real. A row is a wire, and a cell is a process and its exhausted resource.
Limits are set from outside (``exhausted.py``). Ordinary runs have one cell for each type of stop
channel, and the cells of ``MACHINE`` for one robot. Only a Crazyflie on radio or USB has stop processes:
``tests/contract/test_stop_process.py`` and ``tests/drivers/crazyflie/test_usb.py`` exhaust them.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.contract.loading import load
from strands_actors.drivers import WIRES
from strands_actors.surfaces.cameras.picture_files import pictures_dir
from strands_actors.testing import Bench, Twin
from strands_actors.testing.still_camera import SETTINGS
from tests.answers import pids, resumed, status, until, why

from .broken_disk import Disk, broken, can_mount, small, small_shared_memory
from .exhausted import GROUPED, SETTLE_S, Lacks, Roles, Row, can_get_signals, leave_groups, run_exhausted, take

Start = Callable[..., tuple[RealRobot, Twin]]

FIRST = {"feetech": "so101"}  # the policy of the bench moves an SO-100 past its travel
ROBOTS = [FIRST.get(wire, load(where).SUPPORTED_ROBOTS[0]) for wire, where in WIRES.items()]
PLAIN = [Lacks.FILES, Lacks.MEMORY, Lacks.THREADS, Lacks.DISK, Lacks.CPU]
ONE_BY_ONE = (Roles.ROOT, Roles.WIRE, Roles.STANDBY)
ROWS = [Row(role, lacks) for role in ONE_BY_ONE for lacks in (*PLAIN, *GROUPED)]
FULL_TABLE = [Row(Roles.ROOT, Lacks.TABLE), Row(Roles.WIRE, Lacks.TABLE)]
"""There is no row of the standby. It acts last, and no other process could open the files either."""
LEAKS = [Row(Roles.ROOT, Lacks.LEAK), Row(Roles.WIRE, Lacks.LEAK)]
EVERYBODY = [Row(Roles.EVERY, Lacks.THREADS), Row(Roles.EVERY, Lacks.DISK)]
"""Resources of a whole container, which all of its processes lack at once."""
MOUNTED = [Lacks.RUN_DIRECTORY, Lacks.SHARED_MEMORY] if can_mount() else []
"""Only where this user may mount a file system."""
WHOLE = [Row(role, lacks) for lacks in (Lacks.CLOCK, *MOUNTED) for role in ONE_BY_ONE]
"""Shared memory comes last, because it needs another bench."""

QUICK = {
    ("so101", Roles.ROOT, Lacks.FILES),  # DuplicateDescriptor
    ("xarm7", Roles.ROOT, Lacks.FILES),  # ConnectWhenNeeded; the root ends
    ("panda", Roles.ROOT, Lacks.FILES),  # WatchedFirmware; the root ends
    ("rby1", Roles.ROOT, Lacks.FILES),  # KeptSession
    ("xarm7", Roles.ROOT, Lacks.TABLE),  # ConnectWhenNeeded: a descriptor that it closes cannot be opened again
    ("ur3e", Roles.ROOT, Lacks.LEAK),  # three sockets, and the root stays
    *(("so101", row.role, row.lacks) for row in WHOLE if row.lacks is not Lacks.SHARED_MEMORY),
    *(("so101", Roles.ROOT, lacks) for lacks in MOUNTED if lacks is Lacks.SHARED_MEMORY),
}


def marks_of(robot: str, row: Row) -> tuple[pytest.MarkDecorator, ...]:
    return () if (robot, row.role, row.lacks) in QUICK else (pytest.mark.long,)


CELLS = [
    pytest.param(robot, row, marks=marks_of(robot, row), id=f"{robot}-{row}")
    for robot in ROBOTS
    for row in (*ROWS, *FULL_TABLE, *LEAKS, *EVERYBODY, *WHOLE)
]


@pytest.fixture(scope="module")
def benches() -> Iterator[dict[str, Bench]]:
    """Hold the one bench in use. Cells are ordered by robot, and a bench ends when the next begins."""
    benches: dict[str, Bench] = {}
    yield benches
    for bench in benches.values():
        bench.__exit__(None, None, None)


def bench_of(robot: str, row: Row, benches: dict[str, Bench]) -> Bench:
    is_small = row.lacks is Lacks.SHARED_MEMORY
    name = f"{robot} with little shared memory" if is_small else robot
    if name not in benches:
        for other in list(benches):
            benches.pop(other).__exit__(None, None, None)
        with can_get_signals(), small_shared_memory() if is_small else contextlib.nullcontext():
            benches[name] = Bench(robot).__enter__()
    return benches[name]


@pytest.mark.parametrize(("robot", "row"), CELLS)
def test_saf_024_one_process_is_exhausted_and_the_wire_is_safe(
    robot: str, row: Row, benches: dict[str, Bench]
) -> None:
    outcome = run_exhausted(bench_of(robot, row, benches), row)
    assert outcome.all_motors, f"no {outcome.safe_state} frame for all motors, but {outcome.story}"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.on_time, outcome.story


def test_every_wire_has_a_row_of_every_process_and_resource() -> None:
    rows = {(robot, row.role, row.lacks) for robot, row in (cell.values for cell in CELLS)}
    wires = {robot for robot, _, _ in rows}
    assert len(wires) == len(WIRES)
    for robot in wires:
        for role in ONE_BY_ONE:
            assert {(robot, role, lacks) for lacks in (*PLAIN, Lacks.CLOCK, *MOUNTED)} <= rows
    assert rows >= QUICK


def test_saf_024_a_standby_that_lacks_files_is_replaced_and_motion_goes_on(strands_robot: Start) -> None:
    arm, twin = strands_robot("xarm7")
    before = pids(arm)
    began_ns = time.monotonic_ns()
    take(Lacks.FILES, before["standby"])
    after = until(
        lambda: now if (now := pids(arm)).get("standby", 0) not in (0, before["standby"]) else None, "a new standby"
    )
    until(lambda: status(arm)["standby"] == "ready", "the standby is ready")
    assert {role: after[role] for role in ("root", "wire")} == {role: before[role] for role in ("root", "wire")}
    assert twin.log.first_safe(began_ns) is None


@pytest.mark.skipif(Lacks.GROUP_MEMORY not in GROUPED, reason="this user may not make control groups of version 1")
def test_saf_024_an_idle_standby_that_lacks_memory_is_replaced_before_it_has_to_act(strands_robot: Start) -> None:
    """An idle standby uses no new memory. The kernel would end it in the middle of the stop that is its task."""
    arm, twin = strands_robot("xarm7")
    time.sleep(IDLE_S)
    before = pids(arm)
    began_ns = time.monotonic_ns()
    try:
        take(Lacks.GROUP_MEMORY, before["standby"])
        after = until(
            lambda: now if (now := pids(arm)).get("standby", 0) not in (0, before["standby"]) else None,
            "a new standby",
        )
    finally:
        leave_groups()
    until(lambda: status(arm)["standby"] == "ready", "the standby is ready")
    assert {role: after[role] for role in ("root", "wire")} == {role: before[role] for role in ("root", "wire")}
    assert twin.log.first_safe(began_ns) is None


def test_saf_024_a_wire_that_lacks_files_is_not_armed(strands_robot: Start) -> None:
    arm, twin = strands_robot("so101")
    assert arm.stop()["status"] == "success"
    wire = pids(arm)["wire"]
    before = resource.prlimit(wire, resource.RLIMIT_NOFILE)
    requested_ns = time.monotonic_ns()
    take(Lacks.FILES, wire)
    assert "no file can be opened" in why(arm.resume())
    assert twin.log.host("enable", requested_ns) == []
    resource.prlimit(wire, resource.RLIMIT_NOFILE, before)
    resumed(arm)
    assert twin.log.host("enable", requested_ns)


def test_saf_024_a_robot_without_room_for_its_pictures_is_not_started_and_says_so(
    strands_twin: Callable[..., Twin], strands_run_dir: Path
) -> None:
    twin, folder = strands_twin("so101"), pictures_dir(make=True)
    arm = Robot("so101", mode="real", port=twin.port, cameras={"eye": SETTINGS})
    try:
        # A disk is full only where this user may mount one. A missing directory has a similar effect.
        how = Disk.FULL if can_mount() else Disk.GONE
        with small(folder) if how is Disk.FULL else contextlib.nullcontext(), broken(folder, how):
            problem = arm.connect_eagerly()
            assert problem is not None and str(folder) in problem
            assert twin.log.host("enable") == []
        assert arm.connect_eagerly() is None
    finally:
        arm.cleanup()


IDLE_S = 2.0
"""After this time a standby has used all memory that it uses while it waits."""
KILLS = (("root", "wire"), ("wire",), ("root",))
DISKS = [
    pytest.param(how, killed, id=f"{how}-{'+'.join(killed)}", marks=() if killed == KILLS[0] else pytest.mark.long)
    for how in ((Disk.GONE, Disk.FULL) if can_mount() else (Disk.GONE,))
    for killed in KILLS
]
"""A disk is full only where this user may mount one. A read-only one is ``Lacks.RUN_DIRECTORY``."""


@pytest.fixture
def run_disk(request: pytest.FixtureRequest, strands_run_dir: Path) -> Iterator[Disk]:
    """Return the fault of the run directory. For a full disk, mount a small one there."""
    with small(strands_run_dir) if request.param is Disk.FULL else contextlib.nullcontext():
        yield request.param


@pytest.mark.parametrize(("run_disk", "killed"), DISKS, indirect=["run_disk"])
def test_saf_024_without_a_run_directory_the_wire_is_safe(
    run_disk: Disk, strands_robot: Start, strands_run_dir: Path, killed: tuple[str, ...]
) -> None:
    """No note, lock or report can be written."""
    arm, twin = strands_robot("robotiq_2f85")
    assert arm.send_action({"gripper": arm.get_observation()["gripper"] + 0.05})["status"] == "success"
    processes = pids(arm)
    with broken(strands_run_dir, run_disk):
        with pytest.raises(OSError):
            (strands_run_dir / "another").touch()
        killed_ns = time.monotonic_ns()
        for role in killed:
            os.kill(processes[role], signal.SIGKILL)
        safe = until(lambda: twin.log.first_safe(killed_ns), "a process makes the robot safe")
        assert safe.safe_state == "hold"
        time.sleep(SETTLE_S)
        twin.log.no_setpoint_after_safe(killed_ns)
