"""A stand-in for the media server of Reachy Mini's daemon.

It is GStreamer's signalling server with one producer, which sends one colour, a tone and a data channel. It
runs as a separate process:
    python -m tests.drivers.reachy.media NAME

It prints its port. Lines on its standard input: ``colour R G B``, ``mute`` (sends no more pictures), ``end``
(ends all sessions), ``leave`` (the producer leaves), ``say TEXT`` (to all connected clients).
"""

from __future__ import annotations

import asyncio
import contextlib
import fractions
import itertools
import json
import sys
from typing import Any

import numpy
from aiortc import AudioStreamTrack, RTCPeerConnection, RTCSessionDescription, VideoStreamTrack
from av import VideoFrame
from websockets.asyncio.server import ServerConnection, serve

WIDTH, HEIGHT = 160, 120
CLOCK = 90_000


class Colour(VideoStreamTrack):
    def __init__(self, world: World) -> None:
        super().__init__()
        self._world = world

    async def recv(self) -> VideoFrame:
        stamp, _ = await self.next_timestamp()
        while self._world.mute:  # noqa: ASYNC110
            await asyncio.sleep(0.05)
        pixels = numpy.full((HEIGHT, WIDTH, 3), self._world.colour, numpy.uint8)
        frame = VideoFrame.from_ndarray(pixels, format="rgb24")
        frame.pts, frame.time_base = stamp, fractions.Fraction(1, CLOCK)
        return frame


class World:
    def __init__(self, name: str) -> None:
        self.name = name
        self.colour = (200, 30, 30)
        self.mute = False
        self.sockets: set[ServerConnection] = set()
        self.sessions: dict[str, tuple[ServerConnection, RTCPeerConnection]] = {}
        self._numbers = itertools.count(1)

    # -- the signalling server

    async def serve(self, ws: ServerConnection) -> None:
        self.sockets.add(ws)
        await tell(ws, {"type": "welcome", "peerId": f"peer-{next(self._numbers)}"})
        try:
            async for text in ws:
                await self._take(ws, json.loads(text))
        finally:
            self.sockets.discard(ws)
            for session in [name for name, (theirs, _) in self.sessions.items() if theirs is ws]:
                await self._close(session)

    async def _take(self, ws: ServerConnection, told: dict[str, Any]) -> None:
        match told["type"]:
            case "list":
                producers = [{"id": "it", "meta": {"name": self.name}}] if self.name else []
                await tell(ws, {"type": "list", "producers": [{"id": "other", "meta": None}, *producers]})
            case "startSession" if told["peerId"] == "it" and self.name:
                await self._begin(ws)
            case "peer" if told["sessionId"] in self.sessions:
                _, connection = self.sessions[told["sessionId"]]
                await connection.setRemoteDescription(RTCSessionDescription(**told["sdp"]))
            case "endSession":
                await self._close(told["sessionId"])
            case _:
                await tell(ws, {"type": "error", "details": f"no {told}"})

    # -- the producer

    async def _begin(self, ws: ServerConnection) -> None:
        session, connection = f"session-{next(self._numbers)}", RTCPeerConnection()
        self.sessions[session] = ws, connection
        connection.createDataChannel("control")
        connection.addTrack(AudioStreamTrack())
        connection.addTrack(Colour(self))
        await tell(ws, {"type": "sessionStarted", "peerId": "it", "sessionId": session})
        await connection.setLocalDescription(await connection.createOffer())
        # webrtcsink sends its addresses in addition to the offer, one at a time.
        lines, stream, early = [], -1, []
        for line in connection.localDescription.sdp.splitlines(keepends=True):
            stream += line.startswith("m=")
            if line.startswith("a=candidate:"):
                ice = {"candidate": line.removeprefix("a=").strip(), "sdpMLineIndex": stream}
                early.append({"type": "peer", "sessionId": session, "ice": ice})
            elif not line.startswith("a=end-of-candidates"):
                lines.append(line)
        await tell(ws, early[0])
        await tell(ws, {"type": "peer", "sessionId": session, "sdp": {"type": "offer", "sdp": "".join(lines)}})
        for message in early[1:]:
            await tell(ws, message)

    async def _close(self, session: str) -> None:
        _, connection = self.sessions.pop(session, (None, None))
        if connection is not None:
            await connection.close()

    async def order(self, line: str) -> None:
        word, _, rest = line.strip().partition(" ")
        match word:
            case "colour":
                red, green, blue = map(int, rest.split())
                self.colour, self.mute = (red, green, blue), False
            case "mute":
                self.mute = True
            case "end":
                for session, (ws, _) in list(self.sessions.items()):
                    await tell(ws, {"type": "endSession", "sessionId": session})
                    await self._close(session)
            case "leave":
                self.name = ""
            case "say":
                for ws in self.sockets:
                    await ws.send(rest)


async def tell(ws: ServerConnection, message: dict[str, Any]) -> None:
    with contextlib.suppress(Exception):  # the client has gone
        await ws.send(json.dumps(message))


async def main() -> None:
    world, loop = World(sys.argv[1]), asyncio.get_running_loop()
    async with serve(world.serve, "0.0.0.0", 0) as server:
        print(next(iter(server.sockets)).getsockname()[1], flush=True)
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            await world.order(line)


if __name__ == "__main__":
    asyncio.run(main())
