"""The gateway passes a message from another host to the gate only with a valid deadline, in time, and from
its authenticated sender."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import AsyncIterator
from typing import Any, NamedTuple

import msgspec
import pytest
import trio
import zenoh

from strands_actors.caller.processes.nodes import open_node
from strands_actors.caller.processes.run_directory import notes
from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.contract.driver import Reason, Service
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh, request_key
from strands_actors.kernel.frames import TELL, frame
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Node, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import (
    Accepted,
    Acquire,
    Beat,
    GetStatus,
    Lease,
    Perform,
    Release,
    Resume,
    Resumed,
    SafeDone,
    Setpoint,
    Status,
    Stop,
    StopReport,
)
from strands_actors.supervisors.mesh.gateway import COMMANDS_PER_S, Gateway, GatewayStop
from strands_actors.supervisors.mesh.gateway_messages import Datable, Dated, Sync, Synced
from strands_actors.testing import FakeDriver, FakeHardware, InlineTree

from .world import robot_on_mesh, run, until

MS = 1_000_000
ASK_S = 10.0


@dataclasses.dataclass
class Caller:
    """A caller that the robot sees as on another host. Its clock is the same."""

    robot: str
    node: Node
    session: str
    lease: int = 0

    async def ask(self, message: Message, actor: type[Actor] = Gateway, address: str = "") -> Message | None:
        ref = self.node.ref(address or addresses.of(self.robot).gateway, actor)
        with trio.fail_after(ASK_S):
            while True:
                try:
                    return await ref.ask(message, ASK_S)
                except Unreachable:
                    await trio.sleep(0.005)

    async def dated(self, message: Datable, ahead_ms: float = 5000.0, session: str | None = None) -> Message | None:
        deadline_ns = time.monotonic_ns() + round(ahead_ms * MS)
        return await self.ask(Dated(self.session if session is None else session, deadline_ns, message))

    async def acquire(self) -> Lease:
        """Take the lease, or renew the one that the caller has."""
        lease = await self.dated(Acquire("me", again=self.lease))
        assert isinstance(lease, Lease), lease
        self.lease = lease.id
        return lease

    async def stop(self) -> Message | None:
        return await self.ask(Stop(Reason.STOP, "me"), GatewayStop, addresses.of(self.robot).gateway_stop)


class World(NamedTuple):
    hardware: FakeHardware
    tree: InlineTree
    one: Caller
    two: Caller


@contextlib.asynccontextmanager
async def world() -> AsyncIterator[World]:
    hardware = FakeHardware()
    async with robot_on_mesh(hardware) as (robot, tree, _), contextlib.AsyncExitStack() as stack:
        (note,) = notes()
        callers: list[Caller] = []
        for name in ("one", "two"):
            gateway = addresses.of(robot).gateway
            opened = open_node(f"caller.{name}", connect=note.mesh, private=[gateway])
            node, _ = await stack.enter_async_context(opened)
            synced = await Caller(robot, node, "").ask(Sync())
            assert isinstance(synced, Synced)
            assert synced.axes == tuple(tree.driver.axes)
            callers.append(Caller(robot, node, synced.session))
        yield World(hardware, tree, *callers)


def target(lease: Lease, ahead_ms: float = 200.0, **action: float) -> Setpoint:
    return Setpoint(lease.id, lease.epoch, time.monotonic_ns() + round(ahead_ms * MS), action)


def code(answer: Message | None) -> str:
    assert isinstance(answer, Refused), answer
    return answer.code


def test_a_caller_of_another_host_writes_stops_and_resumes() -> None:
    async def test() -> None:
        async with world() as (hardware, tree, one, _):
            lease = await one.acquire()
            assert isinstance(await one.dated(target(lease, a=1.0)), Accepted)
            await until(lambda: hardware.of("setpoint"), "it is written")
            assert isinstance(await one.ask(GetStatus()), Status)
            report = await one.stop()
            assert isinstance(report, StopReport) and report.confirmed
            assert code(await one.dated(target(lease, a=2.0))) == "disarmed"
            assert code(await one.dated(Acquire("me"))) == "disarmed"
            assert isinstance(await one.dated(Resume("me")), Resumed)
            assert isinstance(await one.dated(target(await one.acquire(), a=2.0)), Accepted)
            assert (await tree.status()).holder == "me (caller.one)"

    run(test)


def test_a_guarded_command_from_another_host_needs_an_operator_and_a_zero_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(FakeDriver, "GUARDED", ("a",))
    monkeypatch.setattr(FakeDriver, "TOPICS", {"a": "/cmd_vel"})
    axis = Axis(key="a", unit="m/s", low=-9.0, high=9.0, mode=AxisMode.VELOCITY)
    monkeypatch.setattr(FakeDriver, "table", (axis,))

    async def test() -> None:
        async with world() as (hardware, _, one, _):
            lease = await one.acquire()
            refused = await one.dated(target(lease, a=1.0, b=1.0))
            assert code(refused) == "not_approved" and "approve=" not in refused.text
            assert hardware.of("setpoint") == []
            assert isinstance(await one.dated(target(lease, a=0.0, b=1.0)), Accepted)
            monkeypatch.setenv("STRANDS_ROS2_COMMAND_ALLOW", "/cmd_vel")
            assert isinstance(await one.dated(target(lease, a=1.0)), Accepted)

    run(test)


def test_a_guarded_service_needs_an_operator_from_another_host_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeDriver, "GUARDED", ("wave",))
    monkeypatch.setattr(FakeDriver, "SERVICES", {"wave": Service("It waves.", 1.0)})

    async def test() -> None:
        async with world() as (_, _, one, _):
            lease = await one.acquire()
            wave = Perform(lease.id, lease.epoch, "wave", {})
            refused = await one.dated(wave)
            assert code(refused) == "not_approved" and "wave" in refused.text
            monkeypatch.setenv("STRANDS_ACTORS_ALLOW", "wave")
            assert getattr(await one.dated(wave), "code", "") != "not_approved"

    run(test)


def test_saf_009_a_cancelled_request_gets_no_lease() -> None:
    async def test() -> None:
        async with world() as (_, tree, one, two):
            at = addresses.of(one.robot)
            gateway: Any = tree.node.cells[at.gateway].actor
            taken = gateway._shared.received
            deadline_ns = time.monotonic_ns() + 5_000 * MS
            one.node.ref(at.gateway, Gateway).tell(Dated(one.session, deadline_ns, Acquire("me")))
            await until(lambda: gateway._shared.received > taken, "it has come")
            await two.acquire()

    run(test)


def test_saf_001_nothing_is_accepted_that_is_not_dated_by_a_reading_of_the_clock_or_is_late() -> None:
    async def test() -> None:
        async with world() as (hardware, _, one, _):
            lease = await one.acquire()
            late = target(lease, 5000.0, a=1.0)
            for command in (late, Acquire("me"), Resume("me"), Perform(lease.id, lease.epoch, "x", {})):
                assert code(await one.dated(command, session="")) == "clock"
                assert code(await one.dated(command, session="f" * 32)) == "clock"
                assert code(await one.dated(command, ahead_ms=-1.0)) == "expired"
                assert code(await one.dated(command, ahead_ms=60_000.0)) == "too_distant"
            assert code(await one.dated(target(lease, -1.0, a=1.0))) == "expired", "the gate checks it, too"
            await one.dated(Release(lease.id), ahead_ms=-1.0)
            assert isinstance(await one.dated(target(lease, 5000.0, a=2.0)), Accepted), "the lease is still valid"
            await until(lambda: hardware.of("setpoint"), "it is written")
            # The accepted setpoint is written repeatedly while it is valid. No other setpoint is written.
            assert {written.values[0] for written in hardware.of("setpoint")} == {2.0}

    run(test)


def test_saf_017_a_lease_is_good_for_the_caller_that_was_given_it_alone() -> None:
    async def test() -> None:
        async with world() as (hardware, tree, one, two):
            lease = await one.acquire()
            over = Acquire("a rollout", lease.id)
            for command in (target(lease, a=1.0), Release(lease.id), over, Perform(lease.id, lease.epoch, "x", {})):
                assert code(await two.dated(command)) == "lease"
            for theirs in (Acquire("other"), Acquire("me"), Acquire("me", again=lease.id)):
                assert "me (caller.one)" in str(await two.dated(theirs)), "only its own session may use a lease"
            assert isinstance(await one.dated(over), Lease)
            assert not hardware.of("setpoint")
            assert (await tree.status()).mode == "armed"

    run(test)


def test_saf_017_a_session_counts_for_the_name_that_opened_it() -> None:
    """A caller that learns another's session still sends under its own name."""

    async def test() -> None:
        async with world() as (hardware, _, one, two):
            lease = await one.acquire()
            assert code(await two.dated(target(lease, a=1.0), session=one.session)) == "clock"
            again = await two.ask(Sync(one.session))
            assert isinstance(again, Synced) and again.session != one.session
            assert isinstance(await one.dated(target(lease, a=0.5)), Accepted), "the owner still has its lease"
            await until(lambda: hardware.of("setpoint"), "it is written")
            assert {each.values[0] for each in hardware.of("setpoint")} == {0.5}

    run(test)


