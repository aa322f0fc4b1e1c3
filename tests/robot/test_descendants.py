"""The tree's report includes the processes that its processes have started, from the system's process list."""

from __future__ import annotations

from strands_actors.caller.processes.descendants import Entry, complete
from strands_actors.supervisors.root.messages import ProcessInfo, TreeReport

LISTED = {"caller": 10, "root": 20, "standby": 30, "twin": 40}
REPORT = TreeReport("so101", "armed", 1, tuple(ProcessInfo(role, pid, 0) for role, pid in LISTED.items()), ())


def added(table: dict[int, Entry]) -> dict[str, int]:
    shown = complete(REPORT, {pid: Entry(1, "") for pid in LISTED.values()} | table)
    assert shown.processes[: len(LISTED)] == REPORT.processes
    return {process.role: process.pid for process in shown.processes[len(LISTED) :]}


def test_a_process_that_the_tree_has_started_is_named_after_its_parent() -> None:
    table = {31: Entry(30, "stop"), 32: Entry(30, "stop"), 21: Entry(20, "ssh"), 22: Entry(21, "helper")}
    assert added(table) == {"root/ssh": 21, "root/helper": 22, "standby/stop": 31, "standby/stop/2": 32}


def test_processes_that_the_user_has_started_do_not_belong_to_the_tree() -> None:
    assert (
        added({11: Entry(10, "python3"), 41: Entry(40, "ffmpeg"), 50: Entry(1, "cron"), 60: Entry(99, "x")}) == {}
    )
    assert added({20: Entry(10, "root")}) == {}, "the root is listed already"
