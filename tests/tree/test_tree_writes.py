"""The frames that are written, and for how long they are resent (SAF-001 to SAF-004). In virtual time;
the frames on the wire decide.
"""

from __future__ import annotations

import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.gate.messages import Accepted, Acquire, Beat, Lease, Resume, Stop
from strands_actors.supervisors.wire.messages import Cycle, MakeSafe, Write
from strands_actors.testing import FakeHardware, open_inline_tree, run_virtual

from .writer import Writer, armed, freeze, setpoints

MS = 1_000_000


def test_saf_001_deadline_is_checked_at_the_wire() -> None:
    """The gate accepts the setpoint, but the bus is slow and the deadline passes before the write. The
    setpoint is not written.
    """

    async def run() -> None:
        async with open_inline_tree(FakeHardware(write_s=0.05)) as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(ttl_s=0.03, a=5.0), Accepted)
            await trio.sleep(0.2)
            assert setpoints(tree) == []

    run_virtual(run)


def test_saf_001_deadline_is_checked_at_the_wire_by_the_transport_alone() -> None:
    """The same with a frozen gate, which cannot expire the setpoint."""

    async def run() -> None:
        async with open_inline_tree(FakeHardware(write_s=0.05)) as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(ttl_s=0.03, a=5.0), Accepted)
            freeze(tree, "gate")
            await trio.sleep(0.08)
            assert len(tree.wires_made) == 1, "the wire is not fenced yet"
            assert setpoints(tree) == []

    run_virtual(run)


def test_saf_001_no_setpoint_after_its_deadline_while_resending() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            setpoint = writer.setpoint(ttl_s=0.1, a=5.0)
            assert isinstance(await writer.ref.ask(setpoint, 1.0), Accepted)
            await trio.sleep(1.0)
            written = tree.hardware.of("setpoint")
            assert len(written) >= 4, "the setpoint is resent until its deadline"
            assert all(entry.t_ns < setpoint.deadline_ns for entry in written)

    run_virtual(run)


def test_saf_002_older_epoch_is_refused_at_the_wire() -> None:
    """A setpoint that the gate accepted before a stop waits in the transport's mailbox, and the stop
    overtakes it.
    """

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            assert isinstance(await writer.send(a=1.0), Accepted)
            await trio.sleep(0.01)
            transport = tree.node.ref(tree.gate.address.replace("gate", "transport"))
            epoch = writer.lease.epoch
            now_ns = tree.node.clock.now_ns()
            transport.tell(MakeSafe(epoch + 1, "limp", Reason.STOP))
            transport.tell(Write(epoch, now_ns + 100 * MS, (9.0, 9.0)))
            await trio.sleep(0.05)
            safe = tree.hardware.of("safe")
            assert safe and safe[-1].safe_state == "limp"
            assert setpoints(tree, safe[-1].t_ns) == []

    run_virtual(run)


def test_saf_002_a_waiting_stop_cancels_a_write_that_has_begun() -> None:
    """The write waits for its bus when the stop arrives. Its bytes are never sent."""

    async def run() -> None:
        async with open_inline_tree(FakeHardware(write_s=0.01)) as tree:
            writer = await armed(tree)
            async with trio.open_nursery() as nursery:
                nursery.start_soon(writer.send, 0.1, True)
                await writer.send(latched=True, a=7.0)
                await trio.sleep(0.002)
                await tree.gate.ask(Stop(Reason.STOP), 1.0)
            assert setpoints(tree) == []
            assert tree.hardware.of("safe")

    run_virtual(run)


def test_saf_002_a_setpoint_of_an_older_epoch_is_refused_with_the_reason() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(ttl_s=0.05, a=5.0)
            await trio.sleep(0.2)
            assert (await tree.status()).mode == "holding"
            held_ns = tree.node.clock.now_ns()
            answer = await writer.send(a=6.0)
            assert isinstance(answer, Refused) and answer.code == "stale_epoch"
            assert answer.text.endswith("(the setpoint expired). Send it again")
            await trio.sleep(0.1)
            assert setpoints(tree, held_ns) == []
            await tree.gate.ask(Stop(Reason.STOP, "op"), 1.0)
            await tree.gate.ask(Resume("op"), 1.0)
            answer = await writer.send(a=6.0)
            assert isinstance(answer, Refused) and answer.code == "stale_epoch"
            assert "()" not in answer.text, "after a resume there is no cause to name"

    run_virtual(run)


def test_saf_002_the_last_safe_frame_comes_after_the_fence() -> None:
    """A transport that hangs in a write may continue later, but after the fence nothing can follow. The
    frame before the fence is for a root that dies in between.
    """

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            place, second = tree.wire, tree.keeper.channels.own
            assert second is not None
            make_safe = second.make_safe
            ended: list[bool] = []

            async def watched(safe_state: str) -> tuple[MotorReport, ...]:
                ended.append(place._ended.is_set())
                return await make_safe(safe_state)

            second.make_safe = watched  # type: ignore[method-assign]
            tree.hardware.write_s = 0.5
            await writer.send(ttl_s=5.0, latched=True, a=5.0)
            await trio.sleep(2.0)
            assert ended == [False, True], "one safe frame before the fence, and one after the wire group has ended"
            assert setpoints(tree) == []

    run_virtual(run)


def test_saf_003_a_crashed_actor_ends_its_group_and_the_stop_channel_makes_safe() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            await trio.sleep(0.05)
            crashed_ns = tree.node.clock.now_ns()
            gate = tree.node.cells[tree.gate.address].actor
            gate._look = lambda now_ns: 1 / 0  # type: ignore[attr-defined]
            await tree.until("disarmed")
            safe = tree.hardware.of("safe", crashed_ns)
            assert safe[0].path == "stop_channel" and safe[0].safe_state == "limp"
            assert safe[0].t_ns - crashed_ns < 50 * MS
            assert setpoints(tree, safe[0].t_ns) == []
            assert tree.hardware.energised == [False, False]

    run_virtual(run)


