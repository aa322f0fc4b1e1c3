"""Let a thread without a loop ask an actor of another process over the mesh.

A request that goes through the loop of its process wakes a thread there, which wakes the caller in turn. Here
the calling thread puts its request on zenoh, and the zenoh thread that receives the answer wakes the caller.
"""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable

import msgspec

from . import refusals
from .asks import AskTimeout, Unreachable, not_running
from .frames import ASK, REPLY, decode_frame, frame, read_reply
from .messages import MAX_MESSAGE_BYTES, Message


class _Waiting:
    """A thread that waits for an answer, and its result.

    The result is the body of a frame, or a failure.
    """

    __slots__ = ("answered", "body", "failure", "to")

    def __init__(self, to: str) -> None:
        self.to = to
        self.body: msgspec.Raw | None = None
        self.failure: Exception | None = None
        self.answered = threading.Lock()
        self.answered.acquire()


class ThreadAsks:
    """The pending requests of the threads of one process. All methods may be called from any thread.

    Args:
        reply_to: The key on which all answers come. The correlation id of an answer names its request, so an
            answer that comes too late is dropped.
    """

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
        """Send a request and wait for the answer. A refusal is an answer.

        Args:
            put: Sends a frame to an address. Returns False if no process hosts the address.
            to: The address of the actor.
            sender: The name of the sender.
            message: The request.
            decode: Decodes the body of the answer.
            deadline_s: Seconds from now until which the answer must have come.

        Raises:
            AskTimeout: No answer came in time.
            Unreachable: The actor does not exist or has ended, the mesh was closed, or this process is a fork
                of the one that opened the mesh.
        """
        if self._pid != os.getpid():
            raise Unreachable("this process was forked from the one that opened the robot. Open it here anew")
        cid = next(self._cids)
        data = frame(to, ASK, cid, sender, self.reply_to, message)
        if len(data) > MAX_MESSAGE_BYTES:
            return refusals.oversized(len(data))
        waiting = self._waiting[cid] = _Waiting(to)
        try:
            if self._closed:
                raise Unreachable(self._closed)
            if not put(to, data):
                raise not_running(to)
            if not waiting.answered.acquire(timeout=deadline_s):
                raise AskTimeout(f"no answer within {deadline_s:g} s")
        finally:
            self._waiting.pop(cid, None)
        if waiting.failure is not None:
            raise waiting.failure
        assert waiting.body is not None
        return read_reply(decode, waiting.body)

    def take(self, data: bytes) -> None:
        """Handle a frame that came on ``reply_to``. Drop a frame that is no answer, or for which no thread
        waits.
        """
        try:
            head = decode_frame(data)
        except (msgspec.MsgspecError, RecursionError, UnicodeDecodeError):
            return
        waiting = self._waiting.pop(head.cid, None) if head.kind == REPLY else None
        if waiting is not None:
            waiting.body = head.body
            waiting.answered.release()

    def fail(self, to: str, failure: Unreachable) -> None:
        """Raise ``failure`` in all threads that wait for the actor at ``to``."""
        for cid, waiting in list(self._waiting.items()):
            if waiting.to == to and self._waiting.pop(cid, None) is not None:
                waiting.failure = failure
                waiting.answered.release()

    def close(self, reason: str) -> None:
        """Raise ``Unreachable(reason)`` in all waiting threads, and in each later ``ask``."""
        self._closed = reason
        for to in {waiting.to for waiting in list(self._waiting.values())}:
            self.fail(to, Unreachable(reason))
