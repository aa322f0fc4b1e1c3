"""Receive the pictures of a camera as a WebRTC video stream. The sender is GStreamer's ``webrtcsink`` with its
signalling server.

aiortc needs an asyncio loop, which runs in a thread here. A separate process for the camera uses this module; it
may be killed at any time. No server on the Internet is contacted, since both ends are in one network. Sound and
data channels are not used.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import trio

from strands_actors.contract.cameras import Picture
from strands_actors.contract.wire import WireDown
from strands_actors.kernel.clock import NS

from ..codecs import webrtc_messages as w
from ..codecs.malformed import MalformedFrame

if TYPE_CHECKING:
    from aiortc import MediaStreamTrack, RTCPeerConnection
    from websockets.asyncio.client import ClientConnection

CONNECT_S = 3.0
"""Timeout of each answer of the signalling server."""
BEGIN_S = 8.0
"""Timeout of the first picture."""
SILENT_S = 2.0
"""Without a picture for so long the stream counts as lost."""
CLOSE_S = 0.5
MAX_MESSAGE = 256 * 1024
LATE_S = 2.0
"""A stream with pictures older than this is opened again."""
LEAST_S = 1e-6
"""Least time from one picture to the next."""
DRIFT = 2e-4
"""Largest difference in rate between the sender's clock and ours, which are two quartzes."""


class WebRtcVideo:
    """A WebRTC video stream. All its methods must be called from one trio loop.

    Args:
        url: The address of the signalling server.
        producer: The name of the video's sender.
    """

    paced = True

    def __init__(self, url: str, producer: str) -> None:
        self._url = url
        self._producer = producer
        self._newest: Picture | None = None
        self._end_reason = ""
        self._news = trio.Event()
        self._token = trio.lowlevel.current_trio_token()
        self._runner = asyncio.Runner()
        self._loop = self._runner.get_loop()
        self._closed = asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="webrtc", daemon=True)

    async def open(self) -> None:
        """Wait for the first picture. Raise ``WireDown`` if it does not come in time."""
        self._thread.start()
        try:
            await self._until_news(BEGIN_S)
        except BaseException:
            with trio.CancelScope(shield=True):
                await self.aclose()
            raise

    async def read(self) -> Picture:
        """Wait for a new picture and return the newest.

        Raises:
            WireDown: The stream has ended, is silent, or is late.
        """
        await self._until_news(SILENT_S)
        picture, self._newest = self._newest, None
        assert picture is not None
        late_s = time.monotonic() - picture.captured_ns / NS
        if late_s > LATE_S:
            raise WireDown(f"{self._url}: its pictures arrive {late_s:.1f} s late")
        return picture

    async def _until_news(self, within_s: float) -> None:
        with trio.move_on_after(within_s):
            while self._newest is None and not self._end_reason:
                await self._news.wait()
        if self._newest is None:
            raise WireDown(self._end_reason or f"{self._url}: no picture of {self._producer} within {within_s:g} s")

    async def aclose(self) -> None:
        """End the session with the sender, but wait at most ``CLOSE_S`` for it. The thread ends in any case."""
        # This fails if the asyncio loop has ended already.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._closed.set)
        with trio.move_on_after(CLOSE_S):
            await trio.to_thread.run_sync(self._thread.join, abandon_on_cancel=True)

    def _tell(self, picture: Picture | None, reason: str) -> None:
        """Store a new picture, or the reason why the stream has ended. Runs in trio's thread."""
        self._newest, self._end_reason = picture or self._newest, reason
        self._news.set()
        self._news = trio.Event()

    # -- methods that run in the asyncio thread

    def _run(self) -> None:
        reason = "the stream was closed"
        try:
            with self._runner:
                self._runner.run(self._watch())
        except (WireDown, MalformedFrame) as failure:
            reason = f"{self._url}: {failure}"
        except TimeoutError:
            reason = f"{self._url}: no answer within {CONNECT_S:g} s"
        # aiortc raises many types of exceptions, also for data of the peer.
        except Exception as failure:
            reason = f"{self._url}: {failure or type(failure).__name__}"
        self._put(None, reason)

    def _put(self, picture: Picture | None, reason: str = "") -> None:
        # This fails if the trio loop that receives the pictures has ended.
        with contextlib.suppress(trio.RunFinishedError):
            self._token.run_sync_soon(self._tell, picture, reason)

    async def _watch(self) -> None:
        from aiortc import RTCConfiguration, RTCPeerConnection
        from websockets.asyncio.client import connect

        connection = RTCPeerConnection(RTCConfiguration(iceServers=[]))
        try:
            async with connect(
                self._url, open_timeout=CONNECT_S, close_timeout=CLOSE_S, max_size=MAX_MESSAGE
            ) as ws:
                session = _ProducerSession(connection, ws, self._put)
                closed = asyncio.ensure_future(self._closed.wait())
                talk = asyncio.ensure_future(session.talk(self._producer))
                done, _ = await asyncio.wait((closed, talk, session.over), return_when=asyncio.FIRST_COMPLETED)
                for task in (closed, talk):
                    task.cancel()
                await session.leave()
            if session.over in done and talk not in done:
                raise WireDown(session.over.result())
            with contextlib.suppress(asyncio.CancelledError):
                # If the session's task has failed, awaiting it raises the reason.
                await talk
        finally:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(CLOSE_S):
                    await connection.close()