def test_saf_017_a_put_to_the_gateway_is_ignored() -> None:
    async def test() -> None:
        async with world() as (hardware, tree, one, _):
            mesh, lease = one.node.mesh, await one.acquire()
            assert isinstance(mesh, ZenohMesh)
            gateway = addresses.of(one.robot).gateway
            dated = Dated(one.session, time.monotonic_ns() + 5000 * MS, target(lease, a=1.0))
            for key in (gateway, request_key(gateway, "caller.one")):
                mesh._session.put(key, frame(gateway, TELL, 0, "", one.node.address, dated))
            assert isinstance(await one.ask(GetStatus()), Status)
            await trio.sleep(0.1)
            assert not hardware.of("setpoint") and (await tree.status()).mode == "armed"

    run(test)


def test_a_beat_of_another_or_a_late_one_keeps_no_lease_alive() -> None:
    async def test() -> None:
        async with world() as (_, tree, one, two):
            lease = await one.acquire()
            latched = msgspec.structs.replace(target(lease, a=1.0), latched=True)
            assert isinstance(await one.dated(latched), Accepted)
            began_s = time.monotonic()
            while (await tree.status()).mode == "armed":
                assert time.monotonic() - began_s < 5.0, "the lease is still valid"
                await two.dated(Beat(lease.id))
                await one.dated(Beat(lease.id), ahead_ms=-1.0)
                await trio.sleep(0.02)
            assert (await tree.status()).mode == "holding"

    run(test)


