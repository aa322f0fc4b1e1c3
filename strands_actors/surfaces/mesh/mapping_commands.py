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
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.command_rules import no_action
from strands_actors.supervisors.refusals import REMEDY

from . import refusals
from .client import ANSWER_S, BEGIN_S, PRESENCE_S, MeshClient
from .outcome import Outcome

LOOK_S = 0.02
TO_ALL = (*mesh_json.READING, mesh_json.Stop)
"""Commands that may be sent to all robots at once."""

Command = Mapping[str, Any] | str
"""A command, or only its action."""


async def send(mesh: MeshClient, robot: str, command: Command) -> dict[str, Any] | Refused:
    """Send a command and return its result. A command that moves the robot gets a deadline. If it cannot
    begin within ``BEGIN_S``, it is not carried out."""
    checked, command_class = _read(command)
    if isinstance(command_class, Refused):
        return command_class
    if command_class is mesh_json.Stop:
        return _result_of([await mesh.stop(robot, _by(checked))], robot)
    if command_class is mesh_json.Estop:
        return _result_of(await mesh.estop(_by(checked), robot=robot), robot)
    if command_class is mesh_json.Resume:
        return await mesh.resume(robot, _by(checked))
    if not issubclass(command_class, mesh_json.Dated):
        return await mesh.request(robot, checked)

    def make(clock: str, deadline_ns: int) -> dict[str, Any]:
        return {**checked, "clock": clock, "deadline_ns": deadline_ns}

    return await mesh.dated(robot, make, BEGIN_S, BEGIN_S + ANSWER_S)


async def send_to_all(mesh: MeshClient, command: Command) -> dict[str, dict[str, Any] | Refused] | Refused:
    """Ask all robots for a reading, or stop all robots. Return the answers by robot. A command that moves
    robots is refused, because such a command must name one robot."""
    offered = [name for name, each in mesh_json.ACTIONS.items() if each in TO_ALL]
    checked, command_class = _read(command, offered)
    if isinstance(command_class, Refused):
        return command_class
    if command_class not in TO_ALL:
        return refusals.not_for_all(checked["action"], ", ".join(offered))
    answers: dict[str, dict[str, Any] | Refused] = {}

    async def ask(robot: str) -> None:
        answers[robot] = await send(mesh, robot, checked)

    await mesh.settle()
    async with trio.open_nursery() as nursery:
        for robot in mesh.robots:
            nursery.start_soon(ask, robot)
    lost = mesh.not_looked_for() if command_class is mesh_json.Stop else []
    return {
        **dict(sorted(answers.items())),
        **{each.robot: refusals.failed_search(each.detail) for each in lost},
    }


def stops(command: Command) -> bool:
    """Return True if a command is a stop. A stop is sent even if the mesh configuration is wrong."""
    return _read(command)[1] is mesh_json.Stop


async def peers(mesh: MeshClient, within_s: float = PRESENCE_S) -> list[dict[str, Any]]:
    """Return the robots on the mesh. Each row has ``peer_id``, ``type``, ``age`` (seconds since its presence
    message has come), ``reachable`` (whether one has come), and the fields of this message."""
    presences: dict[str, tuple[float, dict[str, Any]]] = {}

    def hear(received: Received) -> None:
        # Ignore a presence message that cannot be decoded. The robot is listed nevertheless.
        with contextlib.suppress(msgspec.DecodeError):
            presence = msgspec.json.decode(received.payload, type=dict[str, Any])
            presences[received.key.split("/")[1]] = trio.current_time(), presence

    mesh.subscribe(mesh_json.key("*", "presence"), hear)
    await mesh.settle()
    with trio.move_on_after(within_s):
        while not set(mesh.robots) <= set(presences):  # noqa: ASYNC110  # they come one by one
            await trio.sleep(LOOK_S)
    now, rows = trio.current_time(), []
    for robot in sorted({*mesh.robots, *presences}):
        received_s, presence = presences.get(robot, (now, {}))
        robot_type = presence.get("robot_type", "robot")
        rows.append(
            {
                **presence,
                "peer_id": robot,
                "type": robot_type,
                "age": now - received_s,
                "reachable": robot in presences,
            }
        )
    return rows


def _read(
    command: Command, offered: Sequence[str] = tuple(mesh_json.ACTIONS)
) -> tuple[dict[str, Any], type[mesh_json.Command] | Refused]:
    """Return the command as a dict, and the message class for its action. For an unknown action, return a
    refusal in place of the class. The refusal lists the actions in ``offered``."""
    unchecked: object = command  # The type is only a hint. A program may pass anything.
    if not isinstance(unchecked, Mapping | str):
        return {}, refusals.not_a_command(shown(unchecked), ", ".join(offered))
    checked = {"action": command} if isinstance(command, str) else {"action": "status", **command}
    action = str(checked["action"])
    command_class = mesh_json.ACTIONS.get(action)
    return checked, command_class or no_action(action, offered)


def _by(command: Mapping[str, Any]) -> Any:
    return command.get("by")


def _result_of(outcomes: list[Outcome], robot: str) -> dict[str, Any] | Refused:
    """Return the result of a stop for one robot: a dict if the robot is safe, otherwise a refusal."""
    outcome = next((each for each in outcomes if each.robot == robot), None)
    if outcome is None:
        return refusals.missing_robot(robot)
    match outcome.outcome:
        case "safe":
            result: dict[str, Any] = msgspec.to_builtins(outcome)
            return result
        case "unconfirmed":
            named = ", ".join(str(motor.get("axis")) for motor in outcome.motors if motor.get("safe") is not True)
            return refusals.unconfirmed(robot, named, outcome.detail, REMEDY)
        case "unreachable":
            return refusals.unreachable(outcome.detail, REMEDY)
        case _:
            assert_never(outcome.outcome)
