"""A connection that is kept open for a time of need: a stop channel's, made anew after each
loss."""

from __future__ import annotations

from typing import Protocol

import trio

from strands_actors.contract.driver import WireDown

REOPEN_S = 0.2
"""Pause before a connection that was lost is made anew."""


class Connection(Protocol):
    async def connect(self) -> None:
        """Connect, if it is not. Raise ``WireDown``."""
        ...

    async def hear(self) -> None:
        """Take in what comes, until cancelled. Raise ``WireDown`` when it is lost."""
        ...


async def keep_connected(
    connection: Connection, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED
) -> None:
    """Keep it open until cancelled. ``started`` with the first; raise ``WireDown`` without one."""
    await connection.connect()
    task_status.started()
    while True:
        try:
            await connection.connect()
            await connection.hear()
        except WireDown:  # whoever needs it meanwhile connects by itself
            await trio.sleep(REOPEN_S)
