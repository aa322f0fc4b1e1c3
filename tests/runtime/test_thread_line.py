"""A thread asks an actor of another process by itself; what cannot go so says that nothing was sent."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager

import pytest
import trio

from strands_actors.runtime.actor import Actor
from strands_actors.runtime.frames import ASK, HOSTS, REPLY, Frame, decode_frame, frame
from strands_actors.runtime.link import HEAD
from strands_actors.runtime.messages import MAX_MESSAGE_BYTES, Message, Refused
from strands_actors.runtime.node import AskTimeout, Unreachable
from strands_actors.runtime.thread_line import NotSent, ThreadLine

PATIENCE_S = 20.0
OWN, TO = "strands/node/here/threads/r", "strands/r/actor/there"


class Ping(Message, frozen=True):
    text: str = ""


class Pong(Message, frozen=True):
    number: int


class There(Actor):
    def receive(self, message: Ping) -> Pong:
        return Pong(0)


class Peer:
    """The other end, byte by byte."""

    def __init__(self, sock: socket.socket) -> None:
        self.sock = sock
        sock.settimeout(PATIENCE_S)

    def read(self) -> Frame:
        size, _ = HEAD.unpack(self._exactly(HEAD.size))
        return decode_frame(self._exactly(size))

    def _exactly(self, size: int) -> bytes:
        return self.sock.recv(size, socket.MSG_WAITALL)

    def say(self, kind: int, cid: int, body: Message | None) -> bytes:
        data = frame(OWN, kind, cid, TO, TO, body)
        return HEAD.pack(len(data), 0) + data

    def answer(self, cid: int, number: int) -> None:
        self.sock.sendall(self.say(REPLY, cid, Pong(number)))


@contextmanager
def a_line() -> Iterator[tuple[ThreadLine, Peer]]:
    """A line that was made in a loop of its own, which runs on, and its other end."""
    ours, theirs = socket.socketpair()
    made: Future[tuple[ThreadLine, Callable[[], None]]] = Future()

    async def loop() -> None:
        token, over = trio.lowlevel.current_trio_token(), trio.Event()
        made.set_result((ThreadLine(ours, OWN, TO, There), lambda: token.run_sync_soon(over.set)))
        await over.wait()

    thread = threading.Thread(target=trio.run, args=(loop,), daemon=True)
    thread.start()
    line, end = made.result(PATIENCE_S)
    try:
        with theirs:
            peer = Peer(theirs)
            head = peer.read()
            assert (head.kind, head.sender, head.cid) == (HOSTS, OWN, 1)
            yield line, peer
    finally:
        line.close()
        end()
        thread.join(PATIENCE_S)


def soon(function: Callable[[], Message | None]) -> Future[Message | None]:
    """Run it in a thread."""
    future: Future[Message | None] = Future()

    def run() -> None:
        try:
            future.set_result(function())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return future


def test_a_thread_has_the_answer_to_its_own_question_in_whatever_pieces_it_comes() -> None:
    with a_line() as (line, peer):
        for number in range(1, 4):
            asked = soon(lambda: line.ask(Ping("hello"), PATIENCE_S))
            head = peer.read()
            assert (head.to, head.kind, head.reply_to) == (TO, ASK, OWN)
            noise = peer.say(HOSTS, 1, None) + peer.say(REPLY, head.cid + 7, Pong(-1))
            data = noise + peer.say(REPLY, head.cid, Pong(number)) + peer.say(HOSTS, 1, None)
            for at in range(0, len(data), 50):
                peer.sock.sendall(data[at : at + 50])
                time.sleep(0.001)
            assert asked.result(PATIENCE_S) == Pong(number)
        assert not line.closed


def test_a_second_thread_goes_another_way_while_the_first_one_waits() -> None:
    with a_line() as (line, peer):
        first = soon(lambda: line.ask(Ping(), PATIENCE_S))
        head = peer.read()
        with pytest.raises(NotSent):
            line.ask(Ping("second"), PATIENCE_S)
        peer.answer(head.cid, 1)
        assert first.result(PATIENCE_S) == Pong(1)
        third = soon(lambda: line.ask(Ping("third"), PATIENCE_S))
        head = peer.read()
        peer.answer(head.cid, 3)
        assert third.result(PATIENCE_S) == Pong(3)


def test_what_is_not_answered_in_time_is_never_answered() -> None:
    """The late answer must not be taken for that to the next question."""
    with a_line() as (line, peer):
        began_s = time.monotonic()
        with pytest.raises(AskTimeout, match=r"0\.05 s"):
            line.ask(Ping(), 0.05)
        assert time.monotonic() - began_s >= 0.05
        with pytest.raises(NotSent):
            line.ask(Ping(), PATIENCE_S)
        assert peer.read().kind == ASK
        assert peer.sock.recv(1) == b"", "and the other end knows"


def test_a_deadline_holds_whatever_else_is_heard() -> None:
    with a_line() as (line, peer):
        asked = soon(lambda: line.ask(Ping(), 0.2))
        began_s = time.monotonic()
        while not asked.done():
            assert time.monotonic() - began_s < PATIENCE_S
            try:
                peer.sock.sendall(peer.say(HOSTS, 1, None))
            except OSError:
                break
            time.sleep(0.01)
        assert isinstance(asked.exception(PATIENCE_S), AskTimeout)


def test_nothing_is_sent_to_an_end_that_is_gone() -> None:
    with a_line() as (line, peer):
        peer.sock.close()
        with pytest.raises(NotSent):
            line.ask(Ping(), PATIENCE_S)
        assert line.closed


def test_an_end_that_goes_away_with_the_question_is_no_silence() -> None:
    with a_line() as (line, peer):
        asked = soon(lambda: line.ask(Ping(), PATIENCE_S))
        peer.read()
        peer.sock.close()
        assert isinstance(asked.exception(PATIENCE_S), Unreachable)
        assert line.closed


def test_who_waits_is_told_when_the_line_is_closed_and_the_descriptor_is_given_back() -> None:
    with a_line() as (line, peer):
        asked = soon(lambda: line.ask(Ping(), PATIENCE_S))
        peer.read()
        line.close()
        assert isinstance(asked.exception(PATIENCE_S), Unreachable)
        until_s = time.monotonic() + PATIENCE_S
        while line._socket.fileno() >= 0:
            assert time.monotonic() < until_s
            time.sleep(0.001)


@pytest.mark.parametrize("answer", [b"\xc1", b"\x96\x01"])
def test_what_is_no_frame_ends_the_line(answer: bytes) -> None:
    with a_line() as (line, peer):
        asked = soon(lambda: line.ask(Ping(), PATIENCE_S))
        peer.read()
        peer.sock.sendall(HEAD.pack(len(answer), 0) + answer)
        assert isinstance(asked.exception(PATIENCE_S), Unreachable)
        assert line.closed


def test_an_answer_of_no_known_type_is_refused_by_name() -> None:
    with a_line() as (line, peer):
        asked = soon(lambda: line.ask(Ping(), PATIENCE_S))
        head = peer.read()
        peer.sock.sendall(peer.say(REPLY, head.cid, Ping("what")))
        answer = asked.result(PATIENCE_S)
        assert isinstance(answer, Refused)
        assert answer.code == "malformed_reply"
        assert not line.closed


def test_what_is_too_long_is_left_to_who_refuses_it() -> None:
    with a_line() as (line, peer):
        with pytest.raises(NotSent):
            line.ask(Ping("x" * MAX_MESSAGE_BYTES), PATIENCE_S)
        asked = soon(lambda: line.ask(Ping("short"), PATIENCE_S))
        head = peer.read()
        assert len(head.body) < 100
        peer.answer(head.cid, 1)
        assert asked.result(PATIENCE_S) == Pong(1)


def test_a_wait_that_is_interrupted_leaves_no_answer_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    with a_line() as (line, peer):

        def interrupted(body: object) -> Message | None:
            raise KeyboardInterrupt

        monkeypatch.setattr(line, "_decode", interrupted)
        asked = soon(lambda: line.ask(Ping(), PATIENCE_S))
        peer.answer(peer.read().cid, 1)
        assert isinstance(asked.exception(PATIENCE_S), KeyboardInterrupt)
        assert line.closed


def test_a_forked_process_keeps_off_its_parents_line() -> None:
    with a_line() as (line, peer):
        child = os.fork()
        if child == 0:
            try:
                line.ask(Ping(), 1.0)
            except NotSent:
                os._exit(7)
            finally:
                os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
        asked = soon(lambda: line.ask(Ping(), PATIENCE_S))
        head = peer.read()
        peer.answer(head.cid, 1)
        assert asked.result(PATIENCE_S) == Pong(1)


def test_the_loop_hears_of_the_first_word_and_of_the_end() -> None:
    async def run() -> None:
        ours, theirs = socket.socketpair()
        line = ThreadLine(ours, OWN, TO, There)
        with theirs, trio.fail_after(PATIENCE_S):
            peer = Peer(theirs)
            theirs.sendall(peer.say(HOSTS, 1, None))
            assert await line.is_up()
            assert not line.ended.is_set()
            await trio.to_thread.run_sync(line.close)
            await line.ended.wait()

    trio.run(run)


def test_a_line_that_nobody_took_is_not_up() -> None:
    async def run() -> None:
        ours, theirs = socket.socketpair()
        theirs.close()
        line = ThreadLine(ours, OWN, TO, There)
        with trio.fail_after(PATIENCE_S):
            assert not await line.is_up()
        line.close()

    trio.run(run)
