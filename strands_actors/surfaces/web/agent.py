"""The agent of the console: one conversation, which all operators share.

The agent runs in a separate process, which starts with the first words to it. Stopping the agent kills this
process, and stops no robot.
"""

from __future__ import annotations

import os
import signal
import subprocess
from collections import deque
from typing import Any

import msgspec
import trio
from starlette.requests import Request
from starlette.routing import Route

from strands_actors.contract.shown import harmless
from strands_actors.kernel.processes.interpreter import PYTHON, environment
from strands_actors.kernel.processes.lines import lines_of

from . import agent_process
from .access import Role, Session
from .agent_process import Entry, Kind, Prompt
from .answers import Bad, body, order, sender

MOST_ENTRIES = 1000
"""Number of entries that a page can still get."""
LONGEST_LINE = 64 * 1024
LONGEST_PROMPT = 4000
_TURN_ENDS = (Kind.DONE, Kind.FAILED, Kind.ENDED)


class SayOrder(msgspec.Struct, forbid_unknown_fields=True):
    """Words to the agent."""

    text: str


class AgentPanel:
    """The conversation with the agent.

    Args:
        factory: ``module:function`` that makes the agent; empty for no agent.
        mesh: The file that configures the mesh; empty for the robots of this user.
        nursery: Runs the agent's process.
    """

    def __init__(self, factory: str, mesh: str, nursery: trio.Nursery) -> None:
        self.count = 0
        self.is_configured = bool(factory)
        self._command = [*PYTHON, "-m", agent_process.__name__, factory, mesh]
        self._nursery = nursery
        self._entries: deque[Entry] = deque(maxlen=MOST_ENTRIES)
        self._process: trio.Process | None = None
        self._is_busy = False

    def routes(self) -> list[Route]:
        return [
            Route("/agent/say", order(self._say, Role.OPERATOR), methods=["POST"]),
            Route("/agent/stop", order(self._stop, Role.OPERATOR), methods=["POST"]),
        ]

    def news(self, since: int, role: Role) -> dict[str, Any] | None:
        """Return the entries that a page does not have yet. Only operators see them."""
        if role is not Role.OPERATOR or not self.is_configured:
            return None
        new = self.count - max(0, since)
        entries = list(self._entries)[-new:] if new else []
        return {"type": "agent", "entries": entries, "first": since < 0, "busy": self._is_busy}

    def _put(self, entry: Entry) -> None:
        if entry.kind in _TURN_ENDS:
            self._is_busy = False
        self._entries.append(entry)
        self.count += 1

    async def _say(self, request: Request, session: Session) -> dict[str, Any]:
        words = await body(request, SayOrder)
        text = words.text.strip()
        if not self.is_configured:
            raise Bad(409, "This console has no agent. Start it with --agent MODULE:FUNCTION.")
        if not 0 < len(text) <= LONGEST_PROMPT:
            raise Bad(400, f"Words to the agent have 1 to {LONGEST_PROMPT} characters.")
        if self._is_busy:
            raise Bad(409, "The agent is busy. Wait until it has answered, or stop it.")
        self._is_busy = True
        self._put(Entry(Kind.PROMPT, text, by=sender(session)))
        if self._process is None:
            await self._nursery.start(self._run)
        process = self._process
        assert process is not None and process.stdin is not None
        try:
            await process.stdin.send_all(msgspec.json.encode(Prompt(text)) + b"\n")
        except (trio.BrokenResourceError, trio.ClosedResourceError):
            raise Bad(409, "The agent has ended. Say it again to start it anew.") from None
        return {"ok": True}

    async def _stop(self, request: Request, session: Session) -> dict[str, Any]:
        """Kill the agent's process. A question of it for an approval is withdrawn by that."""
        if self._process is None:
            raise Bad(409, "The agent does not run.")
        _kill(self._process)
        return {"ok": True}

    async def _run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Run the agent's process until it ends."""
        process = self._process = await trio.lowlevel.open_process(
            self._command, env=environment(), stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        task_status.started()
        try:
            await self._read(process)
        finally:
            _kill(process)
            with trio.CancelScope(shield=True):
                code = await process.wait()
            self._process = None
            self._put(Entry(Kind.ENDED, f"the agent's process has ended ({code}). It has forgotten what was said"))

    async def _read(self, process: trio.Process) -> None:
        """Take the lines of the process. It runs the user's code, so a line may be anything."""
        assert process.stdout is not None
        async for line in lines_of(process.stdout, LONGEST_LINE):
            try:
                entry = msgspec.json.decode(line, type=Entry)
            except (msgspec.MsgspecError, UnicodeDecodeError):
                continue
            self._put(msgspec.structs.replace(entry, text=_plain(entry.text), tool=harmless(entry.tool)))


def _kill(process: trio.Process) -> None:
    """Kill the process, and the processes that the user's code has started in it."""
    if process.returncode is None:
        os.killpg(process.pid, signal.SIGKILL)


def _plain(text: str) -> str:
    return "\n".join(harmless(line) for line in text.split("\n"))
