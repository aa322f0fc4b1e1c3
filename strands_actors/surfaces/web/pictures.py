"""The pictures of a camera, as browsers show them in an image (MJPEG)."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import trio

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import camera_topic, key
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig

BOUNDARY = "picture"
MEDIA_TYPE = f"multipart/x-mixed-replace; boundary={BOUNDARY}"


async def pictures(config: MeshConfig, robot: str, camera: str) -> AsyncIterator[bytes]:
    """Yield the pictures of a camera. A browser that reads slowly misses pictures, and delays nothing.

    The connection to the mesh is this stream's own: a camera compresses pictures only while it has a subscriber.
    """
    send, receive = trio.open_memory_channel[bytes](1)

    def take(received: Received) -> None:
        with contextlib.suppress(trio.WouldBlock):
            receive.receive_nowait()
        send.send_nowait(received.payload)

    async with open_mesh(config) as client:
        client.subscribe(key(robot, camera_topic(camera)), take)
        async for jpeg in receive:
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            yield head.encode() + jpeg + b"\r\n"
