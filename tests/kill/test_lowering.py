"""SAF-026: an arm whose script is killed is laid down and then limp, and an e-stop makes it limp at once.

Processes are real, and the arm falls in the simulation: its wire log has the frames, and the speed of every touch
of the table.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.surfaces.cli.matrix import lowering_columns
from strands_actors.testing import Cell, Faults, Twin, Victims, cells_of
from strands_actors.testing.bench import driver_of
from strands_actors.testing.caller import RAISED
from strands_actors.testing.lowering_trials import lowering_cells, run_lowering
from strands_actors.testing.pairs import Combination, Pair, pairs_of
from strands_actors.testing.wirelog import Entry
from tests.answers import until

from .conftest import BenchOf

ROBOTS = ("so101", "koch")
LIMIT_M_S = 0.25
"""Far below the speed of a fall from these poses. The bound of 0.15 m/s is asserted in virtual time, as are the
three seconds until the arm is limp."""

SCRIPT = """
import sys, time
from strands_actors import Robot

name, port, pose = sys.argv[1], sys.argv[2], eval(sys.argv[3])
robot = Robot(name, mode="real", port=port)
assert robot.connect_eagerly() is None
answer = robot.move_to(pose, seconds=2.0)
print("raised", flush=True)
for line in sys.stdin:
    print(exec(line) or "done", flush=True)
"""
"""Each line that it reads is a line of Python. It answers it with a line of its own."""


class Script:
    """A script that holds an arm raised, and carries out lines of Python."""

    def __init__(self, robot: str, twin: Twin) -> None:
        arguments = [sys.executable, "-c", SCRIPT, robot, twin.port, repr(RAISED[robot])]
        self.process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "raised\n"
        until(lambda: bool(twin.log.host("setpoint")), "the arm is moved")
        time.sleep(0.5)  # the arm stands
        self.twin = twin
        twin.log.host("read")

    def do(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


@contextmanager
def raised(robot: str, directory: Path) -> Iterator[Script]:
    with Twin(robot, directory) as twin:
        script = Script(robot, twin)
        try:
            yield script
        finally:
            script.end()


def first(twin: Twin, state: str, since_ns: int) -> Entry:
    """Wait for the first frame that brings the whole arm to a safe state, and return it."""

    def frames() -> list[Entry]:
        return [entry for entry in twin.log.host("safe", since_ns) if entry.safe_state == state]

    until(lambda: bool(frames()), f"the arm is {state}")
    return frames()[0]


def touches(twin: Twin, since_ns: int) -> dict[str, float]:
    """Return the greatest speed at which each link touched the table, after the arm came to rest."""
    time.sleep(1.5)
    speeds: dict[str, float] = {}
    for entry in twin.log.entries(since_ns):
        if entry.kind == "touch":
            touch = json.loads(entry.data)
            speeds[touch["body"]] = max(touch["speed_m_s"], speeds.get(touch["body"], 0.0))
    return speeds


@pytest.mark.parametrize("robot", ROBOTS)
def test_saf_026_a_killed_script_leaves_an_arm_that_is_laid_down_and_limp(tmp_path: Path, robot: str) -> None:
    with raised(robot, tmp_path) as script:
        twin, began_ns = script.twin, time.monotonic_ns()
        script.process.send_signal(signal.SIGKILL)
        hold = first(twin, "hold", began_ns)
        limp = first(twin, "limp", began_ns)
        assert hold.t_ns < limp.t_ns
        assert twin.log.host("lowering", hold.t_ns)
        assert twin.log.host("setpoint", hold.t_ns + 1) == []
        speeds = touches(twin, began_ns)
        assert speeds and max(speeds.values()) <= LIMIT_M_S, speeds


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("line", ["robot.stop()", "robot.cleanup()"])
def test_saf_026_a_stop_without_hurry_lays_the_arm_down(tmp_path: Path, robot: str, line: str) -> None:
    with raised(robot, tmp_path) as script:
        twin, began_ns = script.twin, time.monotonic_ns()
        script.do(line)
        first(twin, "limp", began_ns)
        assert twin.log.host("lowering", began_ns)
        speeds = touches(twin, began_ns)
        assert speeds and max(speeds.values()) <= LIMIT_M_S, speeds


def test_saf_026_a_further_stop_while_the_arm_is_lowered_makes_it_limp_at_once(tmp_path: Path) -> None:
    with raised("so101", tmp_path) as script:
        twin, began_ns = script.twin, time.monotonic_ns()
        script.do("import threading; threading.Thread(target=robot.stop).start()")
        hold = first(twin, "hold", began_ns)
        until(lambda: bool(twin.log.host("lowering", began_ns)), "the arm is lowered")
        again_ns = time.monotonic_ns()
        script.do("robot.stop()")
        limp = first(twin, "limp", began_ns)
        assert limp.t_ns - again_ns < 1_000_000_000, "the lowering alone takes longer"
        time.sleep(0.5)
        assert twin.log.host("setpoint", hold.t_ns + 1) == []
        assert [entry for entry in twin.log.host("lowering", limp.t_ns) if b"\x2a\x08" in entry.data] == []


COLUMNS = ("so101:lowering", "koch:lowering")
ROLES = ("caller", "wire", "root", "standby")
SETTLE_S = 0.2


def quick(column: str, cell: Cell | Pair) -> bool:
    """Return whether a cell belongs to the ordinary run. The matrix measures all of them."""
    kills = {fault for _, fault in cell.faults} <= {Faults.KILL, Faults.FREEZE} and cell.victim is not Victims.TWIN
    if isinstance(cell, Pair):
        last = {"wire", "root"} & set(cell.members)
        return column == COLUMNS[0] and bool(last) and cell.combination is not Combination.FREEZE_AND_KILL
    return kills and (column == COLUMNS[0] or cell.victim in (Victims.WIRE, Victims.ROOT))


CELLS = [
    pytest.param(column, cell, marks=() if quick(column, cell) else pytest.mark.long, id=f"{column}-{cell}")
    for column in COLUMNS
    for cell in lowering_cells([*cells_of(driver_of(column), ROLES), *pairs_of(driver_of(column), ROLES)])
    if not cell.why_not
]


@pytest.mark.parametrize(("column", "cell"), CELLS)
def test_saf_026_something_breaks_while_an_arm_is_lowered(
    column: str, cell: Cell | Pair, bench_of: BenchOf
) -> None:
    outcome = run_lowering(cell, bench_of(column), SETTLE_S)
    assert outcome.all_motors, f"the arm is not limp, but {outcome.story}"
    assert outcome.setpoints_after == 0, outcome.story
    assert outcome.on_time, outcome.story


def test_a_column_of_lowerings_is_of_an_arm_that_is_lowered() -> None:
    with pytest.raises(ValueError, match="ur5e is not lowered"):
        driver_of("ur5e:lowering")
    assert driver_of("so101:lowering").fallbacks[Reason.STOP] is SafeState.LOWERED
    assert driver_of("so101").fallbacks[Reason.STOP] is SafeState.LIMP
    assert lowering_columns() == ["koch:lowering", "openarm:lowering", "so100:lowering"], "one robot of each driver"


def test_a_policy_is_no_victim_of_a_lowering() -> None:
    cells = list(lowering_cells(cells_of(driver_of("so101:lowering"), ROLES)))
    assert {cell.why_not for cell in cells if cell.victim is Victims.POLICY and cell.fault is Faults.KILL} == {
        "the policy has ended before the arm is lowered"
    }
