"""Simulate the daemon: its REST and WebSocket service with a robot behind it.

It behaves like daemon 1.13.0: it accepts any number, reports success with the motors off, ignores targets and
further moves while a move runs, and does not answer messages on ``/ws/sdk``. Its list of moves lacks the moves
that began over ``/ws/sdk``. The simulation plays no sound and sees no face.
"""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import msgspec
import trio

from strands_actors.contract.axis import finite
from strands_actors.contract.options import option
from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin import (
    Fault,
    NetworkOptions,
    Reply,
    TcpServer,
    TwinRobot,
    WireLog,
    main_of,
)
from strands_actors.drivers.common.twin.http import Answer, HttpSession
from strands_actors.drivers.common.twin.websocket import WebSocketClient, WebSocketHandler, serving_both

from . import protocol as p
from .body import Move, ReachyBody, Row
from .requests import MESSAGES, MODELLED, REQUESTS, request_key
from .robots import TABLES, axes_of


class ReachyTwinOptions(NetworkOptions, frozen=True):
    wireless: Annotated[bool, option("whether it is a Wireless, which has an IMU")] = True
    motors: Annotated[str, option(f"mode of the motors at first: {', '.join(p.MODES)}")] = "enabled"
    media: Annotated[bool, option("whether it has a camera and microphones")] = True
    battery: Annotated[
        float | None, option("charge in percent that the daemon reports; None: no charge, like daemon 1.13.0")
    ] = None


STATE_S = 0.02
"""Period of the state frames."""

STATUS_S = 1.0
"""Period of the daemon's status frames."""

VERSION = "1.13.0"

_BAD = 422
_ERROR = 500
_SLEEP: Row = (20.0, 0.0, 0.0, 0.0, 0.0, -20.0, 0.0, -60.0, 60.0)
_MOVES = ("amazed1", "cheerful1", "yes1")
_POSE = {"pitch": p.PITCH, "roll": p.ROLL, "yaw": p.YAW}
_PLACE = {"x": p.X, "y": p.Y, "z": p.Z}
_JSON = msgspec.json.Decoder()