def test_a_caller_that_returns_to_a_holding_robot_must_resume_it() -> None:
    async def test() -> None:
        async with world() as (_, tree, one, _):
            lease = await one.acquire()
            assert isinstance(await one.dated(target(lease, 50.0, a=1.0)), Accepted)
            await tree.until("holding")
            assert code(await one.dated(target(lease, a=2.0))) == "stale_epoch"
            assert code(await one.dated(Acquire("me"))) == "holding"
            assert isinstance(await one.dated(Resume("me")), Resumed)
            await one.acquire()

    run(test)


def test_the_hold_at_the_end_of_a_rollout_does_not_count_as_a_loss() -> None:
    async def test() -> None:
        async with world() as (_, tree, one, _):
            lease = await one.acquire()
            under = await one.dated(Acquire("rollout", lease.id))
            assert isinstance(under, Lease)
            assert isinstance(await one.dated(target(under, 5000.0, a=1.0)), Accepted)
            await one.dated(Release(under.id))
            await tree.until("holding")
            await one.acquire()

    run(test)


def test_saf_002_a_release_after_a_loss_does_not_count_as_a_resume() -> None:
    """The cases are an expired lease, a lease on a robot that holds, and a rollout that was late."""

    async def test() -> None:
        async with world() as (_, tree, one, _):
            for rollout in (False, True):
                lease = await one.acquire()
                under = await one.dated(Acquire("rollout", lease.id)) if rollout else lease
                assert isinstance(under, Lease)
                assert isinstance(await one.dated(target(under, 50.0, a=1.0)), Accepted)
                assert (await tree.until("holding")).cause == "the setpoint expired"
                for given_back in (Release(under.id), Release(lease.id), Release(lease.id)):
                    await one.dated(given_back)
                    assert code(await one.dated(Acquire("me"))) == "holding"
                assert isinstance(await one.dated(Resume("me")), Resumed)

    run(test)


