"""A thread sends an ask itself, and the event loop gets the answer."""

from __future__ import annotations

import socket
import threading
import time

import pytest
import trio
import trio.lowlevel

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.asks import AskTimeout
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.frames import TELL, frame
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node, Ref, Sent

from .kernel import Number, Recorder, real_time, until

ADDRESS = "strands/r/actor/echo"


class Echo(Actor):
    def receive(self, message: Number) -> Number:
        return message


async def linked(nursery: trio.Nursery) -> tuple[Node, Node, Link]:
    here, there = (Node(name, MonotonicClock()) for name in ("here", "there"))
    ours, theirs = socket.socketpair()
    link = Link(here, ours)
    for node in (here, there):
        await nursery.start(node.run)
    await nursery.start(there.cell("r/actor/echo", Echo).run)
    await nursery.start(link.run)
    await nursery.start(Link(there, theirs).run)
    await until(lambda: here.route(ADDRESS) is not None)
    return here, there, link


def must(sent: Sent | None) -> Sent:
    assert sent is not None
    return sent


@real_time
async def test_the_loop_gets_the_answer_to_an_ask_of_a_thread() -> None:
    async with trio.open_nursery() as nursery:
        here, _, _ = await linked(nursery)
        ref = here.ref(ADDRESS, Echo)
        sent = must(await trio.to_thread.run_sync(ref.ask_at_once, Number(1)))
        assert await sent.answer(5.0) == Number(1)
        late = must(await trio.to_thread.run_sync(ref.ask_at_once, Number(2)))
        await trio.sleep(0.05)  # the answer arrives before a task waits for it
        assert await late.answer(5.0) == Number(2)
        assert not here.pending
        nursery.cancel_scope.cancel()


@real_time
async def test_an_answer_without_a_waiting_task_is_forgotten() -> None:
    async with trio.open_nursery() as nursery:
        here, _, _ = await linked(nursery)
        must(here.ref(ADDRESS, Echo).ask_at_once(Number(1)))
        await until(lambda: not here.pending)
        nursery.cancel_scope.cancel()


@real_time
async def test_an_ask_of_a_thread_has_a_deadline() -> None:
    async with trio.open_nursery() as nursery:
        here, there, _ = await linked(nursery)
        there.cells[ADDRESS].work = lambda _: True  # type: ignore[method-assign]
        sent = must(here.ref(ADDRESS, Echo).ask_at_once(Number(1)))
        with pytest.raises(AskTimeout):
            await sent.answer(0.05)
        assert not here.pending
        nursery.cancel_scope.cancel()


@real_time
async def test_nothing_is_sent_without_a_link_or_behind_waiting_messages() -> None:
    here, there = (Node(name, MonotonicClock()) for name in ("here", "there"))
    ours, theirs = socket.socketpair()
    link = Link(here, ours)
    here.learn(ADDRESS, link, True)
    ref = here.ref(ADDRESS, Echo)
    assert here.ref("strands/r/actor/nobody", Echo).ask_at_once(Number(1)) is None
    assert ref.ask_at_once(Number(1)) is None, "the link does not run yet"
    log: list[Message] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(link.run)
        kept = 0
        while not link._backlog:
            link.send("", frame("strands/r/actor/log", TELL, 0, "", "", Number(kept)))
            kept += 1
        assert ref.ask_at_once(Number(-1)) is None
        cell = there.cell("r/actor/log", lambda: Recorder(log))
        cell.mailbox.capacity = 100_000
        await nursery.start(there.run)
        await nursery.start(cell.run)
        await nursery.start(Link(there, theirs).run)
        await until(lambda: len(log) == kept)
        assert log == [Number(value) for value in range(kept)]
        link.close()
        assert ref.ask_at_once(Number(-1)) is None
        assert not here.pending
        nursery.cancel_scope.cancel()


@real_time
async def test_threads_and_the_loop_send_whole_frames() -> None:
    threads, each = 4, 300
    async with trio.open_nursery() as nursery:
        here, there, _ = await linked(nursery)
        log: list[Message] = []
        cell = there.cell("r/actor/log", lambda: Recorder(log))
        cell.mailbox.capacity = 100_000
        await nursery.start(cell.run)
        await until(lambda: here.route(cell.address) is not None)
        ref, log_ref = here.ref(ADDRESS, Echo), here.ref(cell.address, Recorder)
        answered: list[int] = []

        def ask(first: int) -> None:
            for value in range(first, first + each):
                while (sent := ref.ask_at_once(Number(value))) is None:
                    time.sleep(0.0001)
                trio.from_thread.run(collect, sent, value)

        async def collect(sent: Sent, value: int) -> None:
            assert await sent.answer(30.0) == Number(value)
            answered.append(value)

        async with trio.open_nursery() as asking:
            for number in range(threads):
                asking.start_soon(trio.to_thread.run_sync, ask, number * each)
            for value in range(2000):
                log_ref.tell(Number(value))
                if value % 20 == 0:
                    await trio.lowlevel.checkpoint()
        await until(lambda: len(log) == 2000)
        assert sorted(answered) == list(range(threads * each))
        assert log == [Number(value) for value in range(2000)]
        assert not here.dead_letter_count and not there.dead_letter_count
        nursery.cancel_scope.cancel()


@real_time
async def test_a_blocked_loop_delays_no_ask_of_a_thread() -> None:
    """The peer runs in another event loop."""
    received_at_s: list[float] = []

    class Clerk(Actor):
        def receive(self, message: Number) -> Number:
            received_at_s.append(time.monotonic())
            return message

    ours, theirs = socket.socketpair()

    async def run_peer() -> None:
        node = Node("there", MonotonicClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell("r/actor/echo", Clerk).run)
            await Link(node, theirs).run()
            nursery.cancel_scope.cancel()

    thread = threading.Thread(target=trio.run, args=(run_peer,), daemon=True)
    thread.start()
    here = Node("here", MonotonicClock())
    async with trio.open_nursery() as nursery:
        await nursery.start(here.run)
        await nursery.start(Link(here, ours).run)
        await until(lambda: here.route(ADDRESS) is not None)
        ref: Ref = here.ref(ADDRESS, Echo)
        sent: list[Sent | None] = []
        asker = threading.Timer(0.1, lambda: sent.append(ref.ask_at_once(Number(1))))
        asker.start()
        time.sleep(0.6)  # noqa: ASYNC251  # this loop is blocked
        over_s = time.monotonic()
        assert received_at_s and received_at_s[0] < over_s - 0.2
        assert await must(sent[0]).answer(5.0) == Number(1)
        nursery.cancel_scope.cancel()
    await trio.to_thread.run_sync(thread.join)
