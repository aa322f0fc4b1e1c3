"""Publish the pictures of a robot's cameras as JPEG on the mesh, while there is a subscriber.

A camera process compresses its pictures on request, and writes the JPEG data into shared memory with the raw
pictures. This actor publishes that data unchanged. So a camera sends no message to this process, and each picture
is copied here only once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.frame_ring import FrameRing
from strands_actors.kernel.channels.pubsub import PubSub, Topic
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Message

from . import schemas as mesh_json

LOOK_S = 1 / 30
"""Shortest time between two pictures of one camera."""
WANT_S = 1.0
"""How long a camera continues to compress after the last request."""
JPEG = "image/jpeg"


class Tick(Message, frozen=True):
    lane = "latest"

    now_ns: int


class Pictures(Actor):
    """Publish the pictures of one robot.

    Args:
        robot: Name of the robot.
        pubsub: The session on the mesh.
        rings: Returns the shared ring buffer of pictures of each camera that has one already.
    """

    def __init__(self, robot: str, pubsub: PubSub, rings: Callable[[], Mapping[str, FrameRing]]) -> None:
        self._robot = robot
        self._pubsub = pubsub
        self._rings = rings
        self._topics: dict[str, Topic] = {}
        self._sent: dict[str, int] = {}

    async def started(self) -> None:
        self.context.every(LOOK_S, Tick)

    def receive(self, message: Tick) -> None:
        for name, ring in self._rings().items():
            if name not in self._topics:
                topic = mesh_json.camera_topic(name)
                self._topics[name] = self._pubsub.topic(
                    mesh_json.key(self._robot, topic), mesh_json.schema("camera"), JPEG
                )
                # A picture that was compressed before this topic existed is too old to publish.
                self._sent[name] = ring.newest_compressed
            if self._topics[name].has_subscribers:
                ring.request_compressed(message.now_ns + round(WANT_S * NS))
                self._send(name, ring, message.now_ns)

    def _send(self, name: str, ring: FrameRing, now_ns: int) -> None:
        if ring.newest_compressed == self._sent[name]:
            return
        shot = ring.read_compressed()
        if shot is not None and shot.number != self._sent[name] and now_ns - shot.captured_ns <= ring.stale_ns:
            self._sent[name] = shot.number
            self._topics[name].put(bytes(shot.data), time.time_ns() - (now_ns - shot.captured_ns))
