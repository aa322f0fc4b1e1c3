"""Publish the pictures of one robot's cameras.

A camera is read only while its topics have a subscriber, because its pictures are compressed only then.
"""

from __future__ import annotations

from collections.abc import Iterable

import msgspec

from strands_actors.kernel.channels.pubsub import Received, Stamp
from strands_actors.kernel.channels.ros2.definitions import CAMERA_INFO, COMPRESSED_IMAGE
from strands_actors.kernel.channels.ros2.graph import Node, Publisher
from strands_actors.kernel.channels.ros2.names import Qos, ros_name
from strands_actors.kernel.clock import NS
from strands_actors.supervisors.mesh.schemas import camera_topic, key
from strands_actors.surfaces.mesh.client import MeshClient

from . import readings

_stamp_of = msgspec.json.Decoder(Stamp).decode


class Cameras:
    """The camera topics of one robot.

    Args:
        node: The node of the robot.
        prefix: What stands before the names of its topics.
        mesh: The mesh.
        robot: The name of the robot.
    """

    def __init__(self, node: Node, prefix: str, mesh: MeshClient, robot: str) -> None:
        self._node = node
        self._prefix = prefix
        self._mesh = mesh
        self._robot = robot
        self._cameras: dict[str, _Camera] = {}

    def add(self, names: Iterable[str]) -> None:
        """Add the cameras that are not on the graph yet."""
        for name in names:
            if name not in self._cameras:
                self._cameras[name] = self._declare(name)

    def _declare(self, name: str) -> _Camera:
        prefix = f"{self._prefix}/{ros_name(name)}"
        return _Camera(
            key(self._robot, camera_topic(name)),
            f"{ros_name(self._robot)}/{ros_name(name)}_optical",
            self._node.publisher(f"{prefix}/image_raw/compressed", COMPRESSED_IMAGE, Qos.SENSOR),
            self._node.publisher(f"{prefix}/camera_info", CAMERA_INFO, Qos.SENSOR),
        )

    def look(self) -> None:
        """Begin to read the cameras that have a subscriber now, and end with the others. Call it regularly."""
        for camera in self._cameras.values():
            has_subscribers = camera.pictures.has_subscribers or camera.info.has_subscribers
            if has_subscribers and not camera.is_read:
                self._mesh.subscribe(camera.key, camera.on_picture)
            elif camera.is_read and not has_subscribers:
                self._mesh.unsubscribe(camera.key)
            camera.is_read = has_subscribers

    def close(self) -> None:
        """End with all cameras."""
        for camera in self._cameras.values():
            if camera.is_read:
                self._mesh.unsubscribe(camera.key)
        self._cameras.clear()


class _Camera:
    """One camera."""

    def __init__(self, key: str, frame: str, pictures: Publisher, info: Publisher) -> None:
        self.key = key
        self.pictures = pictures
        self.info = info
        self.is_read = False
        self._frame = frame

    def on_picture(self, received: Received) -> None:
        """Publish a picture, with the time at which it was taken. One without a time is dropped."""
        try:
            time_s = _stamp_of(received.attachment or b"").time_ns / NS
        except msgspec.MsgspecError:
            return
        if self.pictures.has_subscribers:
            self.pictures.publish(readings.image(received.payload, time_s, self._frame))
        size = readings.jpeg_size(received.payload) if self.info.has_subscribers else None
        if size is not None:
            self.info.publish(readings.camera_info(*size, time_s, self._frame))
