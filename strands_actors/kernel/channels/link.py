"""A link: the inherited socket between a parent process and its child.

It carries frames and descriptors. Its end of file means that the other process has ended. A link never blocks:
frames that a frozen peer does not read are kept up to a bound, and dropped and counted beyond it. Everything
here runs in the node's loop, except ``send_at_once``, which may be called from any thread.
"""

from __future__ import annotations

import os
import socket
import struct
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence

import trio

from strands_actors.kernel.router import Router

from .permissions import Channel

BACKLOG_BYTES = 256 * 1024
# With a larger buffer the interpreter would allocate and free memory pages at each read.
_READ_BYTES = 16 * 1024
HEAD = struct.Struct("<IB")
"""The header of a frame: its length, and the number of descriptors that come with it."""
_MAX_FRAME = 1 << 20
_MAX_DESCRIPTORS = 8
_INT = struct.calcsize("i")
_ANCILLARY_BYTES = socket.CMSG_LEN(_MAX_DESCRIPTORS * _INT)
# Linux has this flag. macOS lacks it.
_CLOEXEC: int = getattr(socket, "MSG_CMSG_CLOEXEC", 0)


def packet_of(data: bytes, descriptors: int = 0) -> bytes:
    """Return the bytes of a frame (one message between processes), with its header."""
    return HEAD.pack(len(data), descriptors) + data


