"""Commands over the mesh reach the gate with a type, a lease and in time, or are refused by name."""

from __future__ import annotations

import json
import time
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate import messages
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.commands import COMMANDS_PER_S
from strands_actors.surfaces.mesh import control
from strands_actors.surfaces.mesh.client import MeshClient, Reading
from strands_actors.testing import FakeDriver, FakeHardware

from .world import Samples, code, mesh, raw, robot_on_mesh, run, until


def test_a_leased_move_reaches_the_wire_and_is_answered() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client, control(client, robot) as arm:
            assert (arm.axes, arm.unit) == (("a", "b"), "units")
            answer = await arm.send_action({"a": 5.0})
            assert answer == {"commanded": {"a": 5.0}, "unit": "units"}
            await until(lambda: hardware.of("setpoint"), "a setpoint")
            assert hardware.of("setpoint")[0].values == (5.0, 0.0)
            observed = await arm.observe()
            assert not isinstance(observed, Refused) and set(observed["joints"]) == {"a", "b", "a.pos", "b.pos"}

    run(test)


def test_saf_014_the_drivers_refusals_come_back_typed() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client, control(client, robot) as arm:
            assert code(await arm.send_action({"nose": 1.0})) == "unknown_joint"
            assert code(await arm.send_action({"a": 1e9})) == "range"
            assert hardware.of("setpoint") == []

    run(test)


def test_a_guarded_command_needs_an_operator_on_the_mesh_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeDriver, "GUARDED", ("a",))

    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client, control(client, robot) as arm:
            refused = await arm.send_action({"a": 1.0, "b": 1.0})
            assert isinstance(refused, Refused) and refused.code == "not_approved"
            assert refused.remedy == "name it in STRANDS_ACTORS_ALLOW on the robot's host"
            assert hardware.of("setpoint") == []
            await arm.send_action({"b": 1.0})
            await until(lambda: hardware.of("setpoint"), "a setpoint")
            monkeypatch.setenv("STRANDS_ACTORS_ALLOW", "a")
            answer = await arm.send_action({"a": 1.0})
            assert not isinstance(answer, Refused)

    run(test)


BASE = (Axis(key="a", unit="m/s", low=-9.0, high=9.0, mode=AxisMode.VELOCITY),)


def test_a_zero_velocity_and_a_command_on_an_allowed_topic_need_no_operator(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(FakeDriver, "GUARDED", ("a",))
    monkeypatch.setattr(FakeDriver, "TOPICS", {"a": "/cmd_vel"})
    monkeypatch.setattr(FakeDriver, "table", BASE)

    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as client, control(client, robot) as arm:
            assert code(await arm.send_action({"a": 0.5})) == "not_approved"
            assert not isinstance(await arm.send_action({"a": 0.0}), Refused)
            monkeypatch.setenv("STRANDS_ROS2_COMMAND_ALLOW", "/cmd_vel")
            assert not isinstance(await arm.send_action({"a": 0.5}), Refused)

    run(test)


def test_saf_009_one_writer_at_a_time() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as one, mesh() as two, control(one, robot) as arm:
            with pytest.raises(PermissionError, match="holds the lease"):
                async with control(two, robot):
                    pass
            clock = await two.clock(robot)
            assert isinstance(clock, Reading)
            stolen = mesh_json.Move(
                clock=clock.name,
                deadline_ns=clock.deadline(time.monotonic_ns() + 10**8),
                targets={"a": 1.0},
                lease=arm._lease,
                epoch=arm._epoch,
            )
            assert code(await two.request(robot, stolen)) == "lease"

    run(test)


async def _move(client: MeshClient, robot: str, arm: Any, clock: str, deadline_ns: int) -> str:
    move = mesh_json.Move(
        clock=clock, deadline_ns=deadline_ns, targets={"a": 1.0}, lease=arm._lease, epoch=arm._epoch
    )
    answer = await client.request(robot, move)
    return answer.code if isinstance(answer, Refused) else ""


def test_saf_001_a_stale_or_undated_move_is_refused() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh() as client, control(client, robot) as arm:
            clock = await client.clock(robot)
            assert isinstance(clock, Reading)
            now_ns = clock.deadline(time.monotonic_ns())
            assert await _move(client, robot, arm, "guess", now_ns + 10**8) == "clock"
            assert await _move(client, robot, arm, clock.name, now_ns - 10**6) == "expired"
            assert await _move(client, robot, arm, clock.name, now_ns + 60 * 10**9) == "too_distant"
            assert hardware.of("setpoint") == []
            assert await _move(client, robot, arm, clock.name, now_ns + 2 * 10**8) == ""

    run(test)


@pytest.mark.parametrize("skew_s", [-3600.0, 7.0, 1e6])
def test_a_sender_on_another_clock_is_understood(skew_s: float) -> None:
    """The hosts have different clocks. The deadline counts in the robot's clock, and is never later than the
    sender intended."""

    async def test() -> None:
        def theirs_ns() -> int:
            return time.monotonic_ns() + round(skew_s * 1e9)

        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _), mesh(now_ns=theirs_ns) as client:
            reading = await client.clock(robot)
            assert isinstance(reading, Reading)
            true_ns = -round(skew_s * 1e9)
            assert reading.lowest_ns <= true_ns <= reading.highest_ns
            async with control(client, robot) as arm:
                assert not isinstance(await arm.send_action({"a": 2.0}, ttl_s=0.5), Refused)
                await until(lambda: hardware.of("setpoint"), "a setpoint")

    run(test)


