"""A base, a drone and a robot behind slow HTTP on the common tree. In virtual time; the fake robot's log
decides.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import AsyncIterator

import pytest
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.messages import Accepted, Stop, StopReport
from strands_actors.supervisors.root import stopping
from strands_actors.testing import check_driver, open_inline_tree, run_virtual
from strands_actors.testing.checks import report
from strands_actors.testing.inline import InlineTree
from tests.fake_kinds import LANDING_S, PEERS, FakeBase, FakeDrone, FakeHttp, Peer, _Kind

from .writer import Writer, armed

KINDS = (FakeBase, FakeDrone, FakeHttp)
_ports = itertools.count()
MS = 1_000_000


@contextlib.asynccontextmanager
async def tree_of(kind: type[_Kind]) -> AsyncIterator[tuple[InlineTree, Peer, Writer]]:
    port = f"kind-{next(_ports)}"
    driver = kind(kind.SUPPORTED_ROBOTS[0], port, {})
    try:
        async with open_inline_tree(driver=driver) as tree:
            yield tree, driver.config.peer, await armed(tree)
    finally:
        PEERS.pop(port, None)


def moving(kind: type[Driver]) -> dict[str, float]:
    return {"joint1": 0.01} if kind is FakeHttp else {"vx": 0.25}


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_passes_the_conformance_suite(kind: type[_Kind]) -> None:
    results = check_driver(kind, good=moving(kind), twin=False)
    assert all(result.passed for result in results), "\n".join(report(results))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("late_ms", [0, 1, 13, 50, 99, 140, 299])
def test_saf_006_a_stop_is_sent_at_once_to_a_robot_that_answers_slowly(kind: type[_Kind], late_ms: int) -> None:
    async def run() -> None:
        async with tree_of(kind) as (tree, peer, writer):
            peer.answer_s = 0.3
            assert isinstance(await writer.send(ttl_s=0.3, **moving(kind)), Accepted)
            await trio.sleep(late_ms / 1e3)
            began_ns = tree.node.clock.now_ns()
            answer = await tree.gate.ask(Stop(Reason.STOP, "a test"), 5.0)
            assert isinstance(answer, StopReport) and answer.confirmed
            safe = peer.of("safe", began_ns)[0]
            assert safe.t_ns - began_ns <= 1 * MS and safe.safe_state == kind.fallbacks[Reason.STOP]
            await trio.sleep(2.0)
            assert peer.after("setpoint", safe) == []

    run_virtual(run)


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_that_answers_slowly_does_not_count_as_frozen(kind: type[_Kind]) -> None:
    async def run() -> None:
        async with tree_of(kind) as (tree, peer, writer):
            peer.answer_s = 0.3
            for _ in range(20):
                assert isinstance(await writer.send(ttl_s=0.3, **moving(kind)), Accepted)
                await trio.sleep(0.15)
            assert len(tree.wires_made) == 1 and peer.of("safe") == []

    run_virtual(run)


@pytest.mark.parametrize("kind", KINDS)
def test_saf_003_a_dead_wire_is_made_safe_by_the_stop_channel(kind: type[_Kind]) -> None:
    async def run() -> None:
        async with tree_of(kind) as (tree, peer, writer):
            assert isinstance(await writer.send(ttl_s=0.3, **moving(kind)), Accepted)
            began_ns = tree.node.clock.now_ns()
            await tree.wires_made[-1].fence()
            await trio.sleep(0.05)
            safe = peer.of("safe", began_ns)[0]
            assert safe.path == "stop_channel" and safe.safe_state == kind.fallbacks[Reason.WIRE]
            assert peer.after("setpoint", safe) == []

    run_virtual(run)


def test_saf_001_a_base_stops_when_its_command_has_expired_and_accepts_the_next() -> None:
    async def run() -> None:
        async with tree_of(FakeBase) as (tree, peer, writer):
            began_ns = tree.node.clock.now_ns()
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.25), Accepted)
            await trio.sleep(0.5)
            zero = peer.of("safe", began_ns)[0]
            assert zero.safe_state == SafeState.ZERO and zero.values == (0.0, 0.0)
            assert zero.t_ns - began_ns <= 330 * MS
            assert peer.after("setpoint", zero) == []
            assert isinstance(await writer.acquire(), object)
            # after a hold no resume is needed
            assert isinstance(await writer.send(ttl_s=0.3, wz=0.5), Accepted)
            await trio.sleep(0.01)
            # an axis that the command does not name is zero, so vx is not kept
            assert peer.of("setpoint")[-1].values == (0.0, 0.5)

    run_virtual(run)


@pytest.mark.parametrize("kind", [FakeBase, FakeDrone])
def test_saf_001_a_robot_with_velocity_axes_refuses_latched_commands(kind: type[_Kind]) -> None:
    async def run() -> None:
        async with tree_of(kind) as (_, peer, writer):
            answer = await writer.send(latched=True, vx=0.25)
            assert isinstance(answer, Refused) and answer.code == "latched"
            assert peer.of("setpoint") == []

    run_virtual(run)


def test_saf_011_a_base_that_is_armed_with_nonzero_readings_does_not_drive() -> None:
    async def run() -> None:
        async with tree_of(FakeBase) as (tree, peer, writer):
            peer.take(tree.node.clock.now_ns(), "setpoint", (0.4, 0.9))  # the measured values are not zero
            await trio.sleep(0.3)
            assert isinstance(await writer.send(ttl_s=0.3, wz=0.1), Accepted)
            await trio.sleep(0.01)
            assert peer.of("setpoint")[-1].values == (0.0, 0.1)

    run_virtual(run)


def test_a_drone_hovers_when_its_writer_is_late_and_lands_for_a_stop() -> None:
    async def run() -> None:
        async with tree_of(FakeDrone) as (tree, peer, writer):
            peer.height_m = 1.0
            began_ns = tree.node.clock.now_ns()
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.5), Accepted)
            await trio.sleep(0.6)
            assert [sent.safe_state for sent in peer.of("safe", began_ns)] == [SafeState.HOLD]
            assert peer.motors_on
            began_ns = tree.node.clock.now_ns()
            answer = await tree.gate.ask(Stop(Reason.STOP, "a test"), 5.0)
            assert isinstance(answer, StopReport) and answer.confirmed
            # the stop is confirmed after the landing
            assert tree.node.clock.now_ns() - began_ns >= LANDING_S * 1e9
            assert [sent.path for sent in peer.of("safe", began_ns)] == ["wire"], "the wire did not count as frozen"
            assert not peer.motors_on and peer.height_m == 0

    run_virtual(run)


def test_a_stop_from_the_mesh_lands_a_drone_and_does_not_fence_its_wire() -> None:
    async def run() -> None:
        async with tree_of(FakeDrone) as (tree, peer, writer):
            peer.height_m = 1.0
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.5), Accepted)
            began_ns = tree.node.clock.now_ns()
            deadlines = StopDeadlines.of(tree.driver.timing.safe_s)
            report = await stopping.make_safe(tree.gate, tree.guardian, Stop(Reason.STOP, "a test"), deadlines)
            assert isinstance(report, StopReport) and report.confirmed
            assert tree.node.clock.now_ns() - began_ns >= LANDING_S * 1e9
            assert [sent.path for sent in peer.of("safe", began_ns)] == ["wire"]
            assert len(tree.wires_made) == 1, "no wire was fenced"

    run_virtual(run)


def test_deadlines_of_a_stop_include_the_time_that_the_robot_may_take() -> None:
    usual, landing = StopDeadlines.of(1.5), StopDeadlines.of(2 * LANDING_S)
    assert usual == (0.0, 2.0, 2.0, 3.0, 0.25, 3.25)
    assert all(longer - shorter >= 2 * LANDING_S - 1.5 for shorter, longer in zip(usual, landing, strict=True))
    assert landing.end_s >= landing.own_stop_s + landing.attempt_s


def test_a_drone_with_a_low_battery_lands_even_while_it_hovers() -> None:
    async def run() -> None:
        async with tree_of(FakeDrone) as (tree, peer, writer):
            peer.height_m = 1.0
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.5), Accepted)
            await trio.sleep(0.6)  # the drone hovers
            peer.battery_pct = 10.0
            began_ns = tree.node.clock.now_ns()
            await trio.sleep(0.2)
            landing = peer.of("safe", began_ns)[0]
            assert landing.safe_state == SafeState.LAND
            await trio.sleep(LANDING_S + 0.1)
            assert (await tree.status()).cause == "battery at 10 %" and not peer.motors_on

    run_virtual(run)


def test_an_estop_switches_a_drones_motors_off() -> None:
    async def run() -> None:
        async with tree_of(FakeDrone) as (tree, peer, writer):
            assert isinstance(await writer.send(ttl_s=0.3, vx=0.5), Accepted)
            answer = await tree.gate.ask(Stop(Reason.ESTOP, "a test", lock=True), 5.0)
            assert isinstance(answer, StopReport) and answer.safe_state == SafeState.OFF
            assert not peer.motors_on

    run_virtual(run)


def test_saf_012_an_http_service_that_stops_answering_is_a_lost_link() -> None:
    async def run() -> None:
        async with tree_of(FakeHttp) as (tree, peer, writer):
            assert isinstance(await writer.send(latched=True, joint1=0.01), Accepted)
            peer.reachable = False
            await trio.sleep(2.0)
            assert (await tree.status()).mode in ("lost", "down")
            count = len(peer.of("setpoint"))
            peer.reachable = True
            await trio.sleep(3.0)
            assert peer.sent[-1].kind == "safe" and len(peer.of("setpoint")) == count

    run_virtual(run)
