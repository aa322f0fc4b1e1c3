"""``tree``: show the running robots, as JSON or drawn."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING

import trio

from strands_actors.caller.handle import envelopes
from strands_actors.caller.processes import directory
from strands_actors.caller.processes.run_directory import Note
from strands_actors.caller.processes.strays import strays
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.root.messages import UNREACHABLE, ProcessInfo, TreeReport

if TYPE_CHECKING:
    from rich.text import Text
    from rich.tree import Tree

STATE_STYLES = {
    "armed": "bold green",
    "holding": "bold yellow",
    "arming": "yellow",
    "disarmed": "bold cyan",
    "running": "green",
    "frozen": "bold red",
    "ended": "bold red",
    "unreachable": "bold red",
    "no wire process": "bold red",
    "failed": "bold red",
    "unconfirmed": "bold red",
    "ending": "bold red",
}


def show_trees(as_json: bool) -> int:
    """Show the processes of all robots. Return 1 if a robot does not answer, because its state is then
    unknown."""
    reports = trio.run(_ask_all)
    code = int(any(report.state == UNREACHABLE for report in reports))
    if as_json:
        print(json.dumps({"robots": [envelopes.tree(report) for report in reports]}))
        return code
    from rich.console import Console

    console = Console()
    if not reports:
        console.print("no robot of this user is running")
    for report in reports:
        console.print(draw(report))
    return code


async def _ask_all() -> list[TreeReport]:
    reports: dict[str, TreeReport] = {}
    async with directory.join() as joined, trio.open_nursery() as nursery:

        async def ask(note: Note) -> None:
            reports[note.robot] = await joined.tree(note)

        for note in joined.notes:
            nursery.start_soon(ask, note)
    for stray in strays():  # These robots have running processes that cannot be reached by messages.
        root = ProcessInfo("root", stray.root, 0)
        reports.setdefault(stray.robot, TreeReport(stray.robot, UNREACHABLE, 0, (root,), ()))
    return [reports[robot] for robot in sorted(reports)]


def draw(report: TreeReport, states: Mapping[int, str] | None = None, introspection: bool = True) -> Tree:
    """Draw a robot's processes and actors.

    Args:
        report: The robot's processes and actors.
        states: The state of each process by pid. None if all are running.
        introspection: Show the actors that only observe, too.
    """
    from rich.text import Text
    from rich.tree import Tree

    epoch = f"  epoch {report.epoch}" if report.epoch else ""
    head = Text.assemble((report.robot, "bold"), "  ", state_of(report.state, report.locked_by), epoch)
    tree = Tree(head, guide_style="dim")
    actors = [
        actor for actor in report.actors if introspection or actor.role not in ("introspection", "instrument")
    ]
    width = max((len(_path(actor.address)) for actor in actors), default=0)
    for process in report.processes:
        state = (states or {}).get(process.pid, "running")
        label = Text.assemble((f"{process.role:<7} ", "bold"), f"pid {process.pid}")
        if state != "running":
            label.append("  ").append_text(styled(state))
        if process.restarts:
            label.append(f"  restarts {process.restarts}", "yellow")
        branch = tree.add(label)
        for actor in actors:
            if actor.pid == process.pid:
                leaf = Text.assemble(
                    f"{_path(actor.address):<{width}} ", styled(actor.state if state == "running" else state)
                )
                if actor.restarts:
                    leaf.append(f"  restarts {actor.restarts}", "yellow")
                branch.add(leaf)
    return tree


def state_of(state: str, locked_by: str) -> Text:
    """Return a robot's state for the screen. A lock by an e-stop is shown alone only if the robot is
    de-energised. Otherwise the state is shown, too."""
    from rich.text import Text

    if not locked_by:
        return styled(state)
    lock = Text(f"e-stopped by {locked_by}", "bold magenta")
    return lock if state == Mode.DISARMED else Text.assemble(styled(state), ", ", lock)


def styled(state: str) -> Text:
    from rich.text import Text

    return Text(str(state), STATE_STYLES.get(state.strip(), ""))


def _path(address: str) -> str:
    return address.partition("/actor/")[2]
