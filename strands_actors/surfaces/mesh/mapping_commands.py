"""Send commands in the form of strands-robots, ``{"action": ...}``, to one robot or to all."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, assert_never

import msgspec
import trio

from strands_actors.contract.shown import shown
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.command_rules import no_action
from strands_actors.supervisors.stop_result import REMEDY

from .client import ANSWER_S, BEGIN_S, PRESENCE_S, MeshClient
from .outcome import Outcome

LOOK_S = 0.02
TO_ALL = (*mesh_json.READING, mesh_json.Stop)
"""Commands that may be sent to all robots at once."""

Command = Mapping[str, Any] | str
"""A command, or only its action."""


async def send(mesh: MeshClient, robot: str, command: Command) -> dict[str, Any] | Refused:
    """Send a command and return its result. A command that moves the robot gets a deadline here: it begins
    within ``BEGIN_S``, or never."""
    given, kind = _read(command)
    if isinstance(kind, Refused):
        return kind
    if kind is mesh_json.Stop:
        return _result_of([await mesh.stop(robot, _by(given))], robot)
    if kind is mesh_json.Estop:
        return _result_of(await mesh.estop(_by(given), robot=robot), robot)
    if kind is mesh_json.Resume:
        return await mesh.resume(robot, _by(given))
    if not issubclass(kind, mesh_json.Dated):
        return await mesh.request(robot, given)

    def make(clock: str, deadline_ns: int) -> dict[str, Any]:
        return {**given, "clock": clock, "deadline_ns": deadline_ns}

    return await mesh.dated(robot, make, BEGIN_S, BEGIN_S + ANSWER_S)


async def send_to_all(mesh: MeshClient, command: Command) -> dict[str, dict[str, Any] | Refused] | Refused:
    """Ask all robots for a reading, or stop all. Return the answers by robot. A command that moves a robot
    is refused; it goes to one robot at a time."""
    offered = [name for name, each in mesh_json.ACTIONS.items() if each in TO_ALL]
    given, kind = _read(command, offered)
    if isinstance(kind, Refused):
        return kind
    if kind not in TO_ALL:
        why = f"broadcast: {given['action']} is for one robot at a time"
        return Refused(Code.ONE_ROBOT, why, f"to all send {', '.join(offered)}; what moves one, send to that one")
    answers: dict[str, dict[str, Any] | Refused] = {}

    async def ask(robot: str) -> None:
        answers[robot] = await send(mesh, robot, given)

    await mesh.settle()
    async with trio.open_nursery() as nursery:
        for robot in mesh.robots:
            nursery.start_soon(ask, robot)
    lost = mesh.not_looked_for() if kind is mesh_json.Stop else []
    return {
        **dict(sorted(answers.items())),
        **{each.robot: Refused(Code.UNREACHABLE, each.detail) for each in lost},
    }


def stops(command: Command) -> bool:
    """Return True if a command is a stop, which must be sent in any case."""
    return _read(command)[1] is mesh_json.Stop


async def peers(mesh: MeshClient, within_s: float = PRESENCE_S) -> list[dict[str, Any]]:
    """Return the robots on the mesh. Each row has ``peer_id``, ``type``, ``age`` (seconds), ``reachable``,
    and the robot's own presence message."""
    heard: dict[str, tuple[float, dict[str, Any]]] = {}

    def hear(received: Received) -> None:
        with contextlib.suppress(msgspec.DecodeError):  # The robot is there, but its message is unreadable.
            presence = msgspec.json.decode(received.payload, type=dict[str, Any])
            heard[received.key.split("/")[1]] = trio.current_time(), presence

    mesh.subscribe(mesh_json.key("*", "presence"), hear)
    await mesh.settle()
    with trio.move_on_after(within_s):
        while not set(mesh.robots) <= set(heard):  # noqa: ASYNC110  # they come one by one
            await trio.sleep(LOOK_S)
    now, rows = trio.current_time(), []
    for robot in sorted({*mesh.robots, *heard}):
        at, presence = heard.get(robot, (now, {}))
        kind = presence.get("robot_type", "robot")
        rows.append({**presence, "peer_id": robot, "type": kind, "age": now - at, "reachable": robot in heard})
    return rows


def _read(
    command: Command, offered: Sequence[str] = tuple(mesh_json.ACTIONS)
) -> tuple[dict[str, Any], type[mesh_json.Command] | Refused]:
    """Return the command with its action, and its type, or a refusal. ``offered`` are the actions that
    the refusal lists."""
    unchecked: object = command  # Programs may pass any type.
    if not isinstance(unchecked, Mapping | str):
        why = f"the command is {shown(unchecked)}"
        return {}, Refused(Code.MALFORMED, why, f'give an action, or {{"action": ...}}: {", ".join(offered)}')
    given = {"action": command} if isinstance(command, str) else {"action": "status", **command}
    action = str(given["action"])
    kind = mesh_json.ACTIONS.get(action)
    return given, kind or no_action(action, offered)


def _by(given: Mapping[str, Any]) -> Any:
    return given.get("by")


def _result_of(outcomes: list[Outcome], robot: str) -> dict[str, Any] | Refused:
    """Return the result for a robot that is safe, and otherwise a refusal."""
    outcome = next((each for each in outcomes if each.robot == robot), None)
    if outcome is None:
        return Refused(Code.UNREACHABLE, f"{robot} is not on the mesh")
    match outcome.outcome:
        case "safe":
            result: dict[str, Any] = msgspec.to_builtins(outcome)
            return result
        case "unconfirmed":
            named = ", ".join(str(motor.get("axis")) for motor in outcome.motors if motor.get("safe") is not True)
            why = f"{robot}: not confirmed by {named or 'the robot'}"
            return Refused(Code.UNCONFIRMED, f"{why} ({outcome.detail})" if outcome.detail else why, REMEDY)
        case "unreachable":
            return Refused(Code.UNREACHABLE, outcome.detail, REMEDY)
        case _:
            assert_never(outcome.outcome)
