"""Programs of one user share a robot's socket. None can read the requests and answers of another, and none
gets another's rights by using its name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import trio

from strands_actors import Robot
from strands_actors.caller.processes.run_directory import notes
from strands_actors.kernel.channels.pubsub import PubSub, Received
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Accepted
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.command_rules import Limit
from strands_actors.supervisors.mesh.gateway_messages import Synced
from strands_actors.surfaces.mesh import MeshConfig, control
from strands_actors.surfaces.mesh.reach import reach
from strands_actors.testing import Twin
from tests.answers import json_of

from .world import PATIENCE_S, code, mesh, raw, robot_on_mesh, run, until


class Eavesdropper:
    """Connect to the sockets of all robots and subscribe to all topics."""

    def __init__(self) -> None:
        self.heard: list[Received] = []

    async def join(self, nursery: trio.Nursery) -> None:
        for note in notes():
            session = await PubSub.open(connect=note.mesh)
            session.subscribe("strands/**", self.heard.append, keep=10_000)
            await nursery.start(session.run)
        await until(lambda: self.topics("state"), "it hears")

    def topics(self, name: str) -> list[str]:
        return [each.key for each in self.heard if each.key.endswith(f"/{name}")]

    def knows(self, secret: str) -> bool:
        return any(secret.encode() in each.payload for each in self.heard)


def test_saf_009_no_other_program_receives_a_command_or_a_lease() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client, trio.open_nursery() as nursery:
            other = Eavesdropper()
            await other.join(nursery)
            clock = await client.clock(robot)
            assert not isinstance(clock, Refused)
            async with control(client, robot) as arm:
                assert not isinstance(await arm.send_action({"a": 0.05}), Refused)
                lease = (await tree.status()).holder
                assert client.sender in lease
                number = str(arm._lease)
            answer = await client.request(robot, mesh_json.Ping())
            assert not isinstance(answer, Refused)
            await raw(client, robot, b'{"sender_id": "put", "turn_id": "t", "command": {"action": "ping"}}')
            before = len(other.topics("state"))
            await until(lambda: len(other.topics("state")) > before + 1, "what was said before has arrived")
            assert not other.topics("cmd")
            answered = {each.key for each in other.heard if "/response/" in each.key or "/node/" in each.key}
            assert answered == {f"strands/put/response/{robot}/t"}, "a put is answered by a put"
            assert not other.knows(clock.name) and not other.knows(f'"lease":{number}')
            nursery.cancel_scope.cancel()

    run(test)


def test_saf_009_no_other_program_receives_a_message_to_a_program_by_name(tmp_path: Path, run_dir: Path) -> None:
    async def test() -> None:
        async with trio.open_nursery() as nursery:
            other = Eavesdropper()
            await other.join(nursery)
            async with reach("so101", MeshConfig()) as arm:
                gate: Any = arm._processes.gate
                assert gate._session
                answer = await arm.resume()
                assert not isinstance(answer, Refused), answer
                moved = await arm.send_action({"wrist_roll": 0.0})
                assert not isinstance(moved, Refused), moved
                assert isinstance(await trio.to_thread.run_sync(gate._sync_here, 10.0), Synced)
                moved = await trio.to_thread.run_sync(arm.send_action_here, {"wrist_roll": 0.0})
                assert isinstance(moved, Accepted), moved
            before = len(other.topics("state"))
            await until(lambda: len(other.topics("state")) > before + 1, "what was said before has arrived")
            assert not other.topics("gateway")
            assert not other.topics("threads"), "messages to one of its threads"
            assert not other.knows(gate._session)
            nursery.cancel_scope.cancel()

    with Twin("so101", tmp_path) as twin:
        robot = Robot("so101", mode="real", port=twin.port)
        try:
            assert robot.connect_eagerly() is None
            json_of(robot.release())
            run(test)
        finally:
            robot.cleanup()


def test_saf_009_a_sender_name_without_its_proof_gives_no_rights() -> None:
    """A program that uses the name of the lease's holder has neither the holder's clock nor its lease."""

    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as client, mesh() as other:  # noqa: SIM117
            async with control(client, robot) as arm:
                assert not isinstance(await arm.send_action({"a": 0.05}), Refused)
                other.sender = client.sender
                clock = await client.clock(robot)
                assert not isinstance(clock, Refused)

                def stolen(_: str, deadline_ns: int) -> mesh_json.Command:
                    return mesh_json.Acquire(clock=clock.name, deadline_ns=deadline_ns)

                assert code(await other.dated(robot, stolen, 0.5)) == "clock"
                acquire = await other.dated(
                    robot, lambda name, at: mesh_json.Acquire(clock=name, deadline_ns=at), 0.5
                )
                assert code(acquire) == "lease"
                move = mesh_json.Move(
                    clock=clock.name, deadline_ns=0, lease=arm._lease, epoch=arm._epoch, targets={"a": 0.1}
                )
                assert code(await other.request(robot, move)) == "lease"
                assert not isinstance(await arm.send_action({"a": 0.06}), Refused), "the holder still has its lease"

    run(test)


def test_an_unreadable_request_is_answered_to_its_sender() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as client:
            await until(lambda: client.is_there(robot), "it is there")
            via = client.sessions.via[robot]
            for payload, turn, code in (
                (b"{", "", "malformed"),
                (b"", "", "malformed"),
                (b'{"sender_id": "me", "command": {"action": "ping"}}', "", "malformed"),
                (b'{"sender_id": "me", "turn_id": "a b", "command": {"action": "ping"}}', "", "malformed"),
                (b'{"turn_id": "t", "command": {"action": "ping"}}', "t", "malformed"),
                (b'{"sender_id": "me", "turn_id": "t", "command": {"action": "fly"}}', "t", "unknown_action"),
            ):
                answers: list[Received] = []
                via.ask(mesh_json.command_key(robot, "me"), payload, "x", answers.append)
                await until(lambda answers=answers: answers, f"{payload!r} is answered")  # type: ignore[misc]
                result = msgspec.json.decode(answers[0].payload)
                assert (result["turn_id"], result["refused"]["code"]) == (turn, code)

    run(test)


def test_a_flood_of_requests_is_answered_but_only_partly_audited() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await until(lambda: client.is_there(robot), "it is there")
            audited: list[str] = []
            commands: Any = tree.node.cells[addresses.of(robot).commands].actor
            commands._shared.audit = lambda *told: audited.append(told[0])
            commands._refusals = Limit(0.0, 20)  # so that the result does not depend on the time this takes
            unanswered = {str(turn) for turn in range(60)}

            def hear(answer: Received) -> None:
                unanswered.discard(msgspec.json.decode(answer.payload)["turn_id"])

            def ask() -> None:
                """Urgent messages do not wait: a full link drops them."""
                for turn in unanswered:
                    command = {"sender_id": "me", "turn_id": turn, "command": {"action": "fly"}}
                    key = mesh_json.command_key(robot, "me")
                    client.sessions.via[robot].ask(key, msgspec.json.encode(command), "x", hear)

            with trio.fail_after(PATIENCE_S):
                while unanswered:
                    ask()
                    with trio.move_on_after(2.0):
                        await until(lambda: not unanswered, "all are answered")
            assert len(audited) == 20

    run(test)
