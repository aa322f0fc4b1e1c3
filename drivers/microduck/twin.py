"""Simulate robotd: its JSON-RPC on a unix socket, with a walking duck behind it.

It behaves as robotd of API 31. It answers each connection in order, refuses unknown fields by name, limits no
value, and zeroes a twist that is not repeated. With ``api_version=16`` it has the methods of that version. It
makes no sound and has no camera.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

import trio

from strands_actors.contract.axis import finite
from strands_actors.contract.options import option
from strands_actors.drivers.common.codecs.json_rpc import (
    INVALID_PARAMS,
    INVALID_REQUEST,
    METHOD_NOT_FOUND,
    PARSE_ERROR,
    Call,
    LineDecoder,
    decode,
    encode_failure,
    encode_notification,
    encode_result,
)
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.twin import (
    ClientGone,
    Connection,
    Fault,
    Handler,
    Reply,
    TwinOptions,
    TwinRobot,
    UnixServer,
    WireLog,
    main_of,
)

from . import protocol as p
from .body import DEADMAN_S, Duck
from .robots import TABLES
from .twin_methods import CALLS, METHODS, SINCE, Param


class DuckTwinOptions(TwinOptions, frozen=True):
    path: Annotated[str | None, option("path of the socket; None: a socket in a new directory")] = None
    deadman_s: Annotated[
        float, option("seconds after which a twist that nobody says again is zeroed; 0: never", ge=0)
    ] = DEADMAN_S
    api_version: Annotated[int, option("version of the protocol that it speaks")] = p.API_VERSION
    mode: Annotated[str, option("drive mode at first: walk or roller")] = "walk"
    enabled: Annotated[bool, option("whether a policy drives it at first")] = False


MAX_LINE = 64 * 1024
LOOP_HZ = 50
VERSION = "0.9.0"
BATTERY = {"volts": 7.6, "percent": 63.0}

_ACCEPTED: dict[str, Any] = {"accepted": True}

MODELLED = (CALLS,)


class DuckTwin(TwinRobot):
    """One simulated robotd (the duck's daemon), which all clients share."""

    def __init__(
        self,
        robot: str,
        now_s: Callable[[], float] = time.monotonic,
        *,
        deadman_s: float = DEADMAN_S,
        api_version: int = p.API_VERSION,
        mode: str = "walk",
        enabled: bool = False,
    ) -> None:
        """Build the simulated robotd. ``mode`` is its first drive mode. Raise ``ValueError`` if the robot lacks
        it."""
        super().__init__()
        table = TABLES.table(robot)
        if mode not in table["modes"]:
            raise ValueError(f"mode is {mode!r}. Use {', '.join(table['modes'])}")
        self.body = Duck(table, deadman_s, now_s)
        self.api_version = api_version
        self._table = table
        self._began = mode, enabled
        self._overridden: dict[str, str] = {}
        self._frozen: dict[str, Any] | None = None
        self._missed = 0
        self.power_cycle()

    def begin_fault(self, fault: Fault) -> None:
        self.body.pass_time()
        self._frozen = self.state() if fault is Fault.STUCK else None
        self.body.stuck = fault is Fault.STUCK

    def power_cycle(self) -> None:
        body = self.body
        body.reset()
        body.mode, body.enabled = self._began
        self._theremin = False
        self.sound = ""

    def order(self, words: Sequence[str]) -> bool:
        """Carry out a control line: ``fallen on|off`` or ``picked-up on|off``."""
        match words:
            case ["fallen", "on" | "off" as how]:
                self.body.pass_time()
                self.body.fallen = how == "on"
            case ["picked-up", "on" | "off" as how]:
                self.body.pass_time()
                self.body.picked_up = how == "on"
            case _:
                return False
        return True

    # -- calls

    def answer(self, call: Call) -> Any:
        """Carry out a call and return its result. Raise ``_No`` for an error."""
        declared = METHODS.get(call.method)
        if declared is None or call.method not in CALLS or self.api_version < SINCE.get(call.method, 0):
            raise _No(METHOD_NOT_FOUND, f"unknown method {call.method!r}")
        _check(call.params, declared)
        self.body.pass_time()
        return self._do(call.method, call.params)

    def _do(self, method: str, params: Mapping[str, Any]) -> Any:
        body = self.body

        def number(name: str) -> float:
            return float(params.get(name) or 0.0)

        match method:
            case p.HELLO:
                return {"api_version": self.api_version, "daemon_version": VERSION, "revision": None}
            case p.MOVE:
                body.walk((number("vx"), number("vy"), number("vyaw")), Commander.WIRE)
            case p.STOP:
                body.walk((0.0, 0.0, 0.0), Commander.WIRE)
            case p.HEAD:
                body.head_target = tuple(map(number, ("neck_pitch", "head_pitch", "head_yaw", "head_roll")))
            case p.POSE:
                active = params.get("active", True)
                body.pose_target = (number("z"), number("roll"), number("pitch"), float(active))
            case p.MOUTH:
                body.mouth = max(0.0, min(1.0, number("open")))
            case p.LOOK:
                return self._look(number("x"), number("y"), number("z"), number("neck_pitch"))
            case p.ENABLE:
                on = not body.enabled if params.get("toggle") else bool(params.get("on"))
                body.enable(on)
                return {"accepted": True, "reason": "driving" if on else "holding"}
            case p.INIT:
                body.power(True)
            case p.RELAX | p.REBOOT_MOTORS:
                body.power(False)
            case p.DO:
                return self._skill(params["skill"])
            case p.SOUND if params["tag"] not in (*p.SOUNDS, "wheee"):
                raise _No(INVALID_PARAMS, f"unknown tag {params['tag']!r}")
            case p.SOUND:
                self.sound = params["tag"]
            case p.RELOAD_POLICIES:
                self._overridden.clear()
            case p.THEREMIN:
                self._theremin = params["active"]
            case p.SET_MODE:
                return self._set_mode(params.get("mode", ""))
            case p.LOAD_POLICY:
                return self._load(params.get("slot"), params.get("path"))
            case _:
                return self._answer_query(method)
        return dict(_ACCEPTED)

    def _answer_query(self, method: str) -> Any:
        body, table = self.body, self._table
        match method:
            case p.GET_MODE:
                return {"mode": body.mode}
            case p.HEALTH:
                return {
                    "healthy": True,
                    "battery": BATTERY,
                    "motors": {"hottest": "left_knee", "max_c": 41.0, "mean_c": 35.0},
                    "control_loop": {
                        "target_hz": LOOP_HZ,
                        "achieved_hz": float(LOOP_HZ),
                        "ticks": round(body.time_s * LOOP_HZ),
                        "missed": 0,
                        "last_tick_age_ms": 5,
                    },
                    "bus": {"consecutive_errors": 0, "startup_failures": 0},
                    "imu": {"ready": True, "stale_blocks": 0, "consecutive_stale_blocks": 0},
                }
            case p.POLICIES:
                policies = {
                    "mode": body.mode,
                    "enabled": True,
                    "slots": self._slots(),
                    "skills": list(table["skills"]),
                }
                return (
                    policies
                    if self.api_version < p.HOMED_SINCE
                    else {**policies, "homed": True, "sitting": body.sitting}
                )
            case p.MODEL:
                head = ["neck_pitch", "head_pitch", "head_yaw", "head_roll"]
                return {
                    "asset": "twin",
                    "trunk_height_m": table["trunk_m"],
                    "joint_names": list(table["joints"]),
                    "head_joints": head,
                }
            case p.SUBSCRIBE:
                names = {"accepted": True, "walk": "alpha_walking.onnx", "stand": "alpha_standing.onnx"}
                if self.api_version < p.POLICIES_SINCE:
                    return {**names, **{skill: f"{skill}.onnx" for skill in table["skills"]}}
                return {**names, "skills": list(table["skills"])}
            case "robot.modelApi":
                return {"model_api": 1}
            case "robot.remoteSessionActive":
                return {"active": False}
        raise _No(METHOD_NOT_FOUND, f"unknown method {method!r}")

    def _skill(self, skill: str) -> dict[str, Any]:
        skills = self._table["skills"]
        if skill not in skills:
            return {"accepted": False, "reason": f"no skill named {skill!r}; known: {', '.join(skills)}"}
        reason = self.body.do(skill)
        return {"accepted": False, "reason": reason} if reason else dict(_ACCEPTED)

    def _look(self, x: float, y: float, z: float, neck_pitch: float) -> dict[str, Any]:
        """Turn the head towards a point, calculated for a head at rest. The simulation has no neck kinematics."""
        yaw, pitch = math.atan2(y, x), math.atan2(-z, math.hypot(x, y))
        axes = self._table["axes"]
        clamped = [
            max(axes[key][1], min(axes[key][2], value)) for key, value in (("head_pitch", pitch), ("head_yaw", yaw))
        ]
        self.body.head_target = (neck_pitch, *clamped, 0.0)
        head = dict(zip(("neck_pitch", "head_pitch", "head_yaw", "head_roll"), self.body.head_target, strict=True))
        return {"head": head, "clamped": clamped != [pitch, yaw]}

    def _set_mode(self, mode: str) -> dict[str, Any]:
        modes = ", ".join(self._table["modes"])
        if mode not in self._table["modes"]:
            return {"accepted": False, "reason": f"no mode {mode!r}; known: {modes}"}
        self.body.mode = mode
        return dict(_ACCEPTED)

    def _load(self, slot: object, path: object) -> dict[str, Any]:
        slots = self._table["slots"]
        if slot not in slots:
            return {"accepted": False, "reason": f"no slot {slot!r}; known: {', '.join(slots)}"}
        if path:
            self._overridden[str(slot)] = str(path)
        else:
            self._overridden.pop(str(slot), None)
        return dict(_ACCEPTED)

    def _slots(self) -> list[dict[str, Any]]:
        return [
            {
                "slot": slot,
                "path": self._overridden.get(slot, f"{slot}.onnx"),
                "origin": "local" if slot in self._overridden else "official",
                "overridden": slot in self._overridden,
            }
            for slot in self._table["slots"]
        ]

    # -- states

    def state(self) -> dict[str, Any]:
        """Return the present state, as the notification ``robot.state`` contains it."""
        if self._frozen is not None:
            return self._frozen
        body = self.body
        joints = body.joints_rad
        wrong = 0.5 if self.faults.of(None) is Fault.WRONG else 0.0
        vx, vy, vyaw = body.applied
        half = body.yaw_rad / 2
        moves: dict[str, Any] = {"requested": list(body.requested), "applied": [vx + wrong, vy, vyaw]}
        if limited_by := body.limited_by:
            moves["limited_by"] = limited_by
        return {
            "t": body.time_s,
            "t_ns": time.monotonic_ns(),
            "move": moves,
            "head": list(body.head_rad),
            "policy": body.policy,
            "safety": {
                "fallen": body.fallen,
                "limp": body.fallen,
                "gravity": [-1.0, 0.0, 0.0] if body.fallen else [0.0, 0.0, -1.0],
                "gain": 50 if body.fallen else 200,
                "picked_up": body.picked_up,
            },
            "loop": {"hz": float(LOOP_HZ), "missed": 0},
            "joints": joints,
            "targets": [*joints[:5], *body.head_target, *joints[9:]],
            "odom": {"position": [body.x_m, body.y_m, body.height_m], "yaw": body.yaw_rad},
            "imu": {"gyro": [0.0, 0.0, body.moves[2]], "quat": [math.cos(half), 0.0, 0.0, math.sin(half)]},
            **({"theremin": {"mouth": 0.0, "zones": 0}} if self._theremin else {}),
        }


class _No(Exception):
    """An error that the simulated robotd sends as a JSON-RPC error."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


def _check(params: Mapping[str, Any], declared: Mapping[str, Param]) -> None:
    for name, value in params.items():
        if name not in declared:
            raise _No(INVALID_PARAMS, f"unknown field `{name}`, expected {', '.join(declared) or 'none'}")
        value_type = declared[name].value_type
        fits = (
            value is None or isinstance(value, value_type) if value_type is not float else finite(value) is not None
        )
        if not fits or (value_type is int and isinstance(value, bool)):
            raise _No(INVALID_PARAMS, f"invalid type of `{name}`, expected {value_type.__name__}")
    for name, param in declared.items():
        if param.needed and params.get(name) is None:
            raise _No(INVALID_PARAMS, f"missing field `{name}`")


def kind_of(call: Call) -> tuple[str, str | None]:
    """Return the kind of a call for the log of messages, and the safe state to which the call brings the robot."""
    match call.method:
        case p.MOVE:
            return ("safe", "zero") if p.is_rest(call.params) else ("setpoint", None)
        case p.STOP:
            return "safe", "stop"
        case p.RELAX:
            return "safe", "limp"
        case p.THEREMIN if call.params.get("active") is False:
            return "other", None
        case p.HEAD | p.POSE | p.MOUTH | p.DO | p.LOOK | p.THEREMIN:
            return "setpoint", None
        case p.ENABLE | p.INIT | p.SET_MODE | p.SOUND | p.REBOOT_MOTORS:
            return "other", None
    return "read", None


class _Client:
    """One client's connection. Its requests are answered in order."""

    def __init__(self, twin: DuckTwin, connection: Connection) -> None:
        self._twin = twin
        self._connection = connection

    async def serve(self) -> None:
        lines = LineDecoder(MAX_LINE)
        async with trio.open_nursery() as nursery:
            while True:
                t_ns, data = await self._connection.receive()
                await self._connection.frost.thawed()
                try:
                    for line in lines.feed(data):
                        self._hear(t_ns, line, nursery)
                except MalformedFrame:
                    # Disconnect a client that sends an invalid message, as a server does.
                    raise ClientGone from None

    def _hear(self, t_ns: int, line: bytes, nursery: trio.Nursery) -> None:
        twin, connection = self._twin, self._connection
        try:
            call = decode(line)
        except MalformedFrame as malformed:
            connection.log_received(t_ns, "other", line)
            if twin.faults.of(None) is not Fault.OFF:
                self._reply(nursery, encode_failure(None, PARSE_ERROR, str(malformed)))
            return
        if not isinstance(call, Call):
            connection.log_received(t_ns, "other", line)
            self._reply(nursery, encode_failure(call.id, INVALID_REQUEST, "no call"))
            return
        kind, safe_state = kind_of(call)
        connection.log.write(t_ns, "host", [(kind, line)], safe_state)
        if twin.faults.of(None) is Fault.OFF:
            return
        try:
            reply = encode_result(call.id, twin.answer(call))
        except _No as no:
            reply = encode_failure(call.id, no.code, str(no))
        else:
            if call.method == p.SUBSCRIBE:
                hz = min(LOOP_HZ, call.params.get("hz") or LOOP_HZ)
                nursery.start_soon(self._stream, max(1, hz))
        if not call.is_notification:
            self._reply(nursery, reply)

    def _reply(self, nursery: trio.Nursery, line: bytes) -> None:
        reply = self._twin.faults.apply(Reply(0.0, line))
        if reply is None:
            return
        if reply.delay_s or reply.late_s:
            nursery.start_soon(self._say_later, reply)
        else:
            self._connection.send_logged(reply.kind, reply.data)

    async def _say_later(self, reply: Reply) -> None:
        await trio.sleep(reply.delay_s + reply.late_s)
        self._connection.send_logged(reply.kind, reply.data)

    async def _stream(self, hz: float) -> None:
        """Send states until the client disconnects. They are not logged."""
        twin, connection = self._twin, self._connection
        while True:
            await connection.frost.thawed()
            twin.body.pass_time()
            reply = twin.faults.apply(Reply(0.0, encode_notification(p.STATE, twin.state())))
            if reply is not None and twin.faults.of(None) is not Fault.OFF:
                if reply.delay_s or reply.late_s:
                    await trio.sleep(reply.delay_s + reply.late_s)
                connection.send(reply.data)
            await trio.sleep(1 / hz)


def serving(twin: DuckTwin) -> Handler:
    """Return the function that serves each connection to the simulated robotd."""

    async def handle(connection: Connection) -> None:
        await _Client(twin, connection).serve()

    return handle


def build(robot: str, options: DuckTwinOptions, log: WireLog) -> UnixServer:
    """Return the server of a robot of ``robots.toml``. Raise ``ValueError`` as ``DuckTwin`` does."""
    twin = DuckTwin(
        robot,
        deadman_s=options.deadman_s,
        api_version=options.api_version,
        mode=options.mode,
        enabled=options.enabled,
    )
    return UnixServer(twin, serving(twin), log, options.path)


main = main_of(DuckTwinOptions, build)

__all__ = ["CALLS", "MODELLED", "DuckTwin", "DuckTwinOptions", "build", "kind_of", "main", "serving"]
