"""Stops, leases, links and invalid input (SAF-005 to SAF-014). In virtual time; the frames on the wire
decide.
"""

from __future__ import annotations

import math

import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import (
    Accepted,
    Acquire,
    GetObservation,
    Lease,
    Probe,
    Release,
    Resume,
    Resumed,
    Stop,
    StopReport,
)
from strands_actors.supervisors.root.messages import Fence
from strands_actors.testing import open_inline_tree, run_virtual

from .writer import Writer, armed, freeze, setpoints

MS = 1_000_000


def test_saf_005_a_stop_with_an_unconfirmed_motor_names_it_and_is_not_confirmed() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport)
            assert not report.confirmed and report.unconfirmed == ["b"]
            assert tree.hardware.energised == [False, True], "the other motor was tried and released"
            assert (await tree.status()).mode == "unconfirmed"
            tree.hardware.silent.clear()
            report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport) and report.confirmed

    run_virtual(run)


def test_saf_005_an_unconfirmed_motor_is_released_as_soon_as_it_answers_again() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.silent.add("b")
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            tried = len(tree.hardware.of("safe"))
            await trio.sleep(5.0)
            assert len(tree.hardware.of("safe")) == tried, "a silent motor gets no more frames"
            tree.hardware.silent.clear()
            await tree.until("disarmed", within_s=0.7)
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_006_stop_does_not_wait_for_a_flood_of_setpoints() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            for index in range(900):
                tree.node.ref(tree.gate.address, sender=f"strands/test/{index}").tell(writer.setpoint(a=1.0))
            requested_ns = tree.node.clock.now_ns()
            report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert tree.hardware.of("safe")[0].t_ns - requested_ns < 10 * MS
            assert setpoints(tree) == []

    run_virtual(run)


def test_saf_007_a_lockout_applies_to_every_writer_and_outlives_a_crash() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await tree.gate.ask(Stop(Reason.ESTOP, "the operator", lock=True), 1.0)
            for name in ("writer", "another"):
                writer.name = name
                await writer.acquire()
                answer = await writer.send(a=1.0)
                assert isinstance(answer, Refused) and answer.code == "locked_out"
                assert "the operator" in answer.reason
            tree.wire._scope.cancel()
            await trio.sleep(0.1)
            status = await tree.until("disarmed")
            assert status.locked_by == "the operator"
            locked_ns = tree.node.clock.now_ns()
            assert isinstance(await tree.gate.ask(Resume("the operator"), 1.0), Resumed)
            await trio.sleep(0.5)
            assert setpoints(tree, locked_ns) == [], "a resume restarts no motion"

    run_virtual(run)


def test_saf_008_a_restart_resumes_nothing() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            await trio.sleep(0.05)
            old = writer.setpoint(ttl_s=5.0, a=9.0)
            tree.wire._scope.cancel()
            await trio.sleep(0.05)
            assert "the wire group ended" in (await tree.until("disarmed")).cause
            restarted_ns = tree.node.clock.now_ns()
            assert isinstance(await writer.ref.ask(old, 1.0), Refused)
            await trio.sleep(1.0)
            assert setpoints(tree, restarted_ns) == []
            assert isinstance(await tree.gate.ask(Resume(), 1.0), Resumed)
            answer = await writer.ref.ask(old, 1.0)
            assert isinstance(answer, Refused), "a setpoint from before the restart stays invalid"
            assert setpoints(tree, restarted_ns) == []

    run_virtual(run)


def test_saf_009_second_writer_is_refused_with_the_holders_name() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            first = await armed(tree, "alice")
            await first.send(a=1.0)
            second = Writer(tree, "bob")
            answer = await second.acquire()
            assert isinstance(answer, Refused) and "alice" in answer.reason
            answer = await second.send(a=2.0)
            assert isinstance(answer, Refused) and answer.code == "lease" and "alice" in answer.reason
            await trio.sleep(0.02)
            assert all(values[0] == 1.0 for values in setpoints(tree))
            await trio.sleep(1.5)
            assert isinstance(await second.acquire(), Lease), "an expired lease may be acquired"

    run_virtual(run)


def test_saf_009_stop_during_bring_up_wins() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            answers: list[object] = []

            async def resume() -> None:
                answers.append(await tree.gate.ask(Resume(), 2.0))

            async with trio.open_nursery() as nursery:
                nursery.start_soon(resume)
                await trio.sleep(0.0015)  # one motor of two is energised
                report = await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert isinstance(report, StopReport) and report.confirmed
            assert isinstance(answers[0], Refused)
            assert tree.hardware.energised == [False, False]
            assert (await tree.status()).mode == "disarmed"

    run_virtual(run)


def test_saf_005_a_fence_before_the_link_is_back_names_every_motor() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            tree.hardware.plugged = False
            tree.wire._scope.cancel()
            await trio.sleep(3.0)  # the wire is fenced and not confirmed, and the next wire waits for the link
            assert len(tree.wires_made) > 1
            report = await tree.guardian.ask(Fence(Reason.STOP, "test"), 1.0)
            assert isinstance(report, StopReport) and not report.confirmed
            assert report.unconfirmed == ["a", "b"]

    run_virtual(run)