def test_saf_004_frozen_gate_stops_the_keepalive_and_is_fenced() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            await trio.sleep(0.1)
            freeze(tree, "gate")
            frozen_ns = tree.node.clock.now_ns()
            await trio.sleep(0.4)
            assert len(setpoints(tree, frozen_ns + 20 * MS)) == 0
            safe = tree.hardware.of("safe", frozen_ns)
            assert safe[0].path == "stop_channel"
            assert safe[0].t_ns - frozen_ns < 250 * MS

    run_virtual(run)


def test_saf_004_frozen_transport_stops_the_keepalive_and_is_fenced() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            await trio.sleep(0.1)
            tree.hardware.read_hangs = True
            frozen_ns = tree.node.clock.now_ns()
            await trio.sleep(0.4)
            tree.hardware.read_hangs = False
            safe = tree.hardware.of("safe", frozen_ns)
            assert safe[0].path == "stop_channel"
            assert safe[0].t_ns - frozen_ns < 250 * MS
            assert len(setpoints(tree, frozen_ns + 25 * MS)) == 0

    run_virtual(run)


def test_saf_004_the_watchdog_asks_a_transport_that_has_not_answered_for_no_resend() -> None:
    """The watchdog asks for a resend only if the transport has answered the last cycle."""

    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            transport = tree.node.cells[tree.gate.address.replace("gate", "transport")]
            cycles: list[Cycle] = []
            put = transport.mailbox.put
            answered: list[int] = []

            class Spy:
                def __getattr__(self, name: str) -> object:
                    return getattr(box, name)

                def put(self, message: object, reply: object, sender: str) -> bool:
                    if isinstance(message, Cycle):
                        cycles.append(message)
                        answered.append(watchdog._transport_answered)
                    return put(message, reply, sender)  # type: ignore[arg-type]

            box = transport.mailbox
            watchdog = tree.node.cells[tree.gate.address.replace("gate", "watchdog")].actor
            transport.mailbox = Spy()  # type: ignore[assignment]
            for dispatch in range(40):
                tree.hardware.read_s = 0.03 if dispatch % 4 == 3 else 0.001
                await writer.send(ttl_s=0.3, a=5.0)
                await trio.sleep(0.02)
            transport.mailbox = box
            resends = [cycle for cycle in cycles if cycle.resend_epoch]
            assert resends, "some cycles were answered in time"
            assert len(resends) < len(cycles), "a cycle after an unanswered one asks for no resend"
            for cycle, last_answer in zip(cycles, answered, strict=True):
                assert (cycle.resend_epoch == 0) or last_answer == cycle.number - 1

    run_virtual(run)


def test_saf_004_the_setpoint_of_a_frozen_writer_is_not_resent_for_ever() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            sent_ns = tree.node.clock.now_ns()
            await trio.sleep(3.0)
            last = tree.hardware.of("setpoint")[-1]
            assert 900 * MS < last.t_ns - sent_ns <= 1020 * MS, "resent until the end of the lease"
            safe = tree.hardware.of("safe", sent_ns)
            assert [entry.safe_state for entry in safe] == ["hold"]
            status = await tree.status()
            assert status.mode == "holding" and "stopped answering" in status.cause

    run_virtual(run)


def test_a_lease_with_heartbeats_keeps_a_latched_setpoint() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            for _ in range(50):
                await trio.sleep(0.1)
                writer.ref.tell(Beat(writer.lease.id))
            assert (await tree.status()).mode == "armed"
            assert tree.hardware.of("safe") == []

    run_virtual(run)


def test_a_latched_setpoint_lives_from_the_last_response_of_its_thread_and_not_from_the_heartbeat() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            await writer.send(latched=True, a=5.0)
            await trio.sleep(0.5)
            answered_ns = tree.node.clock.now_ns() - 300 * MS
            writer.ref.tell(Beat(writer.lease.id, answered_ago_s=0.3))
            for _ in range(30):
                await trio.sleep(0.05)
                writer.ref.tell(Beat(writer.lease.id, answered_ago_s=-1.0))
            assert 1000 * MS <= tree.hardware.of("safe")[0].t_ns - answered_ns <= 1030 * MS

    run_virtual(run)


def test_saf_004_a_thread_that_only_computes_loses_its_latched_setpoint_but_not_its_rollout() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            policy = Writer(tree, "policy")
            await writer.send(latched=True, a=5.0)
            for _ in range(30):
                await trio.sleep(0.05)
                writer.ref.tell(Beat(writer.lease.id, answered_ago_s=-1.0))
            assert (await tree.status()).mode == "holding"
            await writer.acquire()
            lease = await policy.ref.ask(Acquire("policy", over=writer.lease.id), 1.0)
            assert isinstance(lease, Lease)
            policy.lease = lease
            for _ in range(60):
                await trio.sleep(0.05)
                writer.ref.tell(Beat(writer.lease.id, answered_ago_s=-1.0))
                assert isinstance(await policy.send(ttl_s=0.1, a=6.0), Accepted)
            for _ in range(30):  # without heartbeats, as of a frozen process, the rollout ends too
                await trio.sleep(0.05)
                last = await policy.send(ttl_s=0.1, a=6.0)
            assert isinstance(last, Refused)
            assert (await tree.status()).mode == "holding"

    run_virtual(run)
