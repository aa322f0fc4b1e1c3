"""Serve rosbridge as the robot does: one session for each client, with the topics that the client
has subscribed to."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import trio

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import Fault, Faults, Reply
from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.common.twin.websocket import WebSocketClient
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom import protocol as p
from strands_actors.drivers.yahboom.robots import M3Pro, Servo

from .mechanism import Mechanism

WRONG_M_S = 0.5
"""Error of the reported speed of a robot with wrong readings."""

SCAN_M = 2.0
"""Distance of all obstacles from this robot."""

SCAN_HZ = 7.0

OPERATIONS: Modelled[str] = Modelled(
    "operations of rosbridge",
    {
        "advertise": "checks the type of the topic",
        "publish": "commands the robot on the topics of the next table",
        "subscribe": "sends the messages of a topic",
        "unsubscribe": "ends that",
        "call_service": "calls a service",
    },
    "a status message with an error, or silence for the other operations of rosbridge",
)
TOPICS: Modelled[str] = Modelled(
    "topics that the robot subscribes to",
    {m.CMD_VEL: "drives the base", m.ARM: "moves the arm and the gripper"},
    "a status message with an error, if no node has the topic; else nothing, as without a subscriber",
)
SERVICES: Modelled[str] = Modelled(
    "services",
    {
        p.TOPICS_SERVICE: "returns the topics and their types",
        p.TYPE_SERVICE: "returns the type of a topic",
        p.TIME_SERVICE: "returns the time",
    },
    "a response with result false: the service does not exist",
)

_json = msgspec.json.Encoder()


class Graph:
    """The state that all clients share: topics with their types, services, and the robot."""

    def __init__(
        self, table: M3Pro, mechanism: Mechanism, faults: Faults, servos: tuple[Servo, ...], *, joints: bool
    ) -> None:
        self.mechanism = mechanism
        self.faults = faults
        self.table = table
        self._servos = servos
        self._stuck: m.Odometry | None = None
        optional = {
            topic: type_name for topic, type_name in m.OPTIONAL.items() if joints or topic != m.JOINT_STATES
        }
        self.types: Mapping[str, str] = {**m.COMMANDED, **m.REPORTED, **optional}
        hz = table.odometry_hz
        self.hz: Mapping[str, float] = {m.ODOMETRY: hz, m.IMU: hz, m.JOINT_STATES: hz} | dict.fromkeys(
            m.SCANS, SCAN_HZ
        )

    def freeze_readings(self, on: bool) -> None:
        """Repeat the present odometry in all later reports; with ``on=False`` end that."""
        self._stuck = self.mechanism.odometry() if on else None

    def message(self, topic: str) -> dict[str, Any]:
        """Return the present content of a topic's message."""
        self.mechanism.pass_time()
        odometry = self._stuck or self.mechanism.odometry()
        if self.faults.of(None) is Fault.WRONG:
            odometry = odometry._replace(speed=odometry.speed._replace(x=odometry.speed.x + WRONG_M_S))
        sec, nanosec = divmod(odometry.stamp_ns, 10**9)
        head = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": "odom"}
        match topic:
            case m.ODOMETRY:
                return _odometry(head, odometry)
            case m.IMU:
                return {
                    "header": head,
                    "orientation": m.quaternion_of(odometry.yaw_rad),
                    "angular_velocity": {"x": 0.0, "y": 0.0, "z": odometry.speed.yaw},
                    "linear_acceleration": {"x": 0.0, "y": 0.0, "z": 9.81},
                }
            case m.JOINT_STATES:
                # As on a real robot, the positions increase with the servos' degrees. The driver's option
                # ``joint_signs`` has no effect here.
                degrees = zip(self._servos, self.mechanism.degrees, strict=True)
                return {
                    "header": head,
                    "name": [servo.key for servo in self._servos],
                    "position": [servo.radians(value) for servo, value in degrees],
                    "velocity": [],
                    "effort": [],
                }
        return {
            "header": head,
            "angle_min": -math.pi,
            "angle_max": math.pi,
            "angle_increment": math.pi / 18,
            "range_min": 0.1,
            "range_max": 12.0,
            # ``None`` becomes null in JSON, which cannot express infinity.
            "ranges": [None, *[SCAN_M] * 35],
            "intensities": [],
        }

    def call(self, request: p.CallService) -> str:
        """Return the answer to a service call."""
        arguments = request.args if isinstance(request.args, dict) else {}
        # The npm package roslib omits the leading slash. ROS accepts that.
        service = "/" + request.service.removeprefix("/")
        if service not in SERVICES:
            return p.response(request, f"Service {request.service} does not exist", result=False)
        match service:
            case p.TOPICS_SERVICE:
                types = [type_name.replace("/", "/msg/") for type_name in self.types.values()]
                return p.response(request, {"topics": list(self.types), "types": types})
            case p.TYPE_SERVICE:
                return p.response(
                    request, {"type": self.types.get(str(arguments.get("topic")), "").replace("/", "/msg/")}
                )
        sec, nanosec = divmod(time.time_ns(), 10**9)
        return p.response(request, {"time": {"sec": sec, "nanosec": nanosec}})


