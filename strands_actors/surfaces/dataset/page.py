"""The keys of a recorder on a page of its own, for touch and gamepads: for who is not at its terminal,
and leads the robot by something that is no page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from strands_actors.caller.stop_lines import stop_by_name
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.teleoperation.page.server import Page

from .run import Command, Onlooker


async def serve_keys(
    robot: str, host: str, port: int, shown: Onlooker, command: Command, tell: Callable[[str], None]
) -> None:
    """Until cancelled. ``shown``: what the page shows; ``tell``: is told its address. Raise
    ``OSError``."""

    def status() -> dict[str, Any]:
        episode = msgspec.structs.asdict(shown.state)
        return {
            "state": "recording" if shown.state.running else "waiting",
            "why": "",
            "position": {},
            "episode": episode,
        }

    def press(t_ns: int, word: str) -> None:
        command(word, t_ns)

    async def stop() -> str:
        return await stop_by_name(robot, "the recorder's page")

    page = Page(MonotonicClock(), lambda operated: None, press, stop, status, [], f"recording of {robot}")
    await page.serve(host, port, tell)