class ReachyTwin(TwinRobot):
    """The simulated daemon, which all clients share."""

    def __init__(
        self,
        robot: str,
        now_s: Callable[[], float] = time.monotonic,
        *,
        wireless: bool = True,
        motors: str = "enabled",
        media: bool = True,
        battery: float | None = None,
    ) -> None:
        """Make a simulated daemon.

        Args:
            robot: Name of the robot.
            now_s: The clock.
            wireless: True for a Wireless, False for a Lite.
            motors: Mode of the motors at first.
            media: True if it has a camera and microphones.
            battery: Charge in percent that the daemon reports. With None it does not report a charge, like every
                daemon up to 1.13.0.

        Raises:
            ValueError: ``motors`` is not a mode, ``battery`` is no percentage, or a Lite has a battery.
        """
        super().__init__()
        if battery is not None and not 0 <= battery <= 100:
            raise ValueError(f"battery is {battery}. Use 0 to 100 percent")
        if battery is not None and not wireless:
            raise ValueError("a Lite has no battery. Use wireless=true")
        if motors not in p.MODES:
            raise ValueError(f"motors is {motors!r}. Use {', '.join(p.MODES)}")
        self.body = ReachyBody(axes_of(robot), TABLES.table(robot), now_s)
        self.tracking = False
        self._motors = motors
        self._wireless = wireless
        self._media = media
        self._battery = battery
        self._volume = 50
        self.sound = b""
        """The last request to play or to store a sound."""
        self._listeners: set[WebSocketClient] = set()  # clients that receive the events of moves
        self._clients: set[WebSocketClient] = set()  # clients connected to ``/ws/sdk``
        self._stuck: Row | None = None
        self.body.mode = motors

    def begin_fault(self, fault: Fault) -> None:
        self.body.pass_time()
        self._stuck = self.body.position if fault is Fault.STUCK else None
        self.body.stuck = fault is Fault.STUCK

    def power_cycle(self) -> None:
        self.body.reset()
        self.body.mode = self._motors
        self.tracking = False

    # -- REST

    def answer(self, request: Request) -> Answer:
        self.body.pass_time()
        target = request.target.partition("?")[0]
        if request_key(request.method, target) not in REQUESTS:
            return _NOT_FOUND
        try:
            answer = self._read(target) if request.method == "GET" else self._write(target, request.body)
        except MalformedFrame as malformed:
            return _json_answer({"detail": str(malformed)}, "other", _BAD)
        self._report()
        return answer

    def _read(self, target: str) -> Answer:
        body = self.body
        match target:
            case p.STATUS:
                return _json_answer(self._status())
            case p.MOTORS:
                return _json_answer({"mode": body.mode})
            case p.RUNNING:
                return _json_answer(
                    [{"uuid": body.move.uuid}] if body.move is not None and body.move.listed else []
                )
            case p.VOLUME:
                return _json_answer({"volume": self._volume, "platform": "Twin", "device": "none"})
            case p.TRACKED_FACE:
                return _json_answer({"status": "ok", "face_target": {"detected": False, "x": None, "y": None}})
            case p.DIRECTION_OF_SOUND:
                return _json_answer({"angle": math.pi / 3, "speech_detected": True} if self._media else None)
            case p.CAMERA:
                return _json_answer(
                    {"name": "twin", "default_resolution": {"width": 1280, "height": 720, "fps": 30}}
                )
            case "/api/state/full":
                return _json_answer(self._full())
        return _json_answer(list(_MOVES))

    def _write(self, target: str, data: bytes) -> Answer:
        body = self.body
        match target:
            case p.SET_TARGET:
                fields = _object(data)
                accepted = body.aim_at(
                    self._target(fields, "target_head_pose", "target_antennas", "target_body_yaw")
                )
                return _json_answer(
                    {"status": "ok"} if accepted else {"status": "ignored", "reason": "move_running"}, "setpoint"
                )
            case p.GOTO:
                fields = _object(data)
                duration_s = _finite(fields, "duration")
                row = self._target(fields, "head_pose", "antennas", "body_yaw")
                return self._play([(row, max(0.01, duration_s))])
            case p.WAKE_UP:
                neutral = (0.0,) * len(body.position)
                nod = (0.0, 20.0, *neutral[2:])
                return self._play([(neutral, 1.0), (nod, 0.2), (neutral, 0.2)])
            case p.GOTO_SLEEP:
                return self._play([(_SLEEP, 2.0)])
            case p.STOP:
                return self._stop(_object(data).get("uuid"))
            case p.TRACKING_ON:
                self.tracking = self._media
                return _json_answer(
                    {"status": "ok" if self._media else "unavailable", "enabled": self._media}, "setpoint"
                )
            case p.TRACKING_OFF:
                self.tracking = False
                return _json_answer({"status": "ok", "enabled": False}, "other")
            case p.SET_VOLUME:
                self._volume = round(_finite(_object(data), "volume"))
                return _json_answer({"volume": self._volume, "platform": "Twin", "device": "none"}, "other")
            case p.PLAY_SOUND | p.UPLOAD_SOUND:
                self.sound = data
                return _json_answer({"status": "ok"}, "other")
        if target.startswith(p.SET_MODE):
            return self._set_mode(target.removeprefix(p.SET_MODE))
        return self._play_recorded(target.rpartition("/")[2])

    def _set_mode(self, mode: str) -> Answer:
        if mode not in p.MODES:
            return _json_answer({"detail": f"no mode {mode}"}, "other", _BAD)
        self.body.set_mode(mode)
        safe = mode == "disabled"
        message = msgspec.json.encode({"status": f"motors changed to {mode} mode"})
        return Answer(p.OK, message, "safe" if safe else "other", "limp" if safe else None)

    def _play(self, stages: Sequence[tuple[Row, float]]) -> Answer:
        move = Move(str(uuid.uuid4()), stages)
        self.body.play(move)
        return _json_answer({"uuid": move.uuid}, "setpoint")

    def _play_recorded(self, name: str) -> Answer:
        if name not in _MOVES:
            return _json_answer({"detail": f"no move {name}"}, "other", p.NOT_FOUND)
        neutral = (0.0,) * len(self.body.position)
        nod = (15.0, *neutral[1:])
        return self._play([(nod, 0.4), (neutral, 0.4)])

    def _stop(self, requested: object) -> Answer:
        move = self.body.move
        if move is None or move.uuid != requested:
            # The real daemon answers with this error if no move with this id runs.
            return Answer(_ERROR, b"Internal Server Error", "other")
        self._cancel()
        return _json_answer({"message": f"Stopped move with UUID: {requested}"}, "other")

    def _cancel(self) -> None:
        ended = self.body.end_move()
        if ended:
            self._notify("move_cancelled", ended)

    def _target(self, fields: Mapping[str, Any], pose: str, antennas: str, body_yaw: str) -> Row:
        """Return the target of all axes. An axis that the message does not name keeps its target."""
        row = list(self.body.target)
        if (value := fields.get(pose)) is not None:
            if not isinstance(value, dict):
                raise MalformedFrame(f"{pose} is no pose")
            for name, index in _POSE.items():
                row[index] = math.degrees(_finite(value, name, 0.0))
            for name, index in _PLACE.items():
                row[index] = 1e3 * _finite(value, name, 0.0)
        if (value := fields.get(antennas)) is not None:
            if not isinstance(value, list) or len(value) != 2:
                raise MalformedFrame(f"{antennas} are not two numbers")
            row[p.RIGHT], row[p.LEFT] = (math.degrees(_finite({antennas: angle}, antennas)) for angle in value)
        if fields.get(body_yaw) is not None:
            row[p.BODY] = math.degrees(_finite(fields, body_yaw))
        return tuple(row)

    def _status(self) -> dict[str, Any]:
        # The name of the battery's field is [assumed], as in ``protocol``.
        battery = {} if self._battery is None else {"battery_pct": self._battery}
        return {
            "type": "daemon_status",
            "robot_name": "reachy_mini",
            "state": "running",
            "wireless_version": self._wireless,
            "desktop_app_daemon": False,
            "simulation_enabled": True,
            "mockup_sim_enabled": False,
            "no_media": not self._media,
            "backend_status": {"motor_control_mode": self.body.mode, "error": None},
            "error": None,
            "version": VERSION,
            **battery,
        }

    # -- WebSockets

    def choose(self, path: str) -> WebSocketHandler | None:
        return {
            p.SDK: self._serve_sdk,
            p.UPDATES: self._serve_updates,
            "/api/state/ws/full": self._serve_full,
            "/api/move/ws/set_target": self._serve_targets,
        }.get(path)

    async def _serve_sdk(self, client: WebSocketClient) -> None:
        self._clients.add(client)
        try:
            await self._receive_sdk(client)
        finally:
            self._clients.discard(client)

    async def _receive_sdk(self, client: WebSocketClient) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._stream, client, self._sdk_frames)
            nursery.start_soon(self._stream, client, lambda: [self._status()], STATUS_S)
            while True:
                t_ns, message = await client.receive()
                if self.faults.of(None) is Fault.OFF:
                    client.log_received(t_ns, "other", message)
                    continue
                self.body.pass_time()
                try:
                    kind, safe_state = self._obey(_object(message))
                except MalformedFrame:
                    kind, safe_state = "other", None
                client.log_received(t_ns, kind, message, safe_state)
                self._report()

    def _obey(self, fields: Mapping[str, Any]) -> tuple[str, str | None]:
        """Carry out a message from ``/ws/sdk``. Return its kind and the safe state that it causes, for the
        log of messages."""
        body = self.body
        message = fields.get("type")
        if not isinstance(message, str) or message not in MESSAGES:
            return "other", None
        match message:
            case "task" if isinstance(fields.get("req"), dict):
                goto = fields["req"]
                row = self._target({**goto, "head": _pose_of(goto.get("head"))}, "head", "antennas", "body_yaw")
                body.play(
                    Move(str(fields.get("uuid")), [(row, max(0.01, _finite(goto, "duration")))], listed=False)
                )
                return "setpoint", None
            case "stop_move":
                self._cancel()
                return "safe", "hold"
            case "set_motor_mode" | "set_torque":
                mode = fields.get("mode") or ("enabled" if fields.get("on") else "disabled")
                if mode in p.MODES:
                    body.set_mode(str(mode))
                return ("safe", "limp") if mode == "disabled" else ("other", None)
            case "set_head_tracking":
                self.tracking = fields.get("enabled") is True and self._media
                return "setpoint" if self.tracking else "other", None
            case "set_full_target" | "set_target" | "set_antennas" | "set_body_yaw" | "goto_target":
                row = self._target({**fields, "head": _pose_of(fields.get("head"))}, "head", "antennas", "body_yaw")
                if fields["type"] == "goto_target":
                    body.play(
                        Move(str(uuid.uuid4()), [(row, max(0.01, _finite(fields, "duration")))], listed=False)
                    )
                else:
                    body.aim_at(row)
                return "setpoint", None
        return "other", None

    async def _serve_updates(self, client: WebSocketClient) -> None:
        self._listeners.add(client)
        try:
            while True:
                await client.receive()
        finally:
            self._listeners.discard(client)

    async def _serve_full(self, client: WebSocketClient) -> None:
        await self._stream(client, lambda: [self._full()])

    async def _serve_targets(self, client: WebSocketClient) -> None:
        while True:
            t_ns, message = await client.receive()
            client.log_received(t_ns, "setpoint", message)
            try:
                self._write(p.SET_TARGET, message.encode() if isinstance(message, str) else message)
            except MalformedFrame as malformed:
                client.send(_text({"status": "error", "detail": str(malformed)}))

    async def _stream(
        self, client: WebSocketClient, frames: Callable[[], list[dict[str, Any]]], period_s: float = STATE_S
    ) -> None:
        """Send states until the client disconnects. They are not logged."""
        while True:
            await client.connection.frost.thawed()
            self.body.pass_time()
            self._report()
            if self.faults.of(None) is not Fault.OFF:
                for frame in frames():
                    await self._send_state(client, frame)
            await trio.sleep(period_s)

    async def _send_state(self, client: WebSocketClient, frame: dict[str, Any]) -> None:
        reply = self.faults.apply(Reply(0.0, msgspec.json.encode(frame)))
        if reply is None:
            return
        if reply.delay_s or reply.late_s:
            await trio.sleep(reply.delay_s + reply.late_s)
        damaged = self.faults.of(None) is Fault.GARBAGE
        client.send(reply.data if damaged else reply.data.decode())

    def _report(self) -> None:
        ended, self.body.ended = self.body.ended, []
        for move in ended:
            self._notify("move_completed", move)

    def _notify(self, event_type: str, move: str) -> None:
        for client in list(self._listeners):
            client.send(_text({"type": event_type, "uuid": move, "details": ""}))
        # A fixed time stamp is enough, because no client reads it.
        stamp = "2026-01-01T00:00:00"
        progress = {"type": "task_progress", "uuid": move, "finished": True, "error": None, "timestamp": stamp}
        for client in list(self._clients):
            client.send(_text(progress))

    def _reported_row(self) -> Row:
        row = self._stuck or self.body.position
        wrong = 5.0 if self.faults.of(None) is Fault.WRONG else 0.0
        return tuple(value + wrong for value in row)

    def _sdk_frames(self) -> list[dict[str, Any]]:
        row = self._reported_row()
        frames: list[dict[str, Any]] = [
            {
                "type": "joint_positions",
                "head_joint_positions": [math.radians(row[p.BODY]), *(0.0,) * 6],
                "antennas_joint_positions": [math.radians(row[p.RIGHT]), math.radians(row[p.LEFT])],
            },
            {"type": "head_pose", "head_pose": _matrix(row)},
        ]
        if self._wireless:
            frames.append(
                {
                    "type": "imu_data",
                    "accelerometer": [0.0, 0.0, 9.81],
                    "gyroscope": [0.0, 0.0, 0.0],
                    "quaternion": [1.0, 0.0, 0.0, 0.0],
                    "temperature": 30.0,
                }
            )
        return frames

    def _full(self) -> dict[str, Any]:
        row = self._reported_row()
        pose = {name: math.radians(row[index]) for name, index in _POSE.items()}
        return {
            "control_mode": self.body.mode,
            "head_pose": {**pose, **{name: row[index] / 1e3 for name, index in _PLACE.items()}},
            "body_yaw": math.radians(row[p.BODY]),
            "antennas_position": [math.radians(row[p.RIGHT]), math.radians(row[p.LEFT])],
        }