def test_saf_010_fence_makes_safe_when_the_gate_does_not_answer() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            freeze(tree, "gate")
            fenced_ns = tree.node.clock.now_ns()
            report = await tree.guardian.ask(Fence(Reason.STOP, "test"), 2.0)
            assert isinstance(report, StopReport) and report.confirmed and report.path == "stop_channel"
            assert tree.hardware.of("safe", fenced_ns)[0].t_ns - fenced_ns < 20 * MS
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_011_first_target_is_the_measured_position() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await tree.gate.ask(Stop(Reason.STOP), 1.0)
            tree.hardware.position = [42.0, -7.0]
            assert isinstance(await tree.gate.ask(Resume("test"), 1.0), Resumed)
            assert isinstance(await writer.acquire(), Lease)
            assert (await tree.status()).target == (42.0, -7.0)
            answer = await writer.send(a=43.0)
            assert isinstance(answer, Accepted) and answer.values == (43.0, -7.0)

    run_virtual(run)


def test_saf_012_a_lost_link_is_detected_and_the_robot_is_disarmed_afterwards() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            await trio.sleep(0.05)
            tree.hardware.plugged = False
            lost_ns = tree.node.clock.now_ns()
            await tree.until("lost", within_s=2 / tree.driver.timing.control_hz)
            status = await tree.status()
            assert not status.connected and "cable" in status.connect_error
            await trio.sleep(2.0)
            tree.hardware.plugged = True
            await tree.until("disarmed", within_s=5.0)
            safe = tree.hardware.of("safe", lost_ns)
            assert safe and safe[0].safe_state == "limp", "the robot was energised, so the safe frame comes first"
            assert setpoints(tree, lost_ns + 40 * MS) == []
            assert tree.hardware.energised == [False, False]
            answer = await writer.send(a=1.0)
            assert isinstance(answer, Refused) and answer.code == "disarmed"

    run_virtual(run)


def test_saf_014_invalid_input_is_refused_and_nothing_is_written() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            for action in ({"a": math.nan}, {"a": math.inf}, {"a": 1e6}, {"c": 1.0}, {"a": "1"}):
                assert isinstance(await writer.ref.ask(writer.setpoint(**action), 1.0), Refused)
            late = writer.setpoint(ttl_s=-0.01, a=1.0)
            answer = await writer.ref.ask(late, 1.0)
            assert isinstance(answer, Refused) and answer.code == "expired"
            answer = await writer.ref.ask(writer.setpoint(ttl_s=3600.0, a=1.0), 1.0)
            assert isinstance(answer, Refused) and answer.code == "too_distant"
            await trio.sleep(0.2)
            assert setpoints(tree) == []
            assert (await tree.status()).refusals == 7

    run_virtual(run)


def test_the_release_of_a_policys_lease_is_answered_after_a_hold() -> None:
    """A policy commands under its caller's lease. When it releases its own lease, the robot is held."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            caller = await armed(tree, "caller")
            policy = Writer(tree, "policy")
            lease = await policy.ref.ask(Acquire("policy", over=caller.lease.id), 1.0)
            assert isinstance(lease, Lease)
            policy.lease = lease
            assert isinstance(await policy.send(a=3.0), Accepted)
            answer = await caller.send(a=4.0)
            assert isinstance(answer, Refused) and "policy" in answer.reason
            await policy.ref.ask(Release(lease.id), 1.0)
            assert [entry.safe_state for entry in tree.hardware.of("safe")] == ["hold"]
            await caller.acquire()
            assert isinstance(await caller.send(a=4.0), Accepted)

    run_virtual(run)


def test_repeated_crashes_are_each_made_safe_and_disarmed() -> None:
    """Three crashes are within the restart budget, and the next wire starts disarmed each time."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            for _ in range(3):
                await armed(tree)
                crashed_ns = tree.node.clock.now_ns()
                tree.wire._scope.cancel()
                await trio.sleep(0.02)
                await tree.until("disarmed")
                assert tree.hardware.of("safe", crashed_ns)
                assert tree.hardware.energised == [False, False]
            assert len(tree.wires_made) == 4

    run_virtual(run)


def test_status_and_observation_are_answered_during_a_slow_stop() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            await armed(tree)
            transport = tree.node.cells[tree.gate.address.replace("gate", "transport")].actor
            wire = transport._wire  # type: ignore[attr-defined]
            make_safe = wire.make_safe

            async def slow(safe_state: str) -> object:
                reports = await make_safe(safe_state)
                await trio.sleep(0.5)
                return reports

            wire.make_safe = slow
            async with trio.open_nursery() as nursery:
                nursery.start_soon(tree.gate.ask, Stop(Reason.STOP), 2.0)
                await trio.sleep(0.01)
                requested_s = trio.current_time()
                assert (await tree.status()).mode == "stopping"
                assert not isinstance(await tree.gate.ask(GetObservation(), 1.0), Refused)
                assert trio.current_time() - requested_s < 0.01
            assert len(tree.wires_made) == 1, "a slow confirmation does not count as a freeze"

    run_virtual(run)


def test_a_forged_probe_of_the_gate_changes_no_deadline() -> None:
    """The probe of another sender can neither expire a live setpoint early nor extend it."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(ttl_s=0.1, a=1.0)
            tree.node.ref(tree.gate.address, sender="strands/test/stranger").tell(Probe(10**9, 0))
            await trio.sleep(0.05)
            assert (await tree.status()).mode == "armed"
            await trio.sleep(0.2)
            assert (await tree.status()).mode == "holding"

    run_virtual(run)
