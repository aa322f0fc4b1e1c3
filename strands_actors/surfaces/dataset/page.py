"""Serve the recorder's keys as a web page, for touch screens and gamepads.

The page is for an operator that cannot reach the recorder's terminal. The web page of a teleoperation has these
keys, too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from strands_actors.caller.handle.stop_lines import stop_by_name
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.surfaces.web.operating import OperatorPage

from .run import Command, Onlooker


async def serve_keys(
    robot: str, host: str, port: int, shown: Onlooker, command: Command, tell: Callable[[str], None]
) -> None:
    """Serve the web page with the recorder's keys, until cancelled.

    Args:
        robot: The robot's name.
        host: The address to listen at.
        port: The TCP port.
        shown: The object that keeps the newest state of the recording, which the page shows.
        command: Called with the word of each pressed key and the time of the press.
        tell: Called with the URL of the page.

    Raises:
        CannotListen: The port cannot be opened.
    """

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

    page = OperatorPage(
        MonotonicClock(), lambda operated: None, press, stop, status, [], [], f"recording of {robot}"
    )
    await page.serve(host, port, tell)
