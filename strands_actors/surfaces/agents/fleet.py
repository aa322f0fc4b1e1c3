"""One tool for all robots of the mesh, for an agent or an MCP client.

    agent = strands.Agent(tools=[fleet()])

The tool has no special rights. It sends the commands that any program on the mesh may send. The gate of each robot
checks them, and the lease decides which program commands. A robot refuses a task that needs an approval, since it
cannot ask for one. Stops are always carried out.
"""

from __future__ import annotations

import asyncio
import threading
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

import msgspec
import trio

from strands_actors.caller.handle import envelopes as answers
from strands_actors.caller.handle.envelopes import Answer
from strands_actors.caller.session.portal import portal
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import MeshClient, open_mesh
from strands_actors.surfaces.mesh.mapping_commands import peers, send, send_to_all
from strands_actors.surfaces.mesh.outcome import SAFE
from strands_actors.surfaces.mesh.sync import Mesh

from . import refusals
from .approval import APPROVE_S, Approval, Approve, Request
from .fleet_calls import LIST, NAME, RUN, STATUS, STOP, FleetCall, read, spec
from .tool import StrandsTool

RUN_S = 30.0
"""Duration of a task, if the call has none."""


async def perform(mesh: MeshClient, call: FleetCall, by: str, motion: str = "") -> Answer:
    """Carry out a call.

    Args:
        mesh: The mesh.
        call: The call.
        by: The name of the program that asks.
        motion: Empty if tasks are allowed. Otherwise the remedy in their refusal.
    """
    if call.verb == LIST:
        return await _list(mesh)
    if call.verb == STATUS:
        return await _status(mesh, call.robot)
    if call.verb == RUN:
        return answers.refused(refusals.no_motion(RUN, motion)) if motion else await _run(mesh, call)
    return await _stop(mesh, call.robot, by)


async def _list(mesh: MeshClient) -> Answer:
    rows = [
        {
            "robot": row["peer_id"],
            "type": row.get("hw", row["type"]),
            "state": row.get("state", ""),
            "commanded_by": row.get("lease", ""),
            "locked_by": row.get("locked_by", ""),
            "answers": row["reachable"],
        }
        for row in await peers(mesh)
    ]
    return answers.success({"robots": rows, "silent": [row["robot"] for row in rows if not row["answers"]]})


async def _status(mesh: MeshClient, robot: str) -> Answer:
    if robot:
        await mesh.settle()
        return _answer(await send(mesh, robot, STATUS))
    replies = await send_to_all(mesh, STATUS)
    if isinstance(replies, Refused):
        return answers.refused(replies)
    rows = {
        name: {"refused": reply.text} if isinstance(reply, Refused) else reply for name, reply in replies.items()
    }
    return answers.success(
        {"robots": rows, "silent": [name for name, reply in replies.items() if isinstance(reply, Refused)]}
    )


async def _run(mesh: MeshClient, call: FleetCall) -> Answer:
    await mesh.settle()
    command = {
        "action": "start",
        "instruction": call.inputs["instruction"],
        "policy_provider": call.inputs["policy"],
        "duration": float(call.inputs.get("seconds", RUN_S)),
    }
    return _answer(await send(mesh, call.robot, command))


async def _stop(mesh: MeshClient, robot: str, by: str) -> Answer:
    """Stop one robot or all. The answer is an error unless every motor of each has confirmed it."""
    await mesh.settle()
    if robot:
        outcomes = [await mesh.stop(robot, by)]
    else:
        outcomes = []

        async def stop(name: str) -> None:
            outcomes.append(await mesh.stop(name, by))

        async with trio.open_nursery() as nursery:
            for name in mesh.robots:
                nursery.start_soon(stop, name)
        outcomes += mesh.not_looked_for()
    rows = [
        msgspec.to_builtins(msgspec.structs.replace(outcome, motors=()))
        for outcome in sorted(outcomes, key=lambda outcome: outcome.robot)
    ]
    failed = [outcome for outcome in outcomes if outcome.outcome != SAFE]
    if failed:
        named = ". ".join(f"{each.robot} is {each.outcome}: {each.detail}" for each in failed)
        return answers.error(f"{STOP}: {named}. Look at the robot, and cut its power if it moves", {"robots": rows})
    return answers.success({"robots": rows})


