"""A thread without a loop asks an actor of another process over the mesh, and is woken by the
answer itself.

A verb that goes by the loop of its process wakes a thread there and is woken in turn. Here the
thread that calls puts its question on zenoh, and zenoh's own thread that brings the answer releases
it.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable

import msgspec

from strands_actors.kernel.refusals import Code

from .asks import AskTimeout, Unreachable, not_there
from .frames import ASK, REPLY, decode_frame, frame, read_reply
from .messages import MAX_MESSAGE_BYTES, Message, Refused


class _Waiting:
    """A thread that waits: for a frame's body, or for why there will be none."""

    __slots__ = ("body", "failure", "there", "to")

    def __init__(self, to: str) -> None:
        self.to = to
        self.body: msgspec.Raw | None = None
        self.failure: Exception | None = None
        self.there = threading.Lock()
        self.there.acquire()


class ThreadAsks:
    """The questions of one process's threads. ``reply_to``: the key on which answers come, all of
    them; who waits for which is told by its number, so that an answer that comes too late is
    nobody's.

    All methods are of any thread."""

    def __init__(self, reply_to: str) -> None:
        self.reply_to = reply_to
        self._pid = os.getpid()
        self._cids = itertools.count(1)
        self._waiting: dict[int, _Waiting] = {}
        self._closed = ""

    def ask(
        self,
        put: Callable[[str, bytes], bool],
        to: str,
        sender: str,
        message: Message,
        decode: Callable[[msgspec.Raw], Message | None],
        deadline_s: float,
    ) -> Message | None:
        """Send by ``put`` (address, frame; False: nobody is there) and wait. Raise ``AskTimeout``,
        or ``Unreachable``. A refusal is an answer."""
        if self._pid != os.getpid():
            raise Unreachable("this process was forked from the one that opened the robot. open it here anew")
        cid = next(self._cids)
        data = frame(to, ASK, cid, sender, self.reply_to, message)
        if len(data) > MAX_MESSAGE_BYTES:
            return Refused(Code.OVERSIZED, f"{len(data)} bytes", f"send at most {MAX_MESSAGE_BYTES}")
        waiting = self._waiting[cid] = _Waiting(to)
        try:
            if self._closed:
                raise Unreachable(self._closed)
            if not put(to, data):
                raise not_there(to)
            if not waiting.there.acquire(timeout=deadline_s):
                raise AskTimeout(f"no answer within {deadline_s:g} s")
        finally:
            self._waiting.pop(cid, None)
        if waiting.failure is not None:
            raise waiting.failure
        assert waiting.body is not None
        return read_reply(decode, waiting.body)

    def take(self, data: bytes) -> None:
        """A frame that came on ``reply_to``. What is no answer, or nobody waits for, is dropped."""
        try:
            head = decode_frame(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            return
        waiting = self._waiting.pop(head.cid, None) if head.kind == REPLY else None
        if waiting is not None:
            waiting.body = head.body
            waiting.there.release()

    def fail(self, to: str, failure: Unreachable) -> None:
        """Whoever waits for the actor at ``to`` is told so at once."""
        for cid, waiting in list(self._waiting.items()):
            if waiting.to == to and self._waiting.pop(cid, None) is not None:
                waiting.failure = failure
                waiting.there.release()

    def close(self, why: str) -> None:
        """So is whoever waits, and who asks from now on."""
        self._closed = why
        for to in {waiting.to for waiting in list(self._waiting.values())}:
            self.fail(to, Unreachable(why))
