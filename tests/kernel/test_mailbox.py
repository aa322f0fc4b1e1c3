"""A mailbox with its lanes, places and limits: alone, compared with a model, and in an actor."""

from __future__ import annotations

import trio
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from trio.testing import wait_all_tasks_blocked

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.inline_dispatch import BURST
from strands_actors.kernel.mailbox import CAPACITY, SUPERSEDED, Entry, Mailbox
from strands_actors.kernel.messages import Message, Refused

from .kernel import (
    Alarm,
    Block,
    Newest,
    Number,
    Other,
    Recorder,
    recorder,
    running_node,
    virtual_time,
)


class Reply:
    """Keep the answers."""

    def __init__(self) -> None:
        self.answers: list[Message | None] = []

    def send(self, answer: Message | None) -> None:
        self.answers.append(answer)


def drain(mailbox: Mailbox) -> list[Message]:
    messages = []
    while (entry := mailbox.pop()) is not None:
        messages.append(entry[0])
    return messages


def test_an_urgent_message_comes_before_ten_thousand_others() -> None:
    mailbox = Mailbox(capacity=10_000)
    for value in range(10_000):
        assert mailbox.put(Number(value), None, "a")
    assert not mailbox.urgent_waiting
    assert mailbox.put(Alarm(1), None, "b")
    assert mailbox.urgent_waiting
    assert drain(mailbox) == [Alarm(1), *map(Number, range(10_000))]


def test_a_full_command_lane_refuses_and_still_accepts_an_urgent_message() -> None:
    mailbox = Mailbox(capacity=3)
    assert [mailbox.put(Number(value), None, "a") for value in range(4)] == [True, True, True, False]
    assert not mailbox.put(Newest(1), None, "a")
    assert mailbox.put(Alarm(1), None, "a")
    assert len(mailbox) == 4
    assert drain(mailbox) == [Alarm(1), Number(0), Number(1), Number(2)]
    assert mailbox.put(Number(4), None, "a")


def test_a_full_mailbox_still_accepts_a_newer_message_of_a_waiting_type() -> None:
    mailbox = Mailbox(capacity=2)
    mailbox.put(Newest(1), None, "a")
    mailbox.put(Number(1), None, "a")
    assert mailbox.put(Newest(2), None, "a")
    assert drain(mailbox) == [Newest(2), Number(1)]


def test_the_urgent_lane_has_a_limit_too() -> None:
    mailbox = Mailbox(capacity=2)
    assert [mailbox.put(Alarm(value), None, "a") for value in range(3)] == [True, True, False]


def test_latest_has_one_place_per_sender_and_type() -> None:
    mailbox = Mailbox()
    for value in range(5):
        for sender in ("a", "b"):
            mailbox.put(Newest(value), None, sender)
            mailbox.put(Other(value), None, sender)
    assert mailbox.conflated == 16
    assert drain(mailbox) == [Newest(4), Other(4), Newest(4), Other(4)]
    assert mailbox.put(Newest(9), None, "a")
    assert drain(mailbox) == [Newest(9)]


def test_a_superseded_ask_is_answered_and_the_newest_stays_open() -> None:
    mailbox = Mailbox()
    older, newer = Reply(), Reply()
    mailbox.put(Newest(1), older, "a")
    mailbox.put(Newest(2), newer, "a")
    assert older.answers == [SUPERSEDED]
    assert newer.answers == []
    assert mailbox.pop() == (Newest(2), newer)
    assert mailbox.pop() is None


def test_a_mailbox_holds_a_thousand_by_default() -> None:
    mailbox = Mailbox()
    put = 0
    while mailbox.put(Number(put), None, "a"):
        put += 1
    assert put == CAPACITY == 1024