def _odometry(head: Mapping[str, Any], odometry: m.Odometry) -> dict[str, Any]:
    pose = {
        "position": {"x": odometry.x_m, "y": odometry.y_m, "z": 0.0},
        "orientation": m.quaternion_of(odometry.yaw_rad),
    }
    speeds = {
        "linear": {"x": odometry.speed.x, "y": odometry.speed.y, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": odometry.speed.yaw},
    }
    return {
        "header": head,
        "child_frame_id": "base_footprint",
        "pose": {"pose": pose, "covariance": [0.0] * 36},
        "twist": {"twist": speeds, "covariance": [0.0] * 36},
    }


class BridgeSession:
    """The connection of one client. Its messages are processed in order."""

    def __init__(self, graph: Graph, send: Callable[[str], None]) -> None:
        """Start a session. ``send`` is called with each message for the client."""
        self._graph = graph
        self._send_text = send
        # The period in which each subscribed topic is sent to this client, by topic.
        self._period_s: dict[str, float] = {}
        self._due_s: dict[str, float] = {}

    def take(self, text: str | bytes) -> tuple[str, str | None]:
        """Process a client's message. Return its kind and the safe state that it causes, for the
        log of messages."""
        try:
            return self._do(p.decode_client_operation(text))
        except MalformedFrame as malformed:
            self._object(str(malformed), None)
            return "other", None

    def publish(self, now_s: float) -> None:
        """Send the messages of the subscribed topics that are due."""
        for topic, period_s in self._period_s.items():
            if now_s >= self._due_s[topic]:
                self._due_s[topic] = max(self._due_s[topic] + period_s, now_s - period_s)
                self._send_text(p.publish(topic, self._graph.message(topic)))

    def _do(self, operation: p.ClientOperation) -> tuple[str, str | None]:
        match operation:
            case p.Publish(topic, message):
                return self._command(topic, p.decode_message(message), operation.id)
            case p.CallService():
                self._send_text(self._graph.call(operation))
                return "read", None
            case p.Subscribe(topic):
                if self._agrees(topic, operation.type, operation.id) and topic in self._graph.hz:
                    self._period_s[topic] = max(1 / self._graph.hz[topic], operation.throttle_rate / 1e3)
                    self._due_s.setdefault(topic, 0.0)
                return "read", None
            case p.Unsubscribe(topic):
                self._period_s.pop(topic, None)
                self._due_s.pop(topic, None)
                return "read", None
            case p.Advertise(topic, type_name):
                self._agrees(topic, type_name, operation.id)
        return "other", None

    def _command(self, topic: str, message: dict[str, Any], number: str | None) -> tuple[str, str | None]:
        mechanism = self._graph.mechanism
        try:
            if topic == m.CMD_VEL:
                twist, is_stop = m.read_twist(message)
                mechanism.drive(twist, Commander.WIRE if any(twist) else Commander.NONE)
                return ("safe", "zero") if is_stop else ("setpoint", None)
            if topic == m.ARM:
                mechanism.move_arm(m.read_arm(message), Commander.WIRE)
                return "setpoint", None
        except MalformedFrame as malformed:
            self._object(f"publish: {malformed}", number)
            return "other", None
        if topic not in self._graph.types:
            self._object(f"publish: Cannot infer topic type for topic {topic} as it is not yet advertised", number)
        return "other", None

    def _agrees(self, topic: str, type_name: str | None, number: str | None) -> bool:
        """Return True if the topic has this type, or no type yet."""
        registered = self._graph.types.get(topic)
        if registered is None or type_name is None or m.plain_type(type_name) == registered:
            return True
        text = (
            f"Tried to register topic {topic} with type {type_name} "
            f"but it is already established with type {registered}"
        )
        self._object(text, number)
        return False

    def _object(self, text: str, number: str | None) -> None:
        self._send_text(p.encode(p.Status(p.ERROR_LEVEL, text, number)))


_TICK_S = 0.005


class _Outbox:
    """Sends messages to a client. A fault of the simulated robot can delay, damage or drop them."""

    def __init__(self, client: WebSocketClient, faults: Faults) -> None:
        self._client = client
        self._faults = faults
        self._late: list[tuple[float, bytes]] = []

    def send(self, text: str) -> None:
        if self._faults.of(None) is Fault.OFF:
            return
        reply = self._faults.apply(Reply(0.0, text.encode()))
        if reply is None:
            return
        if reply.delay_s or reply.late_s or self._late:
            self._late.append((trio.current_time() + reply.delay_s + reply.late_s, reply.data))
        else:
            self._send(reply.data)

    def flush(self) -> None:
        """Send the messages that a fault has delayed and that are due now."""
        while self._late and self._late[0][0] <= trio.current_time():
            self._send(self._late.pop(0)[1])

    def _send(self, data: bytes) -> None:
        try:
            self._client.send(data.decode())
        # A fault has damaged the text, so it is no UTF-8.
        except UnicodeDecodeError:
            self._client.send(data)


def serving(graph: Graph) -> Callable[[WebSocketClient], Any]:
    """Return the function that serves one client."""

    async def serve(client: WebSocketClient) -> None:
        outbox = _Outbox(client, graph.faults)
        session = BridgeSession(graph, outbox.send)
        async with trio.open_nursery() as nursery:
            nursery.start_soon(_publish, client, session, outbox)
            while True:
                t_ns, message = await client.receive()
                if graph.faults.of(None) is Fault.OFF:
                    client.log_received(t_ns, "other", message)
                    continue
                kind, safe_state = session.take(message)
                client.log_received(t_ns, kind, message, safe_state)

    return serve


async def _publish(client: WebSocketClient, session: BridgeSession, outbox: _Outbox) -> None:
    while True:
        await client.connection.frost.thawed()
        session.publish(trio.current_time())
        outbox.flush()
        await trio.sleep(_TICK_S)