def _answer(reply: dict[str, Any] | Refused) -> Answer:
    return answers.refused(reply) if isinstance(reply, Refused) else answers.success(reply)


class ServedFleet:
    """The tool for an MCP server, in its trio loop.

    Args:
        mesh: The mesh, which stays open.
    """

    tool_name = NAME

    def __init__(self, mesh: MeshClient) -> None:
        self._mesh = mesh

    @property
    def tool_spec(self) -> dict[str, Any]:
        return spec()

    async def use_tool(self, tool_input: object, by: str, motion: str = "") -> Answer:
        """Carry out a tool's input.

        Args:
            tool_input: The input as the caller sent it.
            by: The name of the caller.
            motion: Empty if tasks are allowed. Otherwise the remedy in their refusal.
        """
        call = read(tool_input)
        return answers.refused(call) if isinstance(call, Refused) else await perform(self._mesh, call, by, motion)


class FleetTool(StrandsTool):
    """The tool for strands-agents. ``fleet`` makes it. It joins the mesh at its first use, and stays joined.

    Args:
        mesh: How to reach robots on other hosts.
        approve: Asks an operator before each task; None to leave the decision to the robots.
        approve_within_s: Seconds for the operator's answer.
    """

    tool_type = "fleet"

    def __init__(self, mesh: Mesh, approve: Approve | None = None, approve_within_s: float = APPROVE_S) -> None:
        self._config = mesh
        self._approval = Approval((RUN,) if approve is not None else (), approve, approve_within_s)
        self._joining = threading.Lock()
        self._joined: Future[MeshClient] | None = None
        self._staying: Future[None] | None = None

    @property
    def tool_name(self) -> str:
        return NAME

    @property
    def tool_spec(self) -> dict[str, Any]:
        return spec()

    async def use_tool(self, tool_input: object, by: str) -> Answer:
        """Carry out a tool's input, from an asyncio loop.

        Args:
            tool_input: The input as the caller sent it.
            by: The name of the caller.
        """
        call = read(tool_input)
        if isinstance(call, Refused):
            return answers.refused(call)
        request = Request(call.robot, call.verb, call.inputs, by)
        refusal = await asyncio.wrap_future(portal().submit(self._approval.refuse, request))
        if refusal is not None:
            return answers.refused(refusal)
        try:
            mesh = await asyncio.to_thread(self._join)
        except (OSError, ValueError) as error:
            return answers.error(f"{call.verb}: the mesh cannot be joined: {error}")
        return await asyncio.wrap_future(portal().submit(perform, mesh, call, by))

    def _join(self) -> MeshClient:
        """Return the client of the mesh, and join the mesh first if that was not done yet, or has ended.

        A wrong configuration does not prevent stops: the robots of this user are reached in any case.
        """
        with self._joining:
            if self._joined is None or self._staying is None or self._staying.done():
                joined: Future[MeshClient] = Future()

                async def stay() -> None:
                    async with open_mesh(self._config, to_stop=True) as client:
                        joined.set_result(client)
                        await trio.sleep_forever()

                self._joined, self._staying = joined, portal().submit(stay)
            either: list[Future[Any]] = [self._joined, self._staying]
            wait(either, return_when=FIRST_COMPLETED)
            if self._staying.done():
                self._staying.result()  # This raises the exception that ended the connection.
            return self._joined.result()

    def close(self) -> None:
        """Leave the mesh. A later call joins it again."""
        with self._joining:
            if self._staying is not None:
                self._staying.cancel()


def fleet(*, mesh: Mesh = None, approve: Approve | None = None, approve_within_s: float = APPROVE_S) -> FleetTool:
    """Return a tool for all robots of the mesh, for ``strands.Agent(tools=[fleet()])``.

    Its verbs are list, status, run, stop and stop_all. Each robot's own gate, lease and approval decide.

    Args:
        mesh: How to reach robots on other hosts: a configuration, or the path of its file. None: the file that
            ``STRANDS_ACTORS_MESH`` names.
        approve: Function that asks an operator before each ``run``, such as ``ask_on_console``. Only ``True``
            approves. The robot decides after that. None: only the robots decide.
        approve_within_s: Seconds for the operator's answer.
    """
    return FleetTool(mesh, approve, approve_within_s)
