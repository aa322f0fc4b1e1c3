"""Get the data for ``top``: ask every robot of this user for its state a few times per second, in a separate
thread.

The thread also sends stops and resumes. It never acquires the right to command a robot, and robots are not
affected when ``top`` ends.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import NamedTuple

import trio

from strands_actors.caller.processes import directory
from strands_actors.caller.processes.directory import Directory
from strands_actors.caller.processes.run_directory import Note
from strands_actors.kernel.processes.process import state_of
from strands_actors.supervisors.gate.messages import Status
from strands_actors.supervisors.root.messages import TreeReport
from strands_actors.surfaces.cli.operate import VERBS

PERIOD_S = 0.4


class RobotSnapshot(NamedTuple):
    """The state of one robot at one time."""

    at_s: float  # Time of the state, by time.monotonic().
    note: Note
    tree: TreeReport
    status: Status | None  # None if the wire process does not answer.
    processes: dict[int, str]  # By pid: "running", "frozen" or "ended", as the operating system reports.


Show = Callable[[list[RobotSnapshot]], None]
ShowResult = Callable[[str, bool], None]
"""Takes a line for the user, and whether the verb succeeded."""


class Feed:
    """The thread that asks the robots for their states. It calls ``show`` with these states, and ``show_result``
    with the result of each stop or resume."""

    def __init__(self, show: Show, show_result: ShowResult) -> None:
        self._show = show
        self._show_result = show_result
        self._began = threading.Event()
        self._thread = threading.Thread(target=trio.run, args=(self._main,), name="top-feed", daemon=True)

    def start(self) -> None:
        self._thread.start()
        self._began.wait()

    def close(self) -> None:
        """End the thread. Wait until stops and resumes in progress have finished."""
        self._token.run_sync_soon(self._scope.cancel)
        self._thread.join()

    def ask(self, verb: str, robot: str) -> None:
        """Start a verb of ``operate.VERBS`` (stop, e-stop or resume) for a robot. ``show_result`` is called
        with the result."""
        self._token.run_sync_soon(self._start, verb, robot)

    # -- in the thread's event loop

    async def _main(self) -> None:
        self._token = trio.lowlevel.current_trio_token()
        self._joined: Directory | None = None
        async with trio.open_nursery() as self._verbs:
            with trio.CancelScope() as self._scope:
                self._began.set()
                while True:
                    await self._watch()

    async def _watch(self) -> None:
        """Ask the robots for their states until a robot starts or ends. Then connect again, to the new set of
        robots."""
        async with directory.join() as joined, trio.open_nursery() as self._nursery:
            self._joined = joined
            try:
                while joined.is_current():
                    self._show(await _look(joined))
                    await trio.sleep(PERIOD_S)
            finally:
                self._joined = None

    def _start(self, verb: str, robot: str) -> None:
        joined = self._joined
        if joined is None:  # The feed is just connecting again, so the verb makes a separate connection.
            self._verbs.start_soon(self._join_and_carry_out, verb, robot)
        else:
            self._nursery.start_soon(self._carry_out, joined, verb, robot)

    async def _join_and_carry_out(self, verb: str, robot: str) -> None:
        async with directory.join() as joined:
            await self._carry_out(joined, verb, robot)

    async def _carry_out(self, joined: Directory, verb: str, robot: str) -> None:
        with trio.CancelScope(shield=True):  # Finish a requested stop even if ``top`` ends.
            note = next((note for note in joined.notes if note.robot == robot), None)
            if note is None:
                self._show_result(f"{verb} {robot}: it is not running any more", False)
                return
            done, line = await VERBS[verb](joined, note)
            self._show_result(f"{verb} {robot}: {line}", done)


async def _look(joined: Directory) -> list[RobotSnapshot]:
    robots: dict[str, RobotSnapshot] = {}

    async def look(note: Note) -> None:
        trees: list[TreeReport] = []
        statuses: list[Status | None] = []

        async def ask_root() -> None:
            trees.append(await joined.tree(note))

        async def ask_gate() -> None:
            statuses.append(await joined.status(note))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(ask_root)
            nursery.start_soon(ask_gate)
        states = {process.pid: state_of(process.pid) for process in trees[0].processes}
        robots[note.robot] = RobotSnapshot(time.monotonic(), note, trees[0], statuses[0], states)

    async with trio.open_nursery() as nursery:
        for note in joined.notes:
            nursery.start_soon(look, note)
    return [robots[robot] for robot in sorted(robots)]
