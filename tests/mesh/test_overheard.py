"""Programs of one user at a robot's socket: what they say to it and are told is heard by no other of them,
and a name that another has makes nobody that other."""

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
    """Joins the sockets of all robots, and listens to everything there is."""

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


def test_saf_009_nobody_overhears_a_command_or_a_lease() -> None:
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
            told = await client.request(robot, mesh_json.Ping())
            assert not isinstance(told, Refused)
            await raw(client, robot, b'{"sender_id": "put", "turn_id": "t", "command": {"action": "ping"}}')
            before = len(other.topics("state"))
            await until(lambda: len(other.topics("state")) > before + 1, "what was said before has arrived")
            assert not other.topics("cmd")
            answered = {each.key for each in other.heard if "/response/" in each.key or "/node/" in each.key}
            assert answered == {f"strands/put/response/{robot}/t"}, "what is put is answered by a put"
            assert not other.knows(clock.name) and not other.knows(f'"lease":{number}')
            nursery.cancel_scope.cancel()

    run(test)


def test_saf_009_nor_what_a_program_is_told_that_reaches_it_by_name(tmp_path: Path, run_dir: Path) -> None:
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
            assert not other.topics("threads"), "what is told to a thread of it"
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


def test_saf_009_a_name_without_its_proof_is_another() -> None:
    """Whoever takes the sender's name of who holds the lease has neither its clock nor its lease."""

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
                assert not isinstance(await arm.send_action({"a": 0.06}), Refused), "it has lost nothing"

    run(test)


def test_a_question_that_cannot_be_read_is_answered_to_who_asked() -> None:
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
                told = msgspec.json.decode(answers[0].payload)
                assert (told["turn_id"], told["refused"]["code"]) == (turn, code)

    run(test)


def test_a_flood_of_questions_is_answered_though_not_all_of_it_is_audited() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await until(lambda: client.is_there(robot), "it is there")
            audited: list[str] = []
            commands: Any = tree.node.cells[addresses.of(robot).commands].actor
            commands._shared.audit = lambda *told: audited.append(told[0])
            commands._refusals = Limit(0.0, 20)  # whatever the time that it takes
            unanswered = {str(turn) for turn in range(60)}

            def hear(answer: Received) -> None:
                unanswered.discard(msgspec.json.decode(answer.payload)["turn_id"])

            def ask() -> None:
                """A link that is full drops questions: what is urgent waits for nothing."""
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
