"""Show a robot in Foxglove, over the WebSocket server of the package foxglove-sdk.

Foxglove (the desktop program, or its web page) connects to this server. The server has no capability by which a
client could send something: clients can only read. A slow client loses messages, and delays nobody.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import foxglove
import msgspec
from foxglove import messages as fox
from foxglove.channels import CompressedImageChannel, FrameTransformsChannel, LogChannel, SceneUpdateChannel
from foxglove.websocket import ChannelView, Client, ServerListener

from strands_actors.kernel.clock import NS

from .events import Event, Level
from .model import Frame, Mesh, RobotModel
from .sinks import Reading

LAYOUT = Path(__file__).with_name("layout.json")
"""A layout for Foxglove: the model, plots of the joints, the state, the events and the log."""

JOINTS, FRAMES, SCENE, LOG, EVENTS = "/joints", "/tf", "/model", "/log", "/events"
"""The topics. The layout has these names, so they do not have the robot's name."""

_NUMBER = {"type": ["number", "null"]}
_TEXT = {"type": "string"}
_JOINT = {"name": _TEXT, "measured": _NUMBER, "commanded": _NUMBER, "velocity": _NUMBER}
_JOINTS = {
    "robot": _TEXT,
    "state": _TEXT,
    "epoch": {"type": "integer"},
    "unit": _TEXT,
    "age_s": {"type": "number"},
    "joints": {"type": "array", "items": {"type": "object", "properties": _JOINT}},
}
_EVENT = {
    "kind": _TEXT,
    "level": {"type": "integer"},
    "code": _TEXT,
    "text": _TEXT,
    "count": {"type": "integer"},
}

_LEVELS: Mapping[Level, fox.LogLevel] = {
    Level.INFO: fox.LogLevel.Info,
    Level.WARNING: fox.LogLevel.Warning,
    Level.ERROR: fox.LogLevel.Error,
}


class FoxgloveSink:
    """A WebSocket server for Foxglove.

    Args:
        robot: Name of the robot.
        host: Address to listen at. Every program that can reach it can read the robot's telemetry.
        port: The port; 0 for a free one.
        soon: Calls a function in the thread of the view, from another thread.

    Raises:
        OSError: The server cannot listen at this address.
    """

    def __init__(self, robot: str, host: str, port: int, soon: Callable[[Callable[[], None]], None]) -> None:
        self._robot = robot
        self._context = foxglove.Context()
        self._joints = self._json(JOINTS, _JOINTS)
        self._events = self._json(EVENTS, _EVENT)
        self._frames = FrameTransformsChannel(FRAMES, context=self._context)
        self._scene = SceneUpdateChannel(SCENE, context=self._context)
        self._log = LogChannel(LOG, context=self._context)
        self._cameras: dict[str, CompressedImageChannel] = {}
        self._topics: dict[str, foxglove.Channel] = {}
        self._update: fox.SceneUpdate | None = None
        listener = _Subscribed(self._scene.id(), lambda: soon(self._show_scene))
        try:
            self._server = foxglove.start_server(
                name=f"strands-actors {robot}",
                host=host,
                port=port,
                capabilities=[],
                server_listener=listener,
                context=self._context,
            )
        except Exception as error:  # foxglove-sdk has no narrower exception for an address that is in use.
            raise OSError(f"no server can listen at {host}:{port}: {error}") from error
        self.url = f"ws://{host}:{self._server.port}"

    def reading(self, reading: Reading) -> None:
        self._joints.log(
            {
                "robot": reading.robot,
                "state": reading.state,
                "epoch": reading.epoch,
                "unit": reading.unit,
                "age_s": reading.age_s,
                "joints": [msgspec.structs.asdict(joint) for joint in reading.joints],
            },
            log_time=_ns(reading.t),
        )

    def model(self, model: RobotModel) -> None:
        by_body: dict[str, list[Mesh]] = {}
        for mesh in model.meshes():
            by_body.setdefault(mesh.body, []).append(mesh)
        entities = [
            fox.SceneEntity(
                frame_id=body, id=body, frame_locked=True, triangles=[_triangles(mesh) for mesh in meshes]
            )
            for body, meshes in by_body.items()
        ]
        self._update = fox.SceneUpdate(entities=entities)
        self._show_scene()

    def frames(self, t: float, frames: Sequence[Frame]) -> None:
        stamp = _stamp(t)
        self._frames.log(
            fox.FrameTransforms(transforms=[_transform(stamp, frame) for frame in frames]), log_time=_ns(t)
        )

    def event(self, event: Event) -> None:
        values = {"kind": event.kind, "level": event.level, "code": event.code, "text": event.text}
        self._events.log({**values, "count": event.count}, log_time=_ns(event.t))
        log = fox.Log(
            timestamp=_stamp(event.t),
            level=_LEVELS[event.level],
            message=event.text,
            name=f"{self._robot}/{event.kind}",
        )
        self._log.log(log, log_time=_ns(event.t))

    def picture(self, t: float, camera: str, jpeg: bytes) -> None:
        channel = self._cameras.get(camera)
        if channel is None:
            channel = self._cameras[camera] = CompressedImageChannel(f"/camera/{camera}", context=self._context)
        image = fox.CompressedImage(timestamp=_stamp(t), frame_id=camera, data=jpeg, format="jpeg")
        channel.log(image, log_time=_ns(t))

    def topic(self, t: float, topic: str, values: dict[str, Any]) -> None:
        channel = self._topics.get(topic)
        if channel is None:
            channel = self._topics[topic] = self._json(f"/{topic}", {})
        channel.log(values, log_time=_ns(t))

    def close(self) -> None:
        self._server.stop()

    def _show_scene(self) -> None:
        """Send the meshes. They do not change, so they are sent again only when another client subscribes."""
        if self._update is not None:
            self._scene.log(self._update)

    def _json(self, topic: str, properties: Mapping[str, Any]) -> foxglove.Channel:
        schema = {"type": "object", "title": topic.strip("/"), "properties": dict(properties)}
        return foxglove.Channel(topic, schema=schema, context=self._context)


class _Subscribed(ServerListener):
    """Calls a function when a client subscribes to a channel. It is called in a thread of the server."""

    def __init__(self, channel: int, on_subscribed: Callable[[], None]) -> None:
        self._channel = channel
        self._on_subscribed = on_subscribed

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        if channel.id == self._channel:
            self._on_subscribed()


def _triangles(mesh: Mesh) -> fox.TriangleListPrimitive:
    red, green, blue, alpha = mesh.rgba
    return fox.TriangleListPrimitive(
        pose=fox.Pose(position=fox.Vector3(), orientation=fox.Quaternion(w=1.0)),
        points=[fox.Point3(x=x, y=y, z=z) for x, y, z in mesh.points.tolist()],
        color=fox.Color(r=red, g=green, b=blue, a=alpha),
        indices=mesh.faces.ravel().tolist(),
    )


def _transform(stamp: fox.Timestamp, frame: Frame) -> fox.FrameTransform:
    x, y, z = frame.xyz
    w, i, j, k = frame.quat
    return fox.FrameTransform(
        timestamp=stamp,
        parent_frame_id=frame.parent,
        child_frame_id=frame.name,
        translation=fox.Vector3(x=x, y=y, z=z),
        rotation=fox.Quaternion(x=i, y=j, z=k, w=w),
    )


def _stamp(t: float) -> fox.Timestamp:
    sec, nsec = divmod(_ns(t), NS)
    return fox.Timestamp(sec, nsec)


def _ns(t: float) -> int:
    return round(t * NS)
