"""E-stop, stop and resume over the mesh."""

from __future__ import annotations

import json
import time

import pytest
import trio

from strands_actors.caller.processes.run_directory import Name, Note
from strands_actors.kernel.channels.zenoh_session import unix_endpoint
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Acquire, Lease, Release, Setpoint
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.surfaces.mesh import control
from strands_actors.surfaces.mesh.client import Reading
from strands_actors.testing import FakeHardware, InlineTree

from .world import Samples, code, mesh, raw, robot_on_mesh, run, until


async def local_move(tree: InlineTree) -> str:
    """Return the answer to a writer in the robot's own program."""
    lease = await tree.gate.ask(Acquire("local"), 1.0)
    assert isinstance(lease, Lease)
    setpoint = Setpoint(lease.id, lease.epoch, time.monotonic_ns() + 10**9, {"a": 1.0}, 0.0, True)
    answer = await tree.gate.ask(setpoint, 1.0)
    await tree.gate.ask(Release(lease.id), 1.0)
    return answer.code if isinstance(answer, Refused) else ""


def test_saf_007_an_estop_locks_mesh_and_local_writers_until_a_resume() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client:
            events = Samples(client, mesh_json.EVENT_KEY)
            await trio.sleep(0.05)
            async with control(client, robot) as arm:
                await arm.send_action({"a": 1.0})
                (outcome,) = await client.estop("the red button", within_s=5.0)
                assert (outcome.robot, outcome.outcome, outcome.safe_state) == (robot, "safe", "limp")
                assert outcome.locked and all(motor["safe"] for motor in outcome.motors)
                assert hardware.of("safe")[-1].safe_state == "limp"
                stopped_ns = hardware.of("safe")[-1].t_ns
                assert isinstance(await arm.send_action({"a": 2.0}), Refused)
                refused = await arm.acquire()
                assert refused is not None and code(refused) == "locked_out"
                await arm.release()
                assert await local_move(tree) == "locked_out"
                assert hardware.of("setpoint", stopped_ns) == []
                assert await arm.resume("the operator") is None
                assert hardware.of("setpoint", stopped_ns) == []  # a resume restarts no motion
                assert not isinstance(await arm.send_action({"a": 2.0}), Refused)
            received = await events.wait(2)
            assert {event["event"]: event["by"] for event in received} == {
                "estop": "the red button",
                "resume": "the operator",
            }

    run(test)


@pytest.mark.parametrize("payload", [b"", b"stop!", b"{}", b"\xff" * 10_000, b'{"sender_id": "a/*", "turn_id": 1}'])
def test_saf_007_any_sample_on_the_key_is_an_estop(payload: bytes) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await raw(client, robot, payload, mesh_json.ESTOP_KEY)
            status = await tree.until("disarmed")
            assert status.locked_by

    run(test)


def test_saf_005_an_unconfirmed_motor_is_reported_by_name() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client:
            hardware.silent.add("b")
            (outcome,) = await client.estop(within_s=5.0)
            assert (outcome.robot, outcome.outcome) == (robot, "unconfirmed")
            assert "b" in outcome.detail

    run(test)


def test_saf_005_a_robot_that_does_not_answer_is_unreachable() -> None:
    async def test() -> None:
        ghost = Name("ghost")
        ghost.publish(Note("ghost", "fake", 0, [], [unix_endpoint(ghost.socket("mesh"))]))
        async with robot_on_mesh() as (robot, _, _), mesh() as client:
            began = time.monotonic()
            outcomes = {outcome.robot: outcome.outcome for outcome in await client.estop()}
            took_s = time.monotonic() - began
        ghost.release()
        assert outcomes["ghost"] == "unreachable"
        assert outcomes[robot] == "safe"
        assert 0.2 < took_s < 2.0  # the caller waits, and no longer than its timeout

    run(test)


def test_an_estop_for_one_robot_leaves_the_others() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (one, tree, _), robot_on_mesh() as (_, other, _), mesh() as client:
            (outcome,) = await client.estop(within_s=5.0, robot=one)
            assert outcome.robot == one
            await tree.until("disarmed")
            assert (await other.status()).mode == "armed"

    run(test)


