"""A node: the actors of one process."""

from __future__ import annotations

from collections.abc import Callable

import trio

from .actor import Actor, Cell
from .asks import Answer, AskTimeout, Unreachable
from .ref import PROMPT, ActorRef, Ref, Sent
from .router import PREFIX, DeadLetter, Router
from .ways import Connection, Mesh

__all__ = [
    "PREFIX",
    "PROMPT",
    "ActorRef",
    "Answer",
    "AskTimeout",
    "Connection",
    "DeadLetter",
    "Mesh",
    "Node",
    "Ref",
    "Sent",
    "Unreachable",
]


class Node(Router):
    """The actors of one process. Start a node with ``async with open_nursery() as n: await n.start(node.run)``."""

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Let requests (asks) expire that were not answered in time. It runs as long as the node."""
        task_status.started()
        await self.deadlines.run()

    def cell(self, path: str, factory: Callable[[], Actor], role: str = "") -> Cell:
        """Return the cell of a new actor: its address and its mailbox. Pass the cell's ``run`` to a supervisor.

        Args:
            path: ``<robot>/actor/<name>``.
            factory: Makes the actor of each incarnation.
            role: The name in lists of actors. Empty for the last part of ``path``.
        """
        return Cell(self, f"{PREFIX}/{path}", factory, role)
