"""Two nodes behave in the same way for each kind of connection: in memory, by zenoh, and by a link."""

from __future__ import annotations

import time
from contextlib import suppress

import msgspec
import pytest
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.frames import DOWN, Down, frame
from strands_actors.kernel.messages import MAX_MESSAGE_BYTES, Message
from strands_actors.kernel.node import AskTimeout, Unreachable

from .joints import Joint, Pair, by_zenoh, code_of, reachable
from .kernel import (
    PATIENCE_S,
    Alarm,
    Block,
    Boom,
    LateAnswer,
    Never,
    Newest,
    Number,
    Recorder,
    Table,
    local_pair,
    real_time,
    until,
    virtual_time,
)

encode = msgspec.msgpack.encode

BIG = Table({}, ("x" * (MAX_MESSAGE_BYTES + 1),))


class Watcher(Actor):
    """Watch one address and keep the messages about its end."""

    def __init__(self, address: str) -> None:
        self._address = address
        self.downs: list[Down] = []
        self.received = trio.Event()

    async def started(self) -> None:
        self.context.watch(self._address)

    def receive(self, message: Down | Alarm) -> Alarm | None:
        if isinstance(message, Alarm):
            return message
        self.downs.append(message)
        self.received.set()
        return None


async def watch(pair: Pair, address: str) -> Watcher:
    """Host a watcher on this node, and wait until its request has reached the other node."""
    watcher = Watcher(address)
    await pair.host("watcher", lambda: watcher, pair.here)
    await reachable(pair.here, pair.there.address)  # sent after the watch request, so it is answered after it
    return watcher


# -- tell and ask


@real_time
async def test_tell_and_ask(joint: Joint) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        ref = pair.here.ref(cell.address, Recorder)
        ref.tell(Number(1))
        assert await ref.ask(Number(2), 5.0) == Number(2)
        answer = await ref.ask(Table({"a": [1, None, {"b": 0.5}]}, ("x",)), 5.0)
        assert answer == Table({"a": [1, None, {"b": 0.5}]}, ("x",))
        assert await ref.ask(LateAnswer(), 5.0) is None
        assert log[:2] == [Number(1), Number(2)]
        assert pair.here.pending == {}
        assert pair.there.refused_count == 0