class MailboxAgainstModel(RuleBasedStateMachine):
    """With any mix of senders and lanes, each sender's order is kept, the latest lane keeps the newest
    message, and no message is lost or doubled.
    """

    def __init__(self) -> None:
        super().__init__()
        self.mailbox = Mailbox(capacity=6)
        self.urgent: list[Entry] = []
        self.places: list[tuple[tuple[str, type] | None, Entry]] = []
        self.superseded: list[Reply] = []
        self.waiting: list[Reply] = []
        self.count = 0

    def _message(self, kind: type[Alarm] | type[Number] | type[Newest] | type[Other]) -> Message:
        self.count += 1
        return kind(self.count)

    @rule(
        kind=st.sampled_from([Alarm, Number, Newest, Other]),
        sender=st.sampled_from("abc"),
        is_ask=st.booleans(),
    )
    def put(self, kind: type[Alarm], sender: str, is_ask: bool) -> None:
        message = self._message(kind)
        reply = Reply() if is_ask else None
        entry = (message, reply)
        taken = self.mailbox.put(message, reply, sender)
        key = (sender, kind) if message.lane == "latest" else None
        waiting_index = next((index for index, place in enumerate(self.places) if key and place[0] == key), None)
        if message.lane == "urgent":
            assert taken is (len(self.urgent) < 6)
            if taken:
                self.urgent.append(entry)
        elif waiting_index is not None:
            assert taken
            old = self.places[waiting_index][1][1]
            if isinstance(old, Reply):
                self.waiting.remove(old)
                self.superseded.append(old)
            self.places[waiting_index] = (key, entry)
        else:
            assert taken is (len(self.places) < 6)
            if taken:
                self.places.append((key, entry))
        if taken and reply is not None:
            self.waiting.append(reply)

    @rule()
    def pop(self) -> None:
        expected = self.urgent.pop(0) if self.urgent else self.places.pop(0)[1] if self.places else None
        assert self.mailbox.pop() == expected
        if expected is not None and isinstance(expected[1], Reply):
            self.waiting.remove(expected[1])

    @invariant()
    def counts_agree(self) -> None:
        assert len(self.mailbox) == len(self.urgent) + len(self.places)
        assert self.mailbox.urgent_waiting is bool(self.urgent)
        assert all(reply.answers == [SUPERSEDED] for reply in self.superseded)
        assert all(reply.answers == [] for reply in self.waiting)


TestMailboxAgainstModel = MailboxAgainstModel.TestCase


@virtual_time
async def test_waiting_ends_with_a_message_and_survives_cancellation() -> None:
    mailbox = Mailbox()
    with trio.move_on_after(1) as scope:
        await mailbox.wait()
    assert scope.cancelled_caught
    for message in (Number(1), Newest(1), Alarm(1)):
        async with trio.open_nursery() as nursery:
            nursery.start_soon(mailbox.wait)
            await wait_all_tasks_blocked()
            mailbox.put(message, None, "a")
        await mailbox.wait()  # returns at once, because a message waits
        assert drain(mailbox) == [message]


@virtual_time
async def test_the_urgent_lane_is_checked_before_each_message_of_a_burst() -> None:
    handled: list[Message] = []

    class Reader(Actor):
        def receive(self, message: Number | Alarm) -> None:
            handled.append(message)
            if isinstance(message, Number) and message.value in (5, 6):
                self.context.me.tell(Alarm(message.value))

    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/reader", Reader)
        cell.mailbox.capacity = 20_000
        for value in range(10_000):
            cell.mailbox.put(Number(value), None, "a")
        await nursery.start(cell.run)
        await wait_all_tasks_blocked()
    assert handled[5:10] == [Number(5), Alarm(5), Number(6), Alarm(6), Number(7)]
    assert len(handled) == 10_002


@virtual_time
async def test_a_stop_of_another_sender_waits_for_one_burst_at_most() -> None:
    log: list[Message] = []

    class Reader(Actor):
        def receive(self, message: Number | Alarm) -> None:
            log.append(message)

    async with running_node() as (node, nursery):
        cell = node.cell("r/actor/reader", Reader)
        cell.mailbox.capacity = 20_000
        for value in range(10_000):
            cell.mailbox.put(Number(value), None, "a")
        nursery.start_soon(cell.run)
        while not log:
            await trio.lowlevel.checkpoint()
        before = len(log)
        node.ref(cell.address).tell(Alarm(0))
        await wait_all_tasks_blocked()
    assert 0 < before <= 2 * BURST  # trio may run the reader twice before this task
    assert log[before] == Alarm(0)


@virtual_time
async def test_a_full_mailbox_refuses_an_ask_and_accepts_a_stop() -> None:
    async with recorder() as (node, cell, log):
        ref = node.ref(cell.address, Recorder)
        ref.tell(Block())
        await wait_all_tasks_blocked()
        for value in range(CAPACITY):
            ref.tell(Number(value))
        answer = await ref.ask(Number(-1), 1.0)
        assert isinstance(answer, Refused)
        assert answer.code == "mailbox_full"
        assert node.refused_count == 1
        assert node.dead_letters[-1].message_type == "Number"
        ref.tell(Alarm(0))
        assert isinstance(cell.actor, Recorder)
        cell.actor.release.set()
        await wait_all_tasks_blocked()
    assert log == [Block(), Alarm(0), *map(Number, range(CAPACITY))]
