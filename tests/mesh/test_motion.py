"""Motion over the mesh that lasts after its command: late commands, and poses that last longer than the robot
keeps one command."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Reason, Timing
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Beat, Lease, Resume, Setpoint, Stop
from strands_actors.supervisors.mesh.motion import Motion
from strands_actors.surfaces.mesh import control
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.mapping_commands import send
from strands_actors.testing import FakeHardware
from strands_actors.testing.fake import FakeDriver

from .world import code, mesh, robot_on_mesh, run, until

POSE = {"action": "set_joints", "target_joints": {"a": 5.0}, "duration": 0.5}


@pytest.fixture(autouse=True)
def approved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STRANDS_ACTORS_ALLOW", "set_joints")


def test_saf_001_a_command_that_waited_past_its_deadline_is_dropped() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client:
            motion: Motion = tree.node.cells[addresses.of(robot).commands].actor._motion  # type: ignore[attr-defined]
            answers: list[Any] = []

            def make(clock: str, deadline_ns: int) -> dict[str, Any]:
                return {**POSE, "clock": clock, "deadline_ns": deadline_ns}

            async def ask() -> None:
                answers.append(await client.dated(robot, make, 0.5, 5.0))

            async with trio.open_nursery() as nursery, motion._turn:  # as a slow command would hold it
                nursery.start_soon(ask)
                await trio.sleep(0.8)
            assert code(answers[0]) == "expired" and answers[0].verb == "set_joints"
            assert hardware.of("setpoint") == []
            assert not isinstance(await client.dated(robot, make, 0.5, 5.0), Refused)
            await until(lambda: hardware.of("setpoint"), "it is written")  # the first command was accepted

    run(test)


def test_saf_014_no_pose_is_kept_for_longer_than_the_robot_keeps_one_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Otherwise a base would continue to drive, and legs would stand in one fixed pose."""
    timing = Timing(control_hz=50.0, keepalive_s=0.02, oneshot_ttl_s=0.3)
    monkeypatch.setattr(FakeDriver, "timing", timing)

    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client:
            refused = await send(client, robot, POSE)
            assert code(refused) == "too_long" and "at most 0.3 s" in refused.text  # type: ignore[union-attr]
            assert hardware.of("setpoint") == []
            assert not isinstance(await send(client, robot, {**POSE, "duration": 0.3}), Refused)

    run(test)


def test_a_lease_from_acquire_is_used_for_writing() -> None:
    async def test() -> None:
        hardware = FakeHardware()

        async def other(client: MeshClient, robot: str) -> Any:
            return await send(client, robot, POSE)

        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client, mesh() as stranger:
            answer = await client.dated(
                robot, lambda clock, deadline: {"action": "acquire", "clock": clock, "deadline_ns": deadline}, 0.5
            )
            assert not isinstance(answer, Refused), answer
            assert code(await other(stranger, robot)) == "lease"
            assert hardware.of("setpoint") == []
            assert not isinstance(await send(client, robot, POSE), Refused)
            status = await client.request(robot, {"action": "status"})
            assert not isinstance(status, Refused) and status["lease"].startswith(client.sender)

    run(test)


async def _begin(client: MeshClient, robot: str, duration_s: float) -> None:
    assert not isinstance(await send(client, robot, {**POSE, "duration": duration_s}), Refused)


def test_saf_006_a_stop_ends_the_lease_of_a_pose_and_leaves_the_next_lease_alone() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await _begin(client, robot, 1.5)
            await tree.gate.ask(Stop(Reason.STOP, "the test"), 5.0)
            await tree.until("disarmed")
            await tree.gate.ask(Resume("the test"), 5.0)
            await trio.sleep(0.5)  # the lease of the pose ends before its time is over
            lease = await tree.gate.ask(Acquire("local"), 1.0)
            assert isinstance(lease, Lease), lease
            deadline_ns = time.monotonic_ns() + 5 * 10**9
            setpoint = Setpoint(lease.id, lease.epoch, deadline_ns, {"a": 1.0})
            assert isinstance(await tree.gate.ask(setpoint, 1.0), Accepted)
            for _ in range(10):
                await trio.sleep(0.2)  # until the time of the pose is over
                tree.gate.tell(Beat(lease.id))
            status = await tree.status()
            assert (status.mode, status.epoch, status.holder) == ("armed", lease.epoch, "local")

    run(test)


def test_a_sender_that_takes_over_the_lease_of_its_own_pose_is_not_held_at_the_end_of_the_pose() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await _begin(client, robot, 1.0)
            async with control(client, robot) as arm:
                for step in range(30):
                    answer = await arm.send_action({"a": float(step % 3)}, ttl_s=0.5)
                    assert not isinstance(answer, Refused), answer
                    await trio.sleep(0.05)
                assert (await tree.status()).mode == "armed"

    run(test)


def test_a_pose_that_was_replaced_does_not_end_the_next() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await _begin(client, robot, 0.6)
            await tree.gate.ask(Stop(Reason.STOP, "the test"), 5.0)
            await tree.until("disarmed")
            assert not isinstance(await client.resume(robot), Refused)
            await _begin(client, robot, 1.5)
            began = (await tree.status()).epoch
            await trio.sleep(1.0)
            assert ((await tree.status()).mode, (await tree.status()).epoch) == ("armed", began)
            await tree.until("holding")
            await _begin(client, robot, 0.3)  # it ended as planned: no resume

    run(test)


def test_a_command_during_the_hold_of_a_pose_waits_for_that_hold() -> None:
    """The robot needs some time to hold. The pose ended as planned, so no resume is needed."""

    async def test() -> None:
        hardware = FakeHardware(confirm_s=0.3)
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client:
            for _ in range(2):
                await _begin(client, robot, 0.3)
                await tree.until("holding")
            async with control(client, robot) as arm:
                answer = await arm.send_action({"a": 0.5}, ttl_s=0.5)
                assert not isinstance(answer, Refused), answer

    run(test)


def test_saf_001_a_pose_that_comes_as_the_one_before_ends_is_kept_for_its_own_time() -> None:
    """The gate accepts the second pose in time. Its answer arrives after the first pose has ended."""

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            motion: Any = tree.node.cells[addresses.of(robot).commands].actor._motion  # type: ignore[attr-defined]
            ask = motion._gate.ask

            async def ask_slowly(message: Message, within_s: float) -> Any:
                answer = await ask(message, within_s)
                await trio.sleep(0.7 if isinstance(message, Setpoint) else 0.0)
                return answer

            await _begin(client, robot, 1.0)
            motion._gate = SimpleNamespace(ask=ask_slowly, tell=motion._gate.tell)
            await trio.sleep(0.5)
            sent = time.monotonic()
            await _begin(client, robot, 1.2)
            await tree.until("holding")
            assert time.monotonic() >= sent + 1.2, "it ended together with the first pose"

    run(test)