@real_time
async def test_without_the_protocol_an_answer_is_only_a_receipt(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        assert await pair.here.ref(cell.address).ask(Number(2), 5.0) is None


@real_time
async def test_many_asks_at_once_get_their_own_answers(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        ref = pair.here.ref(cell.address, Recorder)
        answers: dict[int, Message | None] = {}

        async def ask(value: int) -> None:
            answers[value] = await ref.ask(Number(value), 10.0)

        async with trio.open_nursery() as nursery:
            for value in range(200):
                nursery.start_soon(ask, value)
        assert answers == {value: Number(value) for value in range(200)}


@real_time
async def test_an_answer_after_the_deadline_is_a_dead_letter(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        ref = pair.here.ref(cell.address, Recorder)
        start = trio.current_time()
        with pytest.raises(AskTimeout, match=r"no answer within 0\.05 s"):
            await ref.ask(Never(), 0.05)
        assert 0.05 <= trio.current_time() - start < 5.0
        assert pair.here.pending == {}
        ref.tell(LateAnswer())
        await until(lambda: pair.here.dead_letter_count > 0)
        assert pair.here.dead_letters[-1].reason == "the asker no longer waits"
        assert await ref.ask(Number(1), 5.0) == Number(1)


@real_time
async def test_an_address_that_no_node_hosts_is_unreachable(joint: Joint) -> None:
    async with joint() as pair:
        ref = pair.here.ref("strands/r/actor/none", Recorder)
        with pytest.raises(Unreachable, match="the none of r is not running"):
            await ref.ask(Number(1), 5.0)
        ref.tell(Number(1))
        assert [letter.reason for letter in pair.here.dead_letters] == ["nobody hosts it"]
        assert pair.here.pending == {}


@real_time
async def test_a_released_address_is_unreachable(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        ref = pair.here.ref(cell.address, Recorder)
        pair.there.release(cell)
        with trio.fail_after(5), pytest.raises(Unreachable):
            while True:
                with suppress(AskTimeout):  # an ask that is on its way meanwhile may be lost
                    await ref.ask(Number(1), 0.1)


@real_time
async def test_the_asker_gets_the_failure_of_an_actor_as_a_refusal(joint: Joint) -> None:
    async with joint() as pair:
        log: list[Message] = []
        cell = pair.there.cell("r/actor/recorder", lambda: Recorder(log))

        async def keep(task_status: trio.TaskStatus[None]) -> None:
            try:
                await cell.run(task_status)
            except* ValueError:
                await cell.run()

        await pair.nursery.start(keep)
        await reachable(pair.here, cell.address)
        ref = pair.here.ref(cell.address, Recorder)
        assert code_of(await ref.ask(Boom("no fuse"), 5.0)) == "crashed"
        assert await ref.ask(Number(1), 5.0) == Number(1)
        assert cell.incarnations == 2


# -- lanes


@real_time
async def test_messages_of_one_sender_keep_their_order(joint: Joint) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        cell.mailbox.capacity = 10_000
        a, b = (pair.here.ref(cell.address, Recorder, sender=sender) for sender in "ab")
        for value in range(1000):
            a.tell(Number(value))
            b.tell(Number(10_000 + value))
        assert await a.ask(Number(1000), 10.0) == Number(1000)  # an ask does not overtake a tell
        values = [message.value for message in log if isinstance(message, Number)]
        assert [value for value in values if value < 10_000] == list(range(1001))
        assert [value for value in values if value >= 10_000] == list(range(10_000, 11_000))


@real_time
async def test_in_the_latest_lane_only_the_newest_message_is_read(joint: Joint) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        assert isinstance(cell.actor, Recorder)
        a, b = (pair.here.ref(cell.address, Recorder, sender=sender) for sender in "ab")
        a.tell(Block())
        await cell.actor.blocked.wait()
        answers: list[str] = []

        async def ask() -> None:
            answers.append(code_of(await a.ask(Newest(-1), 10.0)))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(ask)
            await until(lambda: len(cell.mailbox) == 1)
            for value in range(200):
                a.tell(Newest(value))
                b.tell(Newest(1000 + value))
        b.tell(Number(1))
        await until(lambda: len(cell.mailbox) == 3)
        assert answers == ["superseded"]
        assert cell.mailbox.conflated == 399
        cell.actor.release.set()
        assert await a.ask(Number(2), 10.0) == Number(2)
        assert log == [Block(), Newest(199), Newest(1199), Number(1), Number(2)]


@real_time
async def test_urgent_overtakes_and_a_full_queue_refuses_the_rest(joint: Joint) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        assert isinstance(cell.actor, Recorder)
        ref = pair.here.ref(cell.address, Recorder)
        ref.tell(Block())
        await cell.actor.blocked.wait()
        for value in range(1024):
            ref.tell(Number(value))
        assert code_of(await ref.ask(Number(-1), 10.0)) == "mailbox_full"
        assert pair.there.refused_count == 1
        ref.tell(Alarm(1))
        await until(lambda: cell.mailbox.urgent_waiting)
        cell.actor.release.set()
        await until(lambda: len(log) == 1026)
        assert log == [Block(), Alarm(1), *map(Number, range(1024))]


# -- watching


@real_time
async def test_a_watcher_gets_the_reason_when_an_actor_ends(joint: Joint) -> None:
    async with joint() as pair:
        log: list[Message] = []
        cell = pair.there.cell("r/actor/recorder", lambda: Recorder(log))

        async def run(task_status: trio.TaskStatus[None]) -> None:
            try:
                await cell.run(task_status)
            except* ValueError:
                pass

        await pair.nursery.start(run)
        await reachable(pair.here, cell.address)
        watcher = await watch(pair, cell.address)
        assert watcher.downs == []
        pair.here.ref(cell.address).tell(Boom("no fuse"))
        await watcher.received.wait()
        assert watcher.downs == [Down(cell.address, "ValueError: no fuse")]


@real_time
async def test_a_watcher_gets_the_end_of_a_node(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        watcher = await watch(pair, cell.address)
        pair.sever()
        await watcher.received.wait()
        assert watcher.downs == [Down(cell.address, "unreachable")]
        with pytest.raises(Unreachable):
            await pair.here.ref(cell.address, Recorder).ask(Number(1), 5.0)


@real_time
async def test_messages_that_a_node_sent_are_read_before_its_end(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        log: list[Message] = []

        class Heir(Actor):
            async def started(self) -> None:
                self.context.watch(cell.address)

            def receive(self, message: Number | Alarm | Down) -> Number | Alarm | None:
                log.append(message)
                return None if isinstance(message, Down) else message

        heir = await pair.host("heir", Heir, pair.here)
        await reachable(pair.here, pair.there.address)
        log.clear()
        sent = [Number(number) for number in range(900)]  # more than the mesh reads at a time
        for number in sent:
            pair.there.ref(heir.address).tell(number)
        pair.sever()
        time.sleep(0.3)  # noqa: ASYNC251  # no loop of either node runs, so the messages wait
        await until(lambda: any(isinstance(message, Down) for message in log))
        await trio.sleep(0.1)
        received = len(log) - 1  # messages that were not sent before the connection was cut are lost
        assert received > 0
        assert log == [*sent[:received], Down(cell.address, "unreachable")]


@real_time
async def test_an_answer_that_arrived_before_the_end_counts() -> None:
    """It counts even if many messages came before it and all of them are read late."""
    async with by_zenoh() as pair:
        cell, log = await pair.record()
        listener = await pair.host("listener", lambda: Recorder([]), pair.here)
        ref = pair.here.ref(cell.address, Recorder)

        async def answer_and_go() -> None:
            await until(lambda: Never() in log)
            talker = pair.there.ref(listener.address)
            for number in range(900):  # more than the mesh reads at a time, but not more than a mailbox holds
                talker.tell(Number(number))
            assert isinstance(cell.actor, Recorder)
            cell.actor.answer()
            pair.sever()
            time.sleep(0.3)  # noqa: ASYNC251  # no loop of either node runs, so the messages wait

        pair.nursery.start_soon(answer_and_go)
        assert await ref.ask(Never(), PATIENCE_S) == Number(-1)


@real_time
async def test_an_ask_fails_at_once_when_the_asked_node_ends(joint: Joint) -> None:
    """The asker does not wait for its deadline. Asks to other actors are still answered."""
    async with joint() as pair:
        cell, log = await pair.record()
        other, _ = await pair.record("other")
        here = await pair.host("here", lambda: Recorder([]), pair.here)

        async def sever() -> None:
            await until(lambda: Never() in log)
            pair.sever()

        pair.nursery.start_soon(sever)
        start = trio.current_time()
        with pytest.raises(Unreachable, match="of r went away, perhaps with what it was asked"):
            await pair.here.ref(cell.address, Recorder).ask(Never(), 10 * PATIENCE_S)
        assert trio.current_time() - start < PATIENCE_S
        assert pair.here.pending == {}
        with pytest.raises(Unreachable):
            await pair.here.ref(other.address, Recorder).ask(Number(1), PATIENCE_S)
        assert await pair.here.ref(here.address, Recorder).ask(Number(1), PATIENCE_S) == Number(1)


@real_time
async def test_the_end_of_another_actor_does_not_end_an_ask(joint: Joint) -> None:
    async with joint() as pair:
        cell, log = await pair.record()
        released, _ = await pair.record("gone")

        async def leave() -> None:
            await until(lambda: Never() in log)
            pair.there.release(released)
            with suppress(AskTimeout, Unreachable):
                while True:
                    await pair.here.ref(released.address, Recorder).ask(Number(1), 0.1)
            pair.here.ref(cell.address).tell(LateAnswer())

        pair.nursery.start_soon(leave)
        assert await pair.here.ref(cell.address, Recorder).ask(Never(), PATIENCE_S) is not None


@real_time
async def test_a_watcher_of_an_address_without_an_actor_gets_its_end_at_once(joint: Joint) -> None:
    async with joint() as pair:
        watcher = Watcher("strands/r/actor/none")
        await pair.host("watcher", lambda: watcher, pair.here)
        await watcher.received.wait()
        assert watcher.downs == [Down("strands/r/actor/none", "nobody hosts it")]


@real_time
async def test_a_down_message_without_a_watch_is_not_delivered(joint: Joint) -> None:
    async with joint() as pair:
        cell, _ = await pair.record()
        watcher = Watcher(pair.here.cells.get("", cell).address)
        await pair.host("watcher", lambda: watcher)
        address = "strands/r/actor/watcher"
        pair.raw(frame(address, DOWN, 0, "strands/r/actor/none", "", Down("strands/r/actor/none", "a lie")))
        await reachable(pair.here, address)
        assert watcher.downs == []


# -- the network in memory


@virtual_time
async def test_a_disconnected_node_is_unreachable_for_both_sides_until_it_is_connected_again() -> None:
    network, here, there = local_pair()
    async with trio.open_nursery() as nursery:
        logs: dict[str, list[Message]] = {}
        watchers: dict[str, Watcher] = {}
        for node in (here, there):
            await nursery.start(node.run)
            log = logs[node.name] = []
            await nursery.start(node.cell(f"r/actor/{node.name}", lambda log=log: Recorder(log)).run)
        for node, other in ((here, there), (there, here)):
            watcher = watchers[node.name] = Watcher(f"strands/r/actor/{other.name}")
            await nursery.start(node.cell(f"r/actor/watch-{node.name}", lambda watcher=watcher: watcher).run)
        network.cut(there)
        for node, other in ((here, there), (there, here)):
            await watchers[node.name].received.wait()
            assert watchers[node.name].downs == [Down(f"strands/r/actor/{other.name}", "unreachable")]
            with pytest.raises(Unreachable):
                await node.ref(f"strands/r/actor/{other.name}", Recorder).ask(Number(1), 1.0)
            node.ref(f"strands/r/actor/{other.name}").tell(Number(2))
            assert node.dead_letters[-1].reason == "nobody hosts it"
        network.heal(there)
        for node, other in ((here, there), (there, here)):
            answer = await node.ref(f"strands/r/actor/{other.name}", Recorder).ask(Number(3), 1.0)
            assert answer == Number(3)
            assert logs[other.name] == [Number(3)]  # lost messages are not sent again
        nursery.cancel_scope.cancel()


@virtual_time
async def test_watchers_get_the_end_of_actors_on_a_closed_mesh() -> None:
    _, here, there = local_pair()
    async with trio.open_nursery() as nursery:
        log: list[Message] = []
        await nursery.start(there.cell("r/actor/recorder", lambda: Recorder(log)).run)
        watcher = Watcher("strands/r/actor/recorder")
        await nursery.start(here.cell("r/actor/watcher", lambda: watcher).run)
        there.mesh.close()  # type: ignore[union-attr]
        await watcher.received.wait()
        assert watcher.downs == [Down("strands/r/actor/recorder", "unreachable")]
        nursery.cancel_scope.cancel()