@pytest.mark.parametrize("role", ["guardian", "transport", "gate", "tasks", "root", "safety"])
def test_saf_017_another_host_reaches_only_the_gateway(role: str) -> None:
    """Messages go to the actor's own key, and to the gateway's key with another address inside."""

    async def test() -> None:
        async with world() as (hardware, tree, one, _):
            forged = SafeDone(StopReport(Reason.STOP, "limp", 99, True, ()))
            at = addresses.of(one.robot)
            mesh = one.node.mesh
            assert isinstance(mesh, ZenohMesh)
            lease = await one.acquire()
            for message in (forged, Stop(Reason.STOP, "forged"), target(lease, a=1.0), Resume("forged")):
                data = frame(at.address(role), TELL, 0, at.gate, one.node.address, message)
                for key in (at.address(role), at.gateway, at.gateway_stop):
                    mesh._session.put(key, data)
            for address in (at.gateway, at.gateway_stop):
                for message in (forged, target(lease, a=1.0), Resume("forged")):
                    mesh._session.put(address, frame(address, TELL, 0, "", one.node.address, message))
            assert isinstance(await one.ask(GetStatus()), Status)
            await trio.sleep(0.1)
            assert (await tree.status()).mode == "armed"
            assert not hardware.of("setpoint")

    run(test)


@pytest.mark.parametrize("reason", list(Reason))
def test_a_stop_from_another_host_ends_no_tree_and_is_more_than_a_hold(reason: Reason) -> None:
    async def test() -> None:
        async with world() as (_, tree, one, _):
            address = addresses.of(one.robot).gateway_stop
            report = await one.ask(Stop(reason, "me"), GatewayStop, address)
            assert isinstance(report, StopReport) and report.confirmed
            assert (await tree.status()).mode == "disarmed"
            assert isinstance(await one.dated(Resume("me")), Resumed)

    run(test)


def test_saf_006_a_stop_waits_for_no_flood_of_commands() -> None:
    """Commands wait in zenoh's buffers. Each round reads only a few of them."""

    async def test() -> None:
        async with world() as (_, tree, one, _):
            mesh, over = one.node.mesh, trio.Event()
            assert isinstance(mesh, ZenohMesh)
            gateway = addresses.of(one.robot).gateway
            key = request_key(gateway, "caller.one")
            junk = frame(gateway, TELL, 0, "x", one.node.address, Sync())
            nobody: Any = zenoh.handlers.Callback(lambda reply: None, indirect=False)

            async def flood() -> None:
                while not over.is_set():
                    for _ in range(100):
                        mesh._session.get(key, nobody, payload=junk, timeout=5.0)
                    await trio.sleep(0.002)

            async with trio.open_nursery() as nursery:
                nursery.start_soon(flood)
                await trio.sleep(0.2)
                report = await one.stop()
                assert isinstance(report, StopReport) and report.confirmed
                over.set()
            assert (await tree.status()).mode == "disarmed"

    run(test)


async def codes_of_a_burst(caller: Caller) -> set[str]:
    """Send more commands at once than one caller may send in a second. Return the answers, which do not depend
    on the speed of the machine."""
    codes: set[str] = set()

    async def ask() -> None:
        codes.add(getattr(await caller.dated(Acquire("me")), "code", ""))

    async with trio.open_nursery() as nursery:
        for _ in range(COMMANDS_PER_S + 10):  # as many as the ring holds
            nursery.start_soon(ask)
    return codes


def test_a_caller_with_too_many_requests_is_refused() -> None:
    async def test() -> None:
        async with world() as (_, _, one, _):
            codes = await codes_of_a_burst(one)
            assert "" in codes and "rate" in codes

    run(test)


def test_saf_025_one_callers_flood_has_no_resume_of_another_refused() -> None:
    async def test() -> None:
        async with world() as (_, _, one, two):
            report = await two.stop()
            assert isinstance(report, StopReport) and report.confirmed
            assert "rate" in await codes_of_a_burst(one)
            assert isinstance(await two.dated(Resume("other")), Resumed)

    run(test)
