"""A thread sends an ask to an actor of another process without the event loop. It gets the answer to its
own ask, or an error.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future

import pytest
import trio
import zenoh

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.asks import went_away
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.frames import ASK, REPLY, TELL, Frame, decode_frame, frame, protocol_of
from strands_actors.kernel.messages import MAX_MESSAGE_BYTES, Message, Refused
from strands_actors.kernel.node import AskTimeout, Unreachable
from strands_actors.kernel.thread_asks import ThreadAsks

from .joints import by_zenoh
from .kernel import Alarm, real_time

PATIENCE_S = 20.0
OWN, TO, OTHER = "strands/node/here/threads", "strands/r/actor/there", "strands/r/actor/other"


class Ping(Message, frozen=True):
    text: str = ""


class Pong(Message, frozen=True):
    number: int


class There(Actor):
    def __init__(self, silent: bool = False) -> None:
        self._silent = silent

    async def receive(self, message: Ping | Alarm) -> Pong:
        match message:
            case Ping() if self._silent:
                await trio.sleep_forever()
            case Ping():
                return Pong(len(message.text))
        return Pong(0)


decode = protocol_of(There).decode_reply


class World:
    """The open asks of this process, and the frames that it has sent."""

    def __init__(self) -> None:
        self.asks = ThreadAsks(OWN)
        self.sent: list[Frame] = []
        self.there = True

    def put(self, to: str, data: bytes) -> bool:
        if self.there:
            self.sent.append(decode_frame(data))
        return self.there

    def ask(self, message: Message, deadline_s: float = PATIENCE_S, to: str = TO) -> Message | None:
        return self.asks.ask(self.put, to, "me", message, decode, deadline_s)

    def soon(self, message: Message, to: str = TO) -> tuple[Frame, Future[Message | None]]:
        """Ask in another thread. Return the sent frame and the future answer."""
        before = len(self.sent)
        future = soon(lambda: self.ask(message, to=to))
        until_s = time.monotonic() + PATIENCE_S
        while len(self.sent) == before:
            assert time.monotonic() < until_s
            time.sleep(0.001)
        return self.sent[-1], future

    def answer(self, cid: int, body: Message, kind: int = REPLY) -> None:
        self.asks.take(frame(OWN, kind, cid, "", TO, body))


def soon(function: Callable[[], Message | None]) -> Future[Message | None]:
    future: Future[Message | None] = Future()

    def run() -> None:
        try:
            future.set_result(function())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future


def test_a_thread_gets_the_answer_to_its_own_ask_among_other_frames() -> None:
    world = World()
    for number in range(1, 4):
        head, future = world.soon(Ping("hello"))
        assert (head.to, head.kind, head.sender, head.reply_to) == (TO, ASK, "me", OWN)
        for noise in (b"", b"\xc1", b"\x96\x01", bytes(300)):
            world.asks.take(noise)
        world.answer(head.cid + 7, Pong(-1))
        world.answer(head.cid, Pong(-2), TELL)
        assert not future.done()
        world.answer(head.cid, Pong(number))
        world.answer(head.cid, Pong(-3))  # twice
        assert future.result(PATIENCE_S) == Pong(number)


def test_threads_that_ask_at_once_get_their_own_answers_in_any_order() -> None:
    world = World()
    futures = [world.soon(Ping(str(number))) for number in range(8)]
    for number, (head, _) in reversed([*enumerate(futures)]):
        world.answer(head.cid, Pong(number))
    assert [future.result(PATIENCE_S) for _, future in futures] == [Pong(number) for number in range(8)]


def test_saf_010_an_ask_that_timed_out_is_never_answered() -> None:
    """The late answer must not be used as the answer to the next ask."""
    world = World()
    began_s = time.monotonic()
    with pytest.raises(AskTimeout, match=r"0\.05 s"):
        world.ask(Ping(), 0.05)
    assert time.monotonic() - began_s >= 0.05
    head, future = world.soon(Ping())
    world.answer(world.sent[0].cid, Pong(1))
    time.sleep(0.02)
    assert not future.done()
    world.answer(head.cid, Pong(2))
    assert future.result(PATIENCE_S) == Pong(2)


def test_an_ask_to_an_address_without_an_actor_fails_at_once() -> None:
    world = World()
    world.there = False
    with pytest.raises(Unreachable, match="the there of r is not running"):
        world.ask(Ping())


def test_the_end_of_an_actor_fails_the_asks_to_it_and_no_others() -> None:
    world = World()
    _, lost = world.soon(Ping())
    head, other = world.soon(Ping(), to=OTHER)
    world.asks.fail(TO, went_away(TO))
    assert isinstance(error := lost.exception(PATIENCE_S), Unreachable) and "went away" in str(error)
    assert not other.done()
    world.answer(head.cid, Pong(1))
    assert other.result(PATIENCE_S) == Pong(1)


def test_the_end_of_the_session_fails_open_asks_and_later_ones() -> None:
    world = World()
    waiting = [world.soon(Ping(), to)[1] for to in (TO, OTHER, TO)]
    world.asks.close("the mesh was left")
    for future in waiting:
        assert isinstance(future.exception(PATIENCE_S), Unreachable)
    with pytest.raises(Unreachable, match="left"):
        world.ask(Ping())


def test_an_answer_of_an_unknown_type_is_refused() -> None:
    world = World()
    head, future = world.soon(Ping())
    world.answer(head.cid, Ping("what"))
    answer = future.result(PATIENCE_S)
    assert isinstance(answer, Refused)
    assert answer.code == "malformed_reply"


def test_a_message_that_is_too_long_is_refused_and_not_sent() -> None:
    world = World()
    answer = world.ask(Ping("x" * MAX_MESSAGE_BYTES))
    assert isinstance(answer, Refused)
    assert answer.code == "oversized"
    assert not world.sent


def test_an_interrupted_wait_leaves_nothing_behind() -> None:
    world = World()

    def interrupted(to: str, data: bytes) -> bool:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        world.asks.ask(interrupted, TO, "me", Ping(), decode, PATIENCE_S)
    assert not world.asks._waiting


def test_a_forked_process_does_not_use_its_parents_session() -> None:
    world = World()
    child = os.fork()
    if child == 0:
        try:
            world.ask(Ping(), 1.0)
        except Unreachable as error:
            os._exit(7 if "forked" in str(error) and not world.sent else 2)
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7


@real_time
async def test_saf_006_a_stop_that_a_thread_sends_is_sent_with_urgent_priority(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It has the same priority as one that the loop sends: it overtakes waiting messages and is not
    delayed for a batch.
    """
    seen: list[tuple[str, zenoh.Priority, bool]] = []
    take = ZenohMesh._on_sample

    def spy(self: ZenohMesh, sample: zenoh.Sample) -> None:
        kind = decode_frame(sample.payload.to_bytes()).kind
        if kind == ASK:
            seen.append((str(sample.key_expr), sample.priority, sample.express))
        take(self, sample)

    monkeypatch.setattr(ZenohMesh, "_on_sample", spy)
    async with by_zenoh() as pair:
        ours = pair.connection
        assert isinstance(ours, ZenohMesh)
        ours.serve_threads()
        cell = await pair.host("there", There)
        ref = pair.here.ref(cell.address, There)
        await ref.ask(Alarm(1), PATIENCE_S)  # by the loop
        await trio.to_thread.run_sync(ref.ask_here, Alarm(2), PATIENCE_S)
        await trio.to_thread.run_sync(ref.ask_here, Ping(), PATIENCE_S)
    received = [(priority, express) for key, priority, express in seen if key == cell.address]
    by_loop, by_thread, ordinary = received[-3:]
    assert by_thread == by_loop == (zenoh.Priority.REAL_TIME, True)
    assert ordinary == (zenoh.Priority.INTERACTIVE_HIGH, False)


