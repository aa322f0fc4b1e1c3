"""A thread without a loop asks one actor of another process, over a link's socket, and waits in the system's calls.

A verb that goes by the loop of its process wakes a thread there and is woken in turn: 0.12 ms of the 0.28 that a
command took with warm caches, 0.2 to 0.4 and more when both had slept. Here the thread that calls sends, and the
answer wakes it. The other end is a ``Link`` like any other.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import threading
import time

import msgspec
import trio

from .actor import Actor
from .asks import AskTimeout
from .frames import ASK, HOSTS, REPLY, Frame, decode_frame, frame, protocol_of, read_reply
from .link import HEAD, packet_of
from .messages import MAX_MESSAGE_BYTES, Message
from .node import Unreachable

_READ_BYTES = 16 * 1024


class NotSent(Exception):
    """Nothing was: another thread asks just now, or there is nobody at the other end. Ask another way."""


class ThreadLine:
    """This end. ``ask`` is of any thread of the process that made it; what cannot go this way is ``NotSent``.

    It closes itself after anything but an answer: what comes late could be taken for the answer to something else.
    """

    def __init__(self, sock: socket.socket, own: str, to: str, protocol: type[Actor]) -> None:
        """Made in the loop. ``own``: the address that answers go to. ``to``: whom it asks, an actor of the class
        ``protocol``."""
        self._socket = sock
        self._own = own
        self._to = to
        self._decode = protocol_of(protocol).decode_reply
        self._token = trio.lowlevel.current_trio_token()
        self._asking = threading.Lock()
        self._pid = os.getpid()
        self._cids = itertools.count(1)
        self._rest = b""
        self.closed = False
        self.ended = trio.Event()
        """It is closed, as the loop sees it."""
        with contextlib.suppress(ConnectionError):  # nobody is there: ``is_up``
            sock.sendall(packet_of(frame("", HOSTS, 1, own, own, None)))

    async def is_up(self) -> bool:
        """Wait for the other end: a link says first of all what lives there. False when nobody took it."""
        await trio.lowlevel.wait_readable(self._socket)
        try:
            return bool(self._socket.recv(1, socket.MSG_PEEK))
        except ConnectionError:
            return False

    def ask(self, message: Message, deadline_s: float) -> Message | None:
        """Send and wait for the answer. Raise ``NotSent``, ``AskTimeout``, or ``Unreachable``: the other end is
        gone, and may have read it."""
        if self._pid != os.getpid() or not self._asking.acquire(blocking=False):
            raise NotSent
        try:
            return self._ask(message, deadline_s)
        except NotSent:
            raise
        except BaseException:
            self.close()
            raise
        finally:
            self._asking.release()
            if self.closed:
                self._end()

    def close(self) -> None:
        """Whoever asks is told that the other end is gone."""
        if not self.closed:
            self.closed = True
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            with contextlib.suppress(trio.RunFinishedError):
                self._token.run_sync_soon(self.ended.set)
        self._end()

    def _end(self) -> None:
        """Give the descriptor back, unless a thread waits on it: its number could be another's by then."""
        if self._asking.acquire(blocking=False):
            self._socket.close()
            self._asking.release()

    def _ask(self, message: Message, deadline_s: float) -> Message | None:
        if self.closed:
            raise NotSent
        cid = next(self._cids)
        data = frame(self._to, ASK, cid, self._own, self._own, message)
        if len(data) > MAX_MESSAGE_BYTES:
            raise NotSent
        until_s = time.monotonic() + deadline_s
        left_s = deadline_s
        try:
            self._socket.settimeout(left_s)
            self._send(packet_of(data))
            while left_s > 0:
                self._socket.settimeout(left_s)
                for head in self._receive():
                    if head.kind == REPLY and head.cid == cid:
                        return read_reply(self._decode, head.body)
                left_s = until_s - time.monotonic()
        except TimeoutError:
            pass
        raise AskTimeout(f"no answer within {deadline_s:g} s")

    def _send(self, packet: bytes) -> None:
        try:
            self._socket.sendall(packet)
        except ConnectionError:
            self.close()
            raise NotSent from None

    def _receive(self) -> list[Frame]:
        """Those that are whole, as soon as something has come."""
        try:
            data = self._socket.recv(_READ_BYTES)
        except ConnectionError:
            data = b""
        if not data:
            raise Unreachable(f"{self._to} went away")
        data = self._rest + data
        frames: list[Frame] = []
        start = 0
        while len(data) - start >= HEAD.size:
            end = start + HEAD.size + HEAD.unpack_from(data, start)[0]
            if len(data) < end:
                break
            try:
                frames.append(decode_frame(data[start + HEAD.size : end]))
            except msgspec.MsgspecError as error:
                raise Unreachable(f"{self._to} answers with no frame: {error}") from None
            start = end
        self._rest = data[start:]
        return frames
