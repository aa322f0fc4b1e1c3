"""Actors: the annotation of ``receive`` is the protocol, and a failure goes to the supervisor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import trio
from trio.testing import MockClock, wait_all_tasks_blocked

from strands_actors.kernel.actor import Actor, Deferred
from strands_actors.kernel.asks import Deadlines
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.frames import Down, protocol_of
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Answer, AskTimeout, Node, Unreachable

from .kernel import (
    Alarm,
    Boom,
    LateAnswer,
    Never,
    Newest,
    Number,
    Recorder,
    Unwanted,
    recorder,
    running_node,
    virtual_time,
)

if TYPE_CHECKING:
    from strands_actors.kernel.messages import Message as OnlyForCheckers


class Doubler(Actor):
    def receive(self, message: Number) -> Number:
        return Number(message.value * 2)


class SlowDoubler(Actor):
    async def receive(self, message: Number) -> Number:
        await trio.sleep(0.1)
        return Number(message.value * 2)


class SaysNothing(Actor):
    def receive(self, message: Number | None) -> None:
        pass


class TakesStrings(Actor):
    def receive(self, message: Number | str) -> None:
        pass


class TakesAnything(Actor):
    def receive(self, message: Any) -> None:
        pass


class NotAnnotated(Actor):
    def receive(self, message):  # type: ignore[no-untyped-def]
        pass


class OtherName(Actor):
    def receive(self, letter: Number) -> None:  # type: ignore[override]
        pass


class NotImported(Actor):
    def receive(self, message: OnlyForCheckers) -> None:
        pass


class NoReceive(Actor):
    pass


# -- the protocol


def test_the_protocol_is_the_union_in_the_annotation() -> None:
    protocol = protocol_of(Recorder)
    assert {kind.__name__ for kind in protocol.accepts} == {
        "Number", "Newest", "Other", "Alarm", "Block", "Never", "LateAnswer", "Boom", "Table",
    }  # fmt: skip
    assert protocol.is_async
    assert not protocol_of(Doubler).is_async
    assert protocol.decode(msgspec.msgpack.encode(Alarm(3))) == Alarm(3)
    assert protocol_of(Doubler).decode_reply(msgspec.msgpack.encode(Refused("a", "b"))) == Refused("a", "b")


@pytest.mark.parametrize(
    ("actor", "says"),
    [
        (NotAnnotated, "annotate its argument 'message' with the types it accepts"),
        (OtherName, "annotate its argument 'message' with the types it accepts"),
        (TakesStrings, "<class 'str'> is not a Message. Annotate 'message' with subclasses"),
        (SaysNothing, "<class 'NoneType'> is not a Message. Annotate 'message' with subclasses"),
        (TakesAnything, "typing.Any is not a Message. Annotate 'message' with subclasses"),
        (NoReceive, "typing.Any is not a Message. Annotate 'message' with subclasses"),
        (NotImported, "'OnlyForCheckers' is not defined. Import or define what it names at module level"),
    ],
)
def test_an_invalid_annotation_is_refused_with_the_remedy(actor: type[Actor], says: str) -> None:
    with pytest.raises(TypeError) as caught:
        protocol_of(actor)
    assert str(caught.value).startswith(f"{actor.__name__}.receive: ")
    assert says in str(caught.value)


@virtual_time
async def test_a_message_of_a_wrong_type_is_refused_and_counted_and_never_handled() -> None:
    async with recorder() as (node, cell, log):
        ref = node.ref(cell.address, Recorder)
        answer = await ref.ask(Unwanted(1), 1.0)
        assert isinstance(answer, Refused)
        assert answer.code == "wrong_type"
        assert answer.reason == "Recorder does not take Unwanted"
        assert "Alarm" in answer.remedy and "Number" in answer.remedy
        ref.tell(Unwanted(2))
        assert (node.refused_count, node.dead_letter_count) == (2, 2)
        letter = node.dead_letters[-1]
        assert (letter.to, letter.message_type, letter.reason) == (cell.address, "Unwanted", answer.reason)
        assert await ref.ask(Number(1), 1.0) == Number(1)
        assert log == [Number(1)]
        assert cell.incarnations == 1


@virtual_time
async def test_a_subclass_of_an_accepted_type_is_refused() -> None:
    class Special(Number, frozen=True):
        pass

    async with recorder() as (node, cell, _):
        answer = await node.ref(cell.address, Recorder).ask(Special(1), 1.0)
        assert isinstance(answer, Refused)
        assert answer.code == "wrong_type"


# -- asking and answering


@pytest.mark.parametrize("actor", [Doubler, SlowDoubler])
@virtual_time
async def test_receive_may_be_a_function_or_a_coroutine(actor: type[Actor]) -> None:
    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/doubler", actor)
        await nursery.start(cell.run)
        ref = node.ref(cell.address, actor)
        assert await ref.ask(Number(21), 1.0) == Number(42)


@virtual_time
async def test_a_coroutine_handles_one_message_at_a_time() -> None:
    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/doubler", SlowDoubler)
        await nursery.start(cell.run)
        answered: list[tuple[float, Message | None]] = []

        async def ask(value: int) -> None:
            answer = await node.ref(cell.address, SlowDoubler).ask(Number(value), 10.0)
            answered.append((round(trio.current_time() - start, 3), answer))

        start = trio.current_time()
        async with trio.open_nursery() as askers:
            for value in range(3):
                askers.start_soon(ask, value)
        assert [when for when, _ in answered] == [0.1, 0.2, 0.3]


@virtual_time
async def test_a_deferred_answer_may_come_later_and_only_once() -> None:
    async with recorder() as (node, cell, _):
        ref = node.ref(cell.address, Recorder)
        answers: list[Message | None] = []

        async def ask() -> None:
            answers.append(await ref.ask(Never(), 5.0))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(ask)
            await trio.sleep(1)
            assert answers == []
            assert await ref.ask(Number(2), 1.0) == Number(2)  # the open ask does not block the actor
            ref.tell(LateAnswer())
        ref.tell(LateAnswer())
        assert await ref.ask(Number(3), 1.0) == Number(3)
        assert answers == [Number(-1)]


@virtual_time
async def test_the_first_answer_counts() -> None:
    early, failed = Answer(None), Answer(None)
    early.send(Number(1))
    early.send(Number(2))
    early.fail(AskTimeout("too late"))
    assert await early.wait() == Number(1)
    failed.fail(AskTimeout("first"))
    failed.send(Number(1))
    with pytest.raises(AskTimeout, match="first"):
        await failed.wait()


def test_a_deferred_answer_to_a_tell_does_nothing() -> None:
    Deferred(None).send(Number(1))


@virtual_time
async def test_asks_time_out_at_their_deadlines_in_any_order() -> None:
    async with recorder() as (node, cell, _):
        ref = node.ref(cell.address, Recorder)
        start = trio.current_time()
        ended: list[tuple[float, float]] = []

        async def ask(after_s: float, deadline_s: float) -> None:
            await trio.sleep(after_s)
            with pytest.raises(AskTimeout, match=f"no answer within {deadline_s:g} s"):
                await ref.ask(Never(), deadline_s)
            ended.append((deadline_s, round(trio.current_time() - start, 6)))

        async with trio.open_nursery() as nursery:
            for after_s, deadline_s in ((0, 3.0), (0.5, 1.0), (0.6, 1.0), (1.0, 0.25), (2.5, 1.0)):
                nursery.start_soon(ask, after_s, deadline_s)
        assert sorted(ended, key=lambda end: end[1]) == [
            (0.25, 1.25), (1.0, 1.5), (1.0, 1.6), (3.0, 3.0), (1.0, 3.5),
        ]  # fmt: skip


def test_an_answer_that_came_during_a_stall_counts() -> None:
    clock = MockClock()

    async def stall() -> Message | None:
        deadlines, answer = Deadlines(), Answer(None)
        deadlines.add(answer, 0.5)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(deadlines.run)
            await wait_all_tasks_blocked()
            # The answer has come, and the loop has not read it yet, when the loop wakes long after the deadline.
            trio.lowlevel.current_trio_token().run_sync_soon(answer.send, Number(1))
            clock.jump(2.0)
            await wait_all_tasks_blocked()
            clock.jump(1.0)
            received = await answer.wait()
            nursery.cancel_scope.cancel()
        return received

    # The order in which trio runs tasks is random.
    for _ in range(40):
        assert trio.run(stall, clock=clock) == Number(1)


@virtual_time
async def test_a_cancelled_ask_leaves_nothing_behind() -> None:
    async with recorder() as (node, cell, log):
        ref = node.ref(cell.address, Recorder)
        with trio.move_on_after(0.5):
            await ref.ask(Never(), 5.0)
        ref.tell(LateAnswer())
        await trio.sleep(10)
        assert log == [Never(), LateAnswer()]
        assert node.pending == {}


@virtual_time
async def test_an_address_without_an_actor_is_unreachable() -> None:
    async with running_node() as (node, _):
        with pytest.raises(Unreachable, match="the none of r is not running"):
            await node.ref("strands/r/actor/none").ask(Number(1), 1.0)
        node.ref("strands/r/actor/none").tell(Number(1))
        assert node.dead_letters[-1].reason == "nobody hosts it"


# # -- timers, tasks and addresses


@virtual_time
async def test_timers_tick_during_a_slow_handler() -> None:
    ticks: list[float] = []

    class Ticker(Actor):
        async def started(self) -> None:
            self.context.every(0.1, lambda now_ns: Number(now_ns))

        async def receive(self, message: Number) -> None:
            ticks.append(round(message.value / 1e9 - start, 6))
            if len(ticks) == 2:
                await trio.sleep(0.35)

    async with running_node() as (node, nursery):
        start = trio.current_time()
        await nursery.start(node.cell("r/actor/ticker", Ticker).run)
        await trio.sleep(0.65)
    # The timer continues while the handler waits. Its messages are commands and wait in the mailbox.
    assert ticks == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]


@virtual_time
async def test_timers_and_tasks_end_with_the_incarnation() -> None:
    made = 0

    class Ticker(Actor):
        async def started(self) -> None:
            self.context.every(0.1, self.make)

        def make(self, now_ns: int) -> Number:
            nonlocal made
            made += 1
            return Number(made)

        def receive(self, message: Number) -> None:
            pass

    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/ticker", Ticker)
        scope = trio.CancelScope()

        async def run() -> None:
            with scope:
                await cell.run()

        nursery.start_soon(run)
        await trio.sleep(0.35)
        scope.cancel()
        await trio.sleep(1)
        assert made == 3
        assert cell.state == "stopped"


@virtual_time
async def test_a_failing_task_of_an_actor_fails_the_actor() -> None:
    class Starter(Actor):
        async def started(self) -> None:
            self.context.start_soon(self.fail)

        async def fail(self) -> None:
            await trio.sleep(1)
            raise RuntimeError("in a task")

        def receive(self, message: Number) -> None:
            pass

    node = Node("n", VirtualClock())
    with pytest.RaisesGroup(pytest.RaisesExc(RuntimeError, match="in a task")):
        await node.cell("r/actor/starter", Starter).run()


@virtual_time
async def test_messages_name_their_sender() -> None:
    """Two actors send setpoints to a third one, and each has its own place there, by its address."""

    class Sender(Actor):
        async def started(self) -> None:
            for value in (1, 2):
                self.context.ref("strands/r/actor/sink").tell(Newest(value))
            assert self.context.me.address == self.context.address

        def receive(self, message: Newest) -> None:
            pass

    async with running_node() as (node, nursery):
        sink = node.cell("r/actor/sink", Sender)
        node.host(sink)  # the actor does not run
        for name in ("a", "b"):
            await nursery.start(node.cell(f"r/actor/{name}", Sender).run)
        for value in (1, 2):
            node.ref(sink.address).tell(Newest(value))
        assert (len(sink.mailbox), sink.mailbox.conflated) == (3, 3)


@virtual_time
async def test_an_address_has_one_cell() -> None:
    async with recorder() as (node, cell, _):
        downs: list[Message] = []

        class Watcher(Actor):
            async def started(self) -> None:
                self.context.watch(cell.address)

            def receive(self, message: Down) -> None:
                downs.append(message)

        async with trio.open_nursery() as nursery:
            await nursery.start(node.cell("r/actor/watcher", Watcher).run)
            with pytest.raises(ValueError, match="strands/r/actor/recorder is already hosted here"):
                await node.cell("r/actor/recorder", Doubler).run()
            await wait_all_tasks_blocked()
            nursery.cancel_scope.cancel()
        assert downs == []  # the first actor still runs
        assert await node.ref(cell.address, Recorder).ask(Number(1), 1.0) == Number(1)


@virtual_time
async def test_messages_that_wait_when_an_address_is_released_are_refused() -> None:
    async with running_node() as (node, _):
        cell = node.cell("r/actor/doubler", Doubler)
        node.host(cell)
        answers: list[Message | None] = []

        async def ask() -> None:
            answers.append(await node.ref(cell.address, Doubler).ask(Number(1), 1.0))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(ask)
            await wait_all_tasks_blocked()
            node.release(cell)
        assert [answer.code for answer in answers if isinstance(answer, Refused)] == ["gone"]
        assert node.dead_letters[-1].reason == "the actor ended"
        node.release(cell)  # harmless


@virtual_time
async def test_a_reference_reaches_the_current_actor_of_its_address() -> None:
    async with running_node() as (node, _):
        first, second = (node.cell("r/actor/doubler", Doubler) for _ in range(2))
        ref = node.ref(first.address)
        ref.tell(Number(0))
        node.host(first)
        ref.tell(Number(1))
        node.release(first)
        ref.tell(Number(2))
        node.host(second)
        ref.tell(Number(3))
        assert first.mailbox.pop() is None
        assert second.mailbox.pop() == (Number(3), None) and second.mailbox.pop() is None
        assert [letter.reason for letter in node.dead_letters] == [
            "nobody hosts it",
            "the actor ended",
            "nobody hosts it",
        ]


# -- failure


@virtual_time
async def test_an_exception_reaches_the_supervisor_and_the_asker() -> None:
    async with running_node() as (node, nursery):
        log: list[Message] = []
        cell = node.cell("r/actor/recorder", lambda: Recorder(log))
        failures: list[BaseException] = []

        async def run(task_status: trio.TaskStatus[None]) -> None:
            try:
                await cell.run(task_status)
            except* ValueError as group:
                failures.extend(group.exceptions)

        await nursery.start(run)
        answer = await node.ref(cell.address, Recorder).ask(Boom("no fuse"), 1.0)
        assert isinstance(answer, Refused)
        assert answer.code == "crashed"
        assert answer.reason == "strands/r/actor/recorder failed: ValueError: no fuse"
        await wait_all_tasks_blocked()
        assert [str(failure) for failure in failures] == ["no fuse"]
        assert cell.state == "stopped"


@virtual_time
async def test_a_message_does_not_reach_an_actor_before_it_has_started() -> None:
    order: list[str] = []

    class Slow(Actor):
        async def started(self) -> None:
            await trio.sleep(1)
            order.append("started")

        def receive(self, message: Number) -> None:
            order.append("received")

    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/slow", Slow)
        nursery.start_soon(cell.run)
        await wait_all_tasks_blocked()
        assert cell.state == "starting"
        node.ref(cell.address).tell(Number(1))
        await trio.sleep(2)
        assert cell.state == "running"
    assert order == ["started", "received"]
