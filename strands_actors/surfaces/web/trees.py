"""The processes and actors of the robots on this computer, as ``strands-actors tree`` shows them."""

from __future__ import annotations

from typing import Any

import trio
from starlette.requests import Request
from starlette.routing import Route

from strands_actors.caller.handle import envelopes
from strands_actors.caller.processes import directory
from strands_actors.caller.processes.directory import Directory
from strands_actors.caller.processes.run_directory import Note
from strands_actors.kernel.processes.process import state_of
from strands_actors.supervisors.root.messages import TreeReport

from .access import Role, Session
from .answers import Bad, order, robot_of

PERIOD_S = 0.5
"""Time between two looks at a robot that a page shows."""
SHOWN_S = 3.0
"""A robot is asked for so long after a page has requested its tree."""
PATIENCE_S = 3.0
"""How long a page waits for the first look at a robot."""


class Trees:
    """Asks the robots that pages show for their trees. A robot that no page shows is not asked."""

    def __init__(self) -> None:
        self._shown_until_s: dict[str, float] = {}
        self._reports: dict[str, TreeReport] = {}
        self._requested = trio.Event()
        self._looked = trio.Event()

    def routes(self) -> list[Route]:
        return [Route("/robots/{robot}/tree", order(self._tree, Role.VIEWER), methods=["GET"])]

    async def run(self) -> None:
        """Ask the robots until cancelled."""
        while True:
            await self._requested.wait()
            self._requested = trio.Event()
            async with directory.join() as joined:
                while joined.is_current() and (shown := self._shown()):
                    await self._look(joined, shown)
                    await trio.sleep(PERIOD_S)
            if self._shown():
                self._requested.set()
            else:
                self._reports.clear()

    def _shown(self) -> set[str]:
        now = trio.current_time()
        self._shown_until_s = {name: until for name, until in self._shown_until_s.items() if until > now}
        return set(self._shown_until_s)

    async def _look(self, joined: Directory, shown: set[str]) -> None:
        reports: dict[str, TreeReport] = {}
        async with trio.open_nursery() as nursery:

            async def ask(note: Note) -> None:
                reports[note.robot] = await joined.tree(note)

            for note in joined.notes:
                if note.robot in shown:
                    nursery.start_soon(ask, note)
        self._reports = reports
        self._looked.set()
        self._looked = trio.Event()

    async def _tree(self, request: Request, session: Session) -> dict[str, Any]:
        robot = robot_of(request)
        is_new = robot not in self._shown_until_s
        self._shown_until_s[robot] = trio.current_time() + SHOWN_S
        self._requested.set()
        if is_new:
            with trio.move_on_after(PATIENCE_S):
                # A look may have begun without this robot, so the next one counts, too.
                for _ in range(2):
                    if robot not in self._reports:
                        await self._looked.wait()
        report = self._reports.get(robot)
        if report is None:
            raise Bad(
                404,
                f"{robot} does not run on the computer of this console, under the same user. "
                "`strands-actors tree` shows its actors there.",
            )
        tree = envelopes.tree(report)
        for process in tree["processes"]:
            process["state"] = state_of(process["pid"])
        return tree