def test_saf_001_a_streams_setpoint_expires_and_the_mesh_must_resume() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, _), mesh() as client, control(client, robot) as arm:
            assert not isinstance(await arm.send_action({"a": 2.0}, ttl_s=0.2), Refused)
            await tree.until("holding")  # the gate has ordered the hold; its frame follows
            held_ns = (await until(lambda: hardware.of("safe"), "the hold"))[-1].t_ns
            assert code(await arm.send_action({"a": 3.0}, ttl_s=0.2)) == "stale_epoch"
            refused = await arm.acquire()
            assert refused is not None and code(refused) == "holding"
            assert hardware.of("setpoint", held_ns) == []
            assert await arm.resume() is None
            assert not isinstance(await arm.send_action({"a": 3.0}, ttl_s=0.2), Refused)

    run(test)


def test_a_sender_that_stops_beating_loses_a_latched_target() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            async with control(client, robot) as arm:
                await arm.send_action({"a": 2.0})
                await trio.sleep(1.3)  # longer than a lease lives without heartbeats
                assert (await tree.status()).mode == "armed"
            await tree.until("holding")  # the lease has ended: the robot holds before a new motion
            assert (await tree.status()).holder == ""

    run(test)


def test_a_released_lease_leaves_the_robot_to_others() -> None:
    """The robot's own program calls ``release()``. Then two programs on the mesh take the lease in turn."""

    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            own = await tree.gate.ask(messages.Acquire("its own program"), 1.0)
            assert isinstance(own, messages.Lease)
            later_ns = time.monotonic_ns() + 10**9
            await tree.gate.ask(messages.Setpoint(own.id, own.epoch, later_ns, {"a": 1.0}, latched=True), 1.0)
            await tree.gate.ask(messages.Release(own.id), 1.0)
            for _ in range(2):
                assert (await tree.until("holding")).cause == "the writer gave its lease back"
                async with control(client, robot) as arm:
                    assert await arm.acquire() is None
                    assert not isinstance(await arm.send_action({"a": 2.0}), Refused)

    run(test)


@pytest.mark.parametrize(
    ("payload", "refused"),
    [
        (b'{"sender_id": "SENDER", "turn_id": "x", "command": {"action": "fly"}}', "unknown_action"),
        (b'{"sender_id": "SENDER", "turn_id": "x", "command": {"action": "move"}}', "malformed"),
        (b'{"sender_id": "SENDER", "turn_id": "x"}', "malformed"),
        (
            b'{"sender_id": "SENDER", "turn_id": "x", "command": {"action": "status"}, "p": "'
            + b"x" * 20000
            + b'"}',
            "oversized",
        ),
    ],
)
def test_saf_014_an_invalid_command_is_answered_and_counted(payload: bytes, refused: str) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as client:
            answers = Samples(client, f"strands/{client.sender}/response/{robot}/x")
            health = Samples(client, f"strands/{robot}/health")
            await raw(client, robot, payload.replace(b"SENDER", client.sender.encode()))
            (answer,) = await answers.wait()
            assert (answer["type"], answer["responder_id"], answer["turn_id"]) == ("error", robot, "x")
            assert answer["refused"]["code"] == refused

            def counts() -> object:
                return msgspec.json.decode(health.received[-1].payload)["counts"] if health.received else None

            await until(lambda: counts() == {"commands": 1, "commands_refused": 1}, "it is counted")

    run(test)


def test_saf_014_garbage_is_counted_and_has_no_other_effect() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            health = Samples(client, f"strands/{robot}/health")
            for payload in (b"", b"\xff\x00", b"[[[[", b"null", json.dumps("x" * 100_000).encode(), b"[" * 50_000):
                await raw(client, robot, payload)
            await until(lambda: len(health.received), "health")
            await until(lambda: b'"commands_refused":6' in health.received[-1].payload, "six refusals")
            assert (await tree.status()).mode == "armed"

    run(test)


def test_more_than_a_few_commands_a_second_are_refused() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as client:
            codes = []

            async def ask() -> None:
                answer = await client.request(robot, mesh_json.Status())
                if isinstance(answer, Refused):
                    codes.append(answer.code)

            # At the same time, because a slow machine would ask one after the other at a permitted rate.
            async with trio.open_nursery() as nursery:
                for _ in range(2 * COMMANDS_PER_S):
                    nursery.start_soon(ask)
            assert codes and set(codes) <= {"rate"}

    run(test)


@pytest.mark.parametrize("how", ["asks", "puts"])
def test_saf_025_one_operators_flood_has_no_command_of_another_refused(how: str) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _), mesh() as flooder, mesh() as operator:
            for turn in range(2 * COMMANDS_PER_S):
                if how == "asks":
                    await flooder.request(robot, mesh_json.Status())
                else:
                    message = {"sender_id": operator.sender, "turn_id": f"t{turn}", "command": {"action": "status"}}
                    await raw(flooder, robot, json.dumps(message).encode())
            for _ in range(COMMANDS_PER_S // 2):
                assert not isinstance(answer := await operator.request(robot, mesh_json.Status()), Refused), answer

    run(test)


def test_nothing_on_a_command_key_waits_for_a_robot_that_comes_later() -> None:
    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, tree, service), mesh() as client:
            service.close()
            answer = await client.request(robot, mesh_json.Stop())
            assert isinstance(answer, Refused)
            await trio.sleep(0.3)
            assert (await tree.status()).mode == "armed"

    run(test)
