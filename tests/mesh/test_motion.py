"""What goes on by itself: what comes late, or for longer than the robot keeps a command."""

from __future__ import annotations

from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Timing
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors import addresses
from strands_actors.supervisors.mesh.motion import Motion
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
            assert code(answers[0]) == "expired" and "set_joints: " in answers[0].reason
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