def _matrix(row: Row) -> list[list[float]]:
    roll, pitch, yaw = (math.radians(row[index]) for index in (p.ROLL, p.PITCH, p.YAW))
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(angle), math.sin(angle)) for angle in (roll, pitch, yaw))
    return [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, row[p.X] / 1e3],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, row[p.Y] / 1e3],
        [-sp, cp * sr, cp * cr, row[p.Z] / 1e3],
        [0.0, 0.0, 0.0, 1.0],
    ]


def _pose_of(matrix: object) -> dict[str, float] | None:
    """Return the pose from the 16 numbers of a matrix, which are given row by row."""
    if matrix is None:
        return None
    if not isinstance(matrix, list) or len(matrix) != 16:
        raise MalformedFrame("head has not 16 numbers")
    rows = [matrix[start : start + 4] for start in range(0, 16, 4)]
    head = p.decode_sdk(msgspec.json.encode({"type": "head_pose", "head_pose": rows}))
    if not isinstance(head, p.Head):
        raise MalformedFrame("head is no pose")
    return dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (*head.xyz_m, *head.rpy_rad), strict=True))


def _json_answer(value: object, kind: str = "read", status: int = p.OK) -> Answer:
    return Answer(status, msgspec.json.encode(value), kind)


_NOT_FOUND = _json_answer({"detail": "Not Found"}, "other", p.NOT_FOUND)