@real_time
async def test_over_zenoh_a_thread_gets_answers_and_the_end_of_an_actor() -> None:
    async with by_zenoh() as pair:
        ours = pair.connection
        assert isinstance(ours, ZenohMesh)
        ours.serve_threads()
        # a subscriber that hosts no actor
        curious = ours._session.declare_subscriber("strands/**", lambda sample: None)
        cells = await pair.host("quick", There), await pair.host("silent", lambda: There(silent=True))
        quick, silent = (pair.here.ref(cell.address, There) for cell in cells)
        with trio.fail_after(PATIENCE_S):
            while True:
                try:
                    answer = await trio.to_thread.run_sync(quick.ask_here, Ping("four"), PATIENCE_S)
                except Unreachable:
                    await trio.sleep(0.002)
                else:
                    break
        assert answer == Pong(4)
        with pytest.raises(AskTimeout):
            await trio.to_thread.run_sync(silent.ask_here, Ping(), 0.05)
        assert await trio.to_thread.run_sync(quick.ask_here, Ping("seven.."), PATIENCE_S) == Pong(7)
        async with trio.open_nursery() as nursery:
            started = trio.Event()

            async def end() -> None:
                await started.wait()
                await trio.sleep(0.1)
                await trio.to_thread.run_sync(pair.sever)

            nursery.start_soon(end)
            started.set()
            began_s = time.monotonic()
            with pytest.raises(Unreachable, match="went away"):
                await trio.to_thread.run_sync(silent.ask_here, Ping(), PATIENCE_S)
            assert time.monotonic() - began_s < PATIENCE_S / 2
        for ask in (silent.ask_here, quick.ask_here):
            with trio.fail_after(PATIENCE_S):  # the end of each actor arrives by itself
                while True:
                    with pytest.raises(Unreachable) as error:
                        await trio.to_thread.run_sync(ask, Ping(), PATIENCE_S)
                    if "is not running" in str(error.value):
                        break
        with pytest.raises(Unreachable, match="is not running"):
            await quick.ask(Ping(), PATIENCE_S)
        curious.undeclare()  # type: ignore[no-untyped-call]
