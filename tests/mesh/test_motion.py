"""What goes on by itself: what comes late, or for longer than the robot keeps a command."""

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


def test_saf_001_what_had_to_wait_until_it_was_late_is_not_done() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client:
            motion: Motion = tree.node.cells[addresses.of(robot).commands].actor._motion  # type: ignore[attr-defined]
            answers: list[Any] = []

            def make(clock: str, deadline_ns: int) -> dict[str, Any]:
                return {**POSE, "clock": clock, "deadline_ns": deadline_ns}

            async def ask() -> None:
                answers.append(await client.dated(robot, make, 0.5, 5.0))

            async with trio.open_nursery() as nursery, motion._turn:  # as by a command that takes its time
                nursery.start_soon(ask)
                await trio.sleep(0.8)
            assert code(answers[0]) == "expired" and answers[0].verb == "set_joints"
            assert hardware.of("setpoint") == []
            assert not isinstance(await client.dated(robot, make, 0.5, 5.0), Refused)
            await until(lambda: hardware.of("setpoint"), "it is written")  # it was accepted first

    run(test)


def test_saf_014_no_pose_is_kept_for_longer_than_the_robot_keeps_one_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A base would drive on, legs would stand on one frame."""
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


def test_who_holds_the_lease_by_acquire_writes_under_it() -> None:
    async def test() -> None:
        hardware = FakeHardware()

        async def other(client: MeshClient, robot: str) -> Any:
            return await send(client, robot, POSE)

        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client, mesh() as stranger:
            told = await client.dated(
                robot, lambda clock, deadline: {"action": "acquire", "clock": clock, "deadline_ns": deadline}, 0.5
            )
            assert not isinstance(told, Refused), told
            assert code(await other(stranger, robot)) == "lease"
            assert hardware.of("setpoint") == []
            assert not isinstance(await send(client, robot, POSE), Refused)
            status = await client.request(robot, {"action": "status"})
            assert not isinstance(status, Refused) and status["lease"].startswith(client.sender)

    run(test)


async def _begin(client: MeshClient, robot: str, duration_s: float) -> None:
    assert not isinstance(await send(client, robot, {**POSE, "duration": duration_s}), Refused)


def test_saf_006_a_stop_ends_what_a_pose_has_taken_and_what_comes_next_is_left_alone() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await _begin(client, robot, 1.5)
            await tree.gate.ask(Stop(Reason.STOP, "the test"), 5.0)
            await tree.until("disarmed")
            await tree.gate.ask(Resume("the test"), 5.0)
            await trio.sleep(0.5)  # the lease of the pose is not kept to the end of its time
            lease = await tree.gate.ask(Acquire("local"), 1.0)
            assert isinstance(lease, Lease), lease
            deadline_ns = time.monotonic_ns() + 5 * 10**9
            setpoint = Setpoint(lease.id, lease.epoch, deadline_ns, {"a": 1.0})
            assert isinstance(await tree.gate.ask(setpoint, 1.0), Accepted)
            for _ in range(10):
                await trio.sleep(0.2)  # past that time
                tree.gate.tell(Beat(lease.id))
            status = await tree.status()
            assert (status.mode, status.epoch, status.holder) == ("armed", lease.epoch, "local")

    run(test)


def test_who_takes_the_lease_of_its_own_pose_is_not_held_at_the_end_of_that() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await _begin(client, robot, 1.0)
            async with control(client, robot) as arm:
                for step in range(30):
                    told = await arm.send_action({"a": float(step % 3)}, ttl_s=0.5)
                    assert not isinstance(told, Refused), told
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
            await _begin(client, robot, 0.3)  # its end was wanted: no resume

    run(test)


def test_what_comes_while_a_pose_is_being_held_waits_for_that() -> None:
    """The robot takes a while to hold. Its end was wanted, so nobody has to resume it."""

    async def test() -> None:
        hardware = FakeHardware(confirm_s=0.3)
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client:
            for _ in range(2):
                await _begin(client, robot, 0.3)
                await tree.until("holding")
            async with control(client, robot) as arm:
                told = await arm.send_action({"a": 0.5}, ttl_s=0.5)
                assert not isinstance(told, Refused), told

    run(test)


def test_saf_001_a_pose_that_comes_as_the_one_before_ends_is_kept_for_its_own_time() -> None:
    """The gate has accepted it in time, and its answer comes when the one before is over."""

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
            assert time.monotonic() >= sent + 1.2, "it was ended with the one before"

    run(test)