def _text(value: object) -> str:
    return msgspec.json.encode(value).decode()


def _object(data: str | bytes) -> dict[str, Any]:
    try:
        fields = _JSON.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        raise MalformedFrame("no JSON") from None
    if not isinstance(fields, dict):
        raise MalformedFrame("no JSON object")
    return fields


def _finite(fields: Mapping[str, Any], name: str, default: float | None = None) -> float:
    number = finite(fields.get(name, default))
    if number is None:
        raise MalformedFrame(f"{name} is no finite number")
    return number


def serve_twin(twin: ReachyTwin, log: WireLog, host: str | None = None, port: int = 0) -> TcpServer:
    """Return the server of a simulated daemon. Raise ``OSError`` if its port cannot be opened."""
    return TcpServer(twin, {port: serving_both(lambda: HttpSession(twin), twin.choose)}, log, host)


def build(robot: str, options: ReachyTwinOptions, log: WireLog) -> TcpServer:
    """Return the server of a robot of ``robots.toml``. Raise ``ValueError`` as ``ReachyTwin`` does."""
    twin = ReachyTwin(
        robot,
        wireless=options.wireless,
        motors=options.motors,
        media=options.media,
        battery=options.battery,
    )
    return serve_twin(twin, log, options.host, options.port)


main = main_of(ReachyTwinOptions, build)

__all__ = ["MESSAGES", "MODELLED", "REQUESTS", "ReachyTwin", "ReachyTwinOptions", "build", "main", "serve_twin"]