class _ProducerSession:
    """The WebRTC session with one sender of video: its signalling messages, and its video."""

    def __init__(self, connection: RTCPeerConnection, ws: ClientConnection, put: Callable[[Picture], None]) -> None:
        self._connection = connection
        self._ws = ws
        self._put = put
        self._name = ""
        self._early: list[w.Candidate] = []
        self._offered = False
        self._frames: asyncio.Task[None] | None = None
        self.over: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        """Why the video has ended."""
        connection.on("track", self._on_track)
        connection.on("connectionstatechange", self._on_state)

    async def talk(self, producer: str) -> None:
        """Handle the signalling messages of the session. Never returns. Raise ``WireDown`` if the sender is missing
        or ends the session."""
        from websockets.exceptions import ConnectionClosed

        try:
            await self._ws.send(w.LIST)
            listing = await self._hear("list")
            producer_ids = {each.name: each.id for each in listing.producers}
            if producer not in producer_ids:
                raise WireDown(f"no video sender {producer!r} there. Senders: {', '.join(producer_ids) or 'none'}")
            await self._ws.send(w.start_session(producer_ids[producer]))
            self._name = (await self._hear("sessionStarted")).session_id
            while True:
                await self._take(await self._next())
        except ConnectionClosed as closed:
            raise WireDown(f"the connection to the signalling server was lost: {closed}") from None

    async def leave(self) -> None:
        from websockets.exceptions import ConnectionClosed

        if self._frames is not None:
            self._frames.cancel()
        if self._name:
            with contextlib.suppress(ConnectionClosed):
                await self._ws.send(w.end_session(self._name))

    async def _hear(self, message_type: str) -> w.ServerMessage:
        async with asyncio.timeout(CONNECT_S):
            while True:
                message = await self._next()
                if message.type == message_type:
                    return message

    async def _next(self) -> w.ServerMessage:
        message = w.decode_incoming(await self._ws.recv())
        if message.type == "error":
            raise WireDown(f"the signalling server reports an error: {message.details}")
        return message

    async def _take(self, message: w.ServerMessage) -> None:
        from aiortc import RTCSessionDescription

        if message.session_id != self._name:
            return
        if message.type == "endSession":
            self._name = ""
            raise WireDown("the robot has ended the stream")
        if message.sdp is not None and message.sdp.type == "offer":
            await self._connection.setRemoteDescription(RTCSessionDescription(message.sdp.sdp, "offer"))
            self._offered = True
            for candidate in self._early:
                await self._reach(candidate)
            for stream in self._connection.getTransceivers():
                if stream.kind != "video":
                    # No task would read the sound of this stream, which would then fill its queue.
                    stream.direction = "inactive"
            await self._connection.setLocalDescription(await self._connection.createAnswer())
            await self._ws.send(w.answer(self._name, self._connection.localDescription.sdp))
        elif message.ice is not None:
            if self._offered:
                await self._reach(message.ice)
            else:
                self._early.append(message.ice)

    async def _reach(self, received: w.Candidate) -> None:
        from aiortc.sdp import candidate_from_sdp

        if not received.candidate:
            await self._connection.addIceCandidate(None)
            return
        try:
            candidate = candidate_from_sdp(received.candidate.removeprefix("candidate:"))
        except (ValueError, IndexError, AssertionError):
            # aiortc does not support this kind of address. Another address may work.
            return
        candidate.sdpMLineIndex = received.sdp_m_line_index
        await self._connection.addIceCandidate(candidate)

    def _on_state(self) -> None:
        if self._connection.connectionState in ("failed", "closed"):
            self._end(f"the connection has {self._connection.connectionState}")

    def _on_track(self, track: MediaStreamTrack) -> None:
        if track.kind == "video" and self._frames is None:
            self._frames = asyncio.ensure_future(self._read(track))

    async def _read(self, track: MediaStreamTrack) -> None:
        import numpy
        from aiortc.mediastreams import MediaStreamError
        from av import VideoFrame

        stamps = Stamps()
        try:
            while True:
                frame = await track.recv()
                assert isinstance(frame, VideoFrame) and frame.pts is not None and frame.time_base is not None
                captured_s = stamps.captured_s(float(frame.pts * frame.time_base), time.monotonic())
                image = numpy.asarray(frame.to_ndarray(format="rgb24"), numpy.uint8)
                self._put(Picture(image, round(captured_s * NS)))
        except MediaStreamError:
            self._end("the robot sends no video any more")
        # The decoder may fail, or the picture may have an unexpected shape.
        except Exception as failure:
            self._end(f"its video cannot be read: {failure or type(failure).__name__}")

    def _end(self, reason: str) -> None:
        if not self.over.done():
            self.over.set_result(reason)


class Stamps:
    """Compute when pictures were taken, by our clock, from the time stamps of the sender's clock.

    The offset between the clocks is taken from the picture with the shortest delay. The other pictures are older by
    their additional delay. So a picture that has waited in a queue does not count as new.
    """

    def __init__(self) -> None:
        self._ahead_s = math.inf
        """Difference between our clock and the sender's."""
        self._last_now_s = self._stamp_s = self._last_s = -math.inf

    def captured_s(self, stamp_s: float, now_s: float) -> float:
        """Return when a picture was taken, in seconds of our clock. The result always increases. If the sender's
        stamps go back, the offset between the clocks is estimated again."""
        bound_s = math.inf
        if stamp_s > self._stamp_s > -math.inf:
            bound_s = self._ahead_s + DRIFT * (now_s - self._last_now_s)
        self._stamp_s, self._last_now_s = stamp_s, now_s
        self._ahead_s = min(now_s - stamp_s, bound_s)
        self._last_s = max(self._last_s + LEAST_S, stamp_s + self._ahead_s)
        return self._last_s