class Link:
    """One end of a link (the inherited socket between a parent process and its child).

    Args:
        node: The node of this process. It receives the frames.
        sock: The socket. The link closes it.
        on_closed: Called once, in the node's loop, when the other end is gone.
        channel: The messages that the other end may send. None allows all.
    """

    def __init__(
        self,
        node: Router,
        sock: socket.socket,
        on_closed: Callable[[], None] | None = None,
        channel: Channel | None = None,
    ) -> None:
        self.channel = channel
        self._node = node
        self._socket = sock
        self._on_closed = on_closed
        self._backlog: deque[tuple[memoryview, tuple[int, ...]]] = deque()
        self._backlog_bytes = 0
        self._backlog_added = trio.Event()
        self._token: trio.lowlevel.TrioToken | None = None
        self._sending = threading.Lock()
        """Held while bytes are sent, so that no frame begins within another."""
        self.closed = False
        self.dropped = 0
        sock.setblocking(False)

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Send and receive frames until the other end of the link is gone, or the task is cancelled."""
        self._token = trio.lowlevel.current_trio_token()
        try:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(self._write_backlog)
                self._node.attach(self)
                task_status.started()
                await self._read()
                nursery.cancel_scope.cancel()
        except* trio.ClosedResourceError:
            # This end has closed the link.
            pass
        finally:
            self.close()

    def close(self) -> None:
        if self.closed:
            return
        with self._sending:
            self.closed = True
            trio.lowlevel.notify_closing(self._socket)
            self._socket.close()
        while self._backlog:
            _close_all(self._backlog.popleft()[1])
        self._node.detach(self)
        if self._on_closed is not None:
            self._on_closed()

    # -- methods of ``Connection``, which links and meshes share

    def send(self, to: str, data: bytes, descriptors: tuple[int, ...] = (), urgent: bool = False) -> bool:
        if self.closed:
            return False
        packet = packet_of(data, len(descriptors))
        if len(packet) > BACKLOG_BYTES:
            # The socket might accept only a part of this packet, and the rest does not fit into the backlog.
            self.dropped += 1
            return False
        with self._sending:
            if self._backlog:
                self._keep(memoryview(packet), descriptors)
                return True
            try:
                sent = self._send(packet, descriptors)
            except BlockingIOError:
                self._keep(memoryview(packet), descriptors)
            except OSError:
                # The reader of this link will notice the end of the connection.
                return False
            else:
                if sent < len(packet):
                    self._keep(memoryview(packet)[sent:], ())
        return True

    def send_at_once(self, data: bytes) -> bool:
        packet = packet_of(data)
        with self._sending:
            if self.closed or self._backlog or self._token is None:
                return False
            try:
                sent = self._socket.send(packet)
            except OSError:
                return False
            # Linux sends such a short packet as a whole. Other systems may send a part of it.
            if sent < len(packet):
                self._backlog.append((memoryview(packet)[sent:], ()))
                self._backlog_bytes += len(packet) - sent
                self._token.run_sync_soon(lambda: self._backlog_added.set())
        return True

    def announce(self, address: str, hosted: bool) -> None:
        self.send("", self._node.hosts_frame(address, hosted))

    def _send(self, data: bytes | memoryview, descriptors: tuple[int, ...]) -> int:
        if descriptors:
            return socket.send_fds(self._socket, [data], list(descriptors))
        return self._socket.send(data)

    def _keep(self, packet: memoryview, descriptors: tuple[int, ...]) -> None:
        if self._backlog and self._backlog_bytes + len(packet) > BACKLOG_BYTES:
            self.dropped += 1
            return
        # The caller may close its descriptors before they are sent, so keep duplicates.
        self._backlog.append((packet, tuple(os.dup(fd) for fd in descriptors)))
        self._backlog_bytes += len(packet)
        self._backlog_added.set()

    async def _write_backlog(self) -> None:
        while True:
            await self._backlog_added.wait()
            self._backlog_added = trio.Event()
            while self._backlog:
                packet, descriptors = self._backlog[0]
                try:
                    sent = self._send(packet, descriptors)
                except BlockingIOError:
                    await trio.lowlevel.wait_writable(self._socket)
                    continue
                except OSError:
                    return
                _close_all(descriptors)
                self._backlog_bytes -= sent
                if sent < len(packet):
                    self._backlog[0] = (packet[sent:], ())
                else:
                    self._backlog.popleft()

    async def _read(self) -> None:
        descriptors: deque[int] = deque()
        try:
            await self._read_frames(descriptors)
        finally:
            _close_all(descriptors)

    async def _read_frames(self, descriptors: deque[int]) -> None:
        room = bytearray(_READ_BYTES)
        rooms, read = (room,), memoryview(room)
        # The beginning of a frame that has not arrived completely yet.
        rest = b""
        while True:
            await trio.lowlevel.wait_readable(self._socket)
            try:
                size, ancillary, _, _ = self._socket.recvmsg_into(rooms, _ANCILLARY_BYTES, _CLOEXEC)
            except BlockingIOError:
                continue
            except ConnectionError:
                return
            if ancillary:
                descriptors.extend(_descriptors(ancillary))
            if not size:
                return
            data = rest + read[:size] if rest else read[:size]
            with self._node.dispatch:
                consumed = self._take_frames(data, descriptors)
            if consumed is None:
                return
            rest = bytes(data[consumed:])

    def _take_frames(self, data: bytes | memoryview, descriptors: deque[int]) -> int | None:
        """Handle all complete frames in the data, and return the number of their bytes.

        Return None if the other end sends invalid frames.
        """
        start, length = 0, len(data)
        while length - start >= HEAD.size:
            size, count = HEAD.unpack_from(data, start)
            if size > _MAX_FRAME:
                return None
            end = start + HEAD.size + size
            if length < end:
                break
            own_descriptors = (
                tuple(descriptors.popleft() for _ in range(min(count, len(descriptors)))) if count else ()
            )
            self._node.receive_frame(bytes(data[start + HEAD.size : end]), self, own_descriptors)
            start = end
        return start


def _descriptors(ancillary: Sequence[tuple[int, int, bytes]]) -> Iterator[int]:
    for level, message_type, data in ancillary:
        if level == socket.SOL_SOCKET and message_type == socket.SCM_RIGHTS:
            yield from memoryview(data[: len(data) // _INT * _INT]).cast("i")


def _close_all(descriptors: Iterable[int]) -> None:
    for fd in descriptors:
        os.close(fd)