def test_saf_007_a_resume_must_be_a_request_with_a_deadline() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await client.estop(within_s=5.0)
            clock = await client.clock(robot)
            assert isinstance(clock, Reading)
            answers = Samples(client, f"strands/{client.sender}/response/{robot}/x")
            order = {"sender_id": client.sender, "turn_id": "x"}
            ahead = {"clock": clock.name, "deadline_ns": clock.deadline(time.monotonic_ns() + 10**10)}
            command = {"action": "resume", **ahead}
            for key, body in (
                (mesh_json.RESUME_KEY, ahead),
                (mesh_json.RESUME_KEY, {**ahead, "target_id": robot}),
                (mesh_json.RESUME_KEY, {**ahead, "target_id": "another"}),
                ("cmd", {"command": command}),
            ):
                await raw(client, robot, json.dumps({**order, **body}).encode(), key)
            received = await answers.wait(3)
            assert [answer["refused"]["code"] for answer in received] == ["put", "put", "put"]
            assert all("(get)" in answer["refused"]["remedy"] for answer in received)
            late = mesh_json.Resume(clock=clock.name, deadline_ns=clock.deadline(time.monotonic_ns() - 10**6))
            assert code(await client.request(robot, late)) == "expired"
            status = await tree.status()
            assert (status.mode, bool(status.locked_by)) == ("disarmed", True)
            assert not isinstance(await client.resume(robot), Refused)
            assert (await tree.status()).mode == "armed"

    run(test)


def test_a_broadcast_can_stop_and_nothing_else() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            answers = Samples(client, f"strands/{client.sender}/response/{robot}/x")
            envelope = {"sender_id": client.sender, "turn_id": "x"}
            resume = {**envelope, "command": {"action": "resume", "clock": "c", "deadline_ns": 1}}
            await raw(client, robot, json.dumps(resume).encode(), mesh_json.BROADCAST_KEY)
            (refused,) = await answers.wait()
            assert refused["refused"]["code"] == "unknown_action"
            stop = {**envelope, "command": {"action": "stop"}}
            await raw(client, robot, json.dumps(stop).encode(), mesh_json.BROADCAST_KEY)
            status = await tree.until("disarmed")
            assert not status.locked_by
            assert (await answers.wait(2))[-1]["result"]["outcome"] == "safe"

    run(test)


def test_a_flood_of_estops_leaves_a_robot_that_can_be_resumed() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            for _ in range(3000):
                client.sessions.via[robot].put(mesh_json.ESTOP_KEY, b"", "x")
            await tree.until("disarmed")
            with trio.fail_after(5):  # no backlog
                while (await tree.status()).mode != "armed":
                    await client.resume(robot, within_s=1.0)

    run(test)


def test_a_robot_with_a_dead_gate_is_stopped_by_the_guardian() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client:
            gate = tree.node.cells[tree.gate.address].actor
            gate.receive = lambda message: gate.context.defer()  # type: ignore[method-assign]  # never answers
            tree.node.cells[tree.gate.address].mailbox.capacity = 0
            (outcome,) = await client.estop(within_s=5.0)
            assert (outcome.robot, outcome.outcome, outcome.path) == (robot, "safe", "stop_channel")
            status = await until(lambda: tree.keeper.state.locked_by, "it is locked")
            assert status

    run(test)


def test_the_sender_of_a_stop_waits_for_the_deadline_that_the_robot_announced() -> None:
    """The robot has acknowledged the stop. The sender then waits for the deadlines of the robot's driver, not
    for its own timeout."""

    async def test() -> None:
        async with robot_on_mesh(FakeHardware(confirm_s=1.0)) as (robot, _, _), mesh() as client:
            outcome = await client.stop(robot, "a test", within_s=0.5)
            assert (outcome.outcome, outcome.safe_state) == ("safe", "limp")

    run(test)
