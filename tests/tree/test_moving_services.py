"""A service that moves the robot has the rules of a latched setpoint: it is refused and ended like one.
In virtual time.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Condition, Reason, Service
from strands_actors.contract.wire import Observation, Permit
from strands_actors.kernel.messages import Message, Refused
from strands_actors.supervisors.gate.messages import LEASE_TTL_S, Accepted, Beat, Perform, Performed, Stop
from strands_actors.testing import open_inline_tree, run_virtual
from strands_actors.testing.fake import FakeDriver, FakeWire

from .writer import Writer, armed, setpoints

BEGUN: list[int] = []
"""The times at which a nod began."""


@pytest.fixture(autouse=True)
def nods(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the fake robot a service: to nod for two seconds, which ends at another position."""
    BEGUN.clear()

    async def perform(
        self: FakeWire, service: str, arguments: Mapping[str, Any], permit: Permit
    ) -> dict[str, Any] | Refused:
        permit.check()
        BEGUN.append(self._clock.now_ns())
        await trio.sleep(2.0)
        self._hardware.position = [7.0, 8.0]
        await trio.sleep(0.1)
        return {}

    nod = Service("nod", within_s=5.0, in_motion=True, moves=True)
    lie = Service("lie down", within_s=5.0, ends_motion=True)
    monkeypatch.setattr(FakeDriver, "SERVICES", {"nod": nod, "lie": lie})
    monkeypatch.setattr(FakeWire, "perform", perform)


async def ask(writer: Writer, service: str = "nod") -> Message | None:
    return await writer.ref.ask(Perform(writer.lease.id, writer.lease.epoch, service, {}), 9.0)


async def beat(writer: Writer) -> None:
    while True:
        writer.ref.tell(Beat(writer.lease.id, 0.0))
        await trio.sleep(LEASE_TTL_S / 4)


def test_saf_002_after_a_stop_a_moving_service_is_refused_until_a_resume() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            await writer.acquire()
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.code == "disarmed"
            assert answer.reason.startswith("the robot is disarmed")
            assert BEGUN == []

    run_virtual(run)


def test_saf_014_a_condition_refuses_a_moving_service_and_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    fits = True

    def fit(observation: Observation, now_ns: int) -> Refused | None:
        return None if fits else Refused("unfit", "the robot is unfit")

    monkeypatch.setattr(FakeDriver, "conditions", (Condition(fit),))

    async def run() -> None:
        nonlocal fits
        async with open_inline_tree() as tree, trio.open_nursery() as nursery:
            writer = await armed(tree)
            nursery.start_soon(beat, writer)
            fits = False
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.text.startswith("nod: the robot is unfit")
            fits = True
            nursery.start_soon(ask, writer)
            await trio.sleep(0.5)
            fits = False
            await trio.sleep(0.1)
            assert BEGUN and (await tree.status()).mode == "disarmed"
            assert tree.hardware.of("safe", BEGUN[0])
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_saf_003_a_moving_service_ends_with_the_lease_of_its_caller() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            answer = await ask(writer)  # no heartbeats arrive meanwhile
            assert isinstance(answer, Refused) and answer.code == "stopped"
            holds = tree.hardware.of("safe", BEGUN[0])
            assert holds and holds[0].safe_state == "hold"
            assert (holds[0].t_ns - BEGUN[0]) / 1e9 <= LEASE_TTL_S + 0.05

    run_virtual(run)


def test_saf_011_the_next_command_continues_from_the_end_of_the_motion() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, trio.open_nursery() as nursery:
            writer = await armed(tree)
            nursery.start_soon(beat, writer)
            assert isinstance(await writer.send(latched=True, a=1.0), Accepted)
            await trio.sleep(0.01)
            assert await ask(writer) == Performed({})
            assert not [one for one in setpoints(tree, BEGUN[0]) if one[0] == 1.0], (
                "the earlier target is not sent again"
            )
            assert isinstance(await writer.send(latched=True, a=2.0), Accepted)
            await trio.sleep(0.1)
            assert setpoints(tree)[-1] == (2.0, 8.0)
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_saf_001_a_service_that_ends_a_motion_may_interrupt_it_and_no_setpoint_follows() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, trio.open_nursery() as nursery:
            writer = await armed(tree)
            nursery.start_soon(beat, writer)
            assert isinstance(await writer.send(ttl_s=0.3, a=1.0), Accepted)
            await trio.sleep(0.05)
            assert await ask(writer, "lie") == Performed({})
            assert not setpoints(tree, BEGUN[0]), "the earlier target is not sent again"
            assert not tree.hardware.of("safe", BEGUN[0]), (
                "the setpoint does not expire, because the service has ended it"
            )
            assert isinstance(await writer.send(latched=True, a=2.0), Accepted)
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_saf_009_a_service_that_ends_a_motion_is_refused_during_another_service() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, trio.open_nursery() as nursery:
            writer = await armed(tree)
            nursery.start_soon(beat, writer)
            nursery.start_soon(ask, writer)
            await trio.sleep(0.2)
            answer = await ask(writer, "lie")
            assert isinstance(answer, Refused) and answer.code == "busy"
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_saf_009_a_moving_service_excludes_other_services_and_setpoints() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree, trio.open_nursery() as nursery:
            writer = await armed(tree)
            nursery.start_soon(beat, writer)
            nursery.start_soon(ask, writer)
            await trio.sleep(0.2)
            answer = await ask(writer)
            assert isinstance(answer, Refused) and answer.code == "busy"
            answer = await writer.send(a=1.0)
            assert isinstance(answer, Refused) and answer.code == "busy"
            nursery.cancel_scope.cancel()

    run_virtual(run)
