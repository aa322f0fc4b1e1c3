"""Walks of the robots behind HTTP, WebSockets and JSON-RPC."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from strands_actors.drivers.common.codecs.http_messages import Request
from strands_actors.drivers.common.codecs.json_rpc import Call
from strands_actors.drivers.earthrover import protocol as earthrover
from strands_actors.drivers.earthrover.twin import REQUESTS as EARTHROVER
from strands_actors.drivers.earthrover.twin import twin_of as rover_of
from strands_actors.drivers.microduck import protocol as duck
from strands_actors.drivers.microduck.twin import CALLS as DUCK
from strands_actors.drivers.microduck.twin import DuckTwin, _No
from strands_actors.drivers.reachy import protocol as reachy
from strands_actors.drivers.reachy.twin import MESSAGES, ReachyTwin
from strands_actors.drivers.reachy.twin import REQUESTS as REACHY
from strands_actors.drivers.yahboom import messages as ros
from strands_actors.drivers.yahboom import protocol as rosbridge
from strands_actors.drivers.yahboom.twin import BridgeSession, M3ProTwin
from strands_actors.drivers.yahboom.twin.bridge import OPERATIONS, SERVICES, TOPICS

from .walk import Answer, Walk


def still() -> float:
    return 100.0


# -- HTTP


def request(key: str, body: bytes) -> Request:
    method, _, target = key.partition(" ")
    return Request(method, target.replace("*", "yes1" if "dataset" in target else "disabled"), {}, body, b"")


def ask_http(twin: Any, key: str, body: bytes) -> Answer:
    answer = twin.answer(request(key, body))
    return Answer(answer.status == 200, answer.body if key.startswith("GET") else b"")


HTTP_OTHERS = (
    "/",
    "/docs",
    "/api/apps/start-app/x",
    "/api/media/record/start",
    "/api/daemon/restart",
    "/v2/screenshot",
)


def ask_message(twin: ReachyTwin, kind: str, fields: Mapping[str, Any]) -> Answer:
    answered, _ = twin._obey({"type": kind, **fields})
    return Answer(answered != "other" or kind in ("set_motor_mode", "set_torque", "set_head_tracking"))


def begin_move(twin: ReachyTwin) -> None:
    twin.answer(request(f"POST {reachy.GOTO}", GOTO))
    assert twin.body.move is not None
    twin.body.move.uuid = UUID


def track(twin: ReachyTwin) -> None:
    twin.tracking = True


UUID = "00000000-0000-0000-0000-000000000001"
GOTO = json.dumps({"head_pose": {"pitch": 0.1}, "duration": 1.0}).encode()
TARGET = json.dumps({"target_head_pose": {"pitch": 0.1}}).encode()
POSE = [1, 0, 0, 0, 0, 0.995, -0.0998, 0, 0, 0.0998, 0.995, 0, 0, 0, 0, 1]


# -- robotd


def ask_duck(twin: DuckTwin, method: str, params: Mapping[str, Any]) -> Answer:
    try:
        result = twin.answer(Call(method, params, 1, False))
    except _No:
        return Answer(False)
    accepted = result.get("accepted", True)
    return Answer(bool(accepted), {name: value for name, value in result.items() if name != "accepted"} or b"")


def slot(twin: DuckTwin) -> str:
    return str(next(iter(twin._table["slots"])))


def walk_duck(twin: DuckTwin) -> None:
    ask_duck(twin, duck.MOVE, {"vx": 0.1})


def off(twin: DuckTwin) -> None:
    ask_duck(twin, duck.RELAX, {})


def load(twin: DuckTwin) -> None:
    ask_duck(twin, duck.LOAD_POLICY, {"slot": slot(twin), "path": "mine.onnx"})


# -- rosbridge


def ask_bridge(twin: M3ProTwin, op: str, fields: Mapping[str, Any]) -> Answer:
    said: list[str] = []
    session = BridgeSession(twin.graph, said.append)
    session.take(json.dumps({"op": op, **fields}))
    failed = any('"error"' in text or '"result":false' in text for text in said)
    session.publish(200.0)
    return Answer(not failed, "".join(said))


def ask_topic(twin: M3ProTwin, topic: str, message: Mapping[str, Any]) -> Answer:
    return ask_bridge(twin, "publish", {"topic": topic, "msg": message})


def ask_service(twin: M3ProTwin, service: str, arguments: Mapping[str, Any]) -> Answer:
    return ask_bridge(twin, "call_service", {"service": service, "args": arguments})


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    paths = [key.partition(" ")[2] for key in (*REACHY.effects, *EARTHROVER.effects)]
    keys = [f"{method} {path}" for method in ("GET", "POST", "PUT", "DELETE") for path in (*paths, *HTTP_OTHERS)]
    bodies = (b"", b"{}", TARGET)
    yield Walk(
        "reachy",
        REACHY,
        keys,
        partial(ReachyTwin, "reachy_mini", still),
        ask_http,
        {
            **dict.fromkeys(REACHY.effects, b""),
            f"POST {reachy.SET_TARGET}": TARGET,
            f"POST {reachy.GOTO}": GOTO,
            f"POST {reachy.STOP}": json.dumps({"uuid": UUID}).encode(),
            f"POST {reachy.SET_VOLUME}": b'{"volume": 20}',
            f"POST {reachy.PLAY_SOUND}": b'{"file": "a.wav"}',
            f"POST {reachy.UPLOAD_SOUND}": b"data",
        },
        bodies,
        {f"POST {reachy.STOP}": begin_move, f"POST {reachy.TRACKING_OFF}": track},
    )
    kinds = (
        *MESSAGES.effects,
        "set_wobbling",
        "set_automatic_body_yaw",
        "start_recording",
        "apply_audio_config",
        "",
    )
    pose = {"head": POSE, "antennas": [0.1, 0.1], "body_yaw": 0.1}
    yield Walk(
        "reachy messages",
        MESSAGES,
        kinds,
        partial(ReachyTwin, "reachy_mini", still),
        ask_message,
        {
            **dict.fromkeys(MESSAGES.effects, pose),
            "task": {"uuid": UUID, "req": {**pose, "duration": 1.0}},
            "stop_move": {},
            "set_motor_mode": {"mode": "disabled"},
            "set_torque": {"on": False},
            "set_head_tracking": {"enabled": True},
            "goto_target": {**pose, "duration": 1.0},
        },
        ({}, pose, {"enabled": True}),
        {"stop_move": begin_move},
    )
    yield Walk(
        "earthrover",
        EARTHROVER,
        keys,
        partial(rover_of, "earthrover", still),
        ask_http,
        {
            **dict.fromkeys(EARTHROVER.effects, b""),
            f"POST {earthrover.CONTROL}": b'{"command": {"linear": 0.5, "angular": 0, "lamp": 0}}',
            f"POST {earthrover.SPEAK}": b'{"text": "hello"}',
        },
        bodies,
    )
    twin = DuckTwin("microduck", still)
    yield Walk(
        "microduck",
        DUCK,
        [*DUCK.effects, "robot.dance", "robot.setGains", "camera.snap", "rpc.discover", ""],
        partial(DuckTwin, "microduck", still),
        ask_duck,
        {
            **{method: {} for method in DUCK.effects},
            duck.HELLO: {"api_version": duck.API_VERSION},
            duck.MOVE: {"vx": 0.1},
            duck.HEAD: {"head_yaw": 0.1},
            duck.POSE: {"z": 0.01},
            duck.MOUTH: {"open": 0.5},
            duck.LOOK: {"x": 1.0, "y": 0.2, "z": 0.1},
            duck.ENABLE: {"on": True},
            duck.DO: {"skill": next(iter(twin._table["skills"]))},
            duck.SOUND: {"tag": duck.SOUNDS[0]},
            duck.THEREMIN: {"active": True},
            duck.SET_MODE: {"mode": next(mode for mode in twin._table["modes"] if mode != "walk")},
            duck.LOAD_POLICY: {"slot": slot(twin), "path": "mine.onnx"},
        },
        ({},),
        {duck.STOP: walk_duck, duck.INIT: off, duck.DO: drive, duck.RELOAD_POLICIES: load},
    )
    bridge = partial(M3ProTwin, "yahboom_m3pro", still)
    arm = {**{f"joint{number}": 100 for number in range(1, 7)}, "time": 500}
    yield Walk(
        "rosbridge",
        OPERATIONS,
        [*OPERATIONS.effects, "unadvertise", "set_level", "service_response", "fragment", "send_action_goal", ""],
        bridge,
        ask_bridge,
        {
            "advertise": {"topic": ros.CMD_VEL, "type": "geometry_msgs/Twist"},
            "publish": {"topic": ros.CMD_VEL, "msg": TWIST},
            "subscribe": {"topic": ros.ODOMETRY},
            "unsubscribe": {"topic": ros.ODOMETRY},
            "call_service": {"service": rosbridge.TOPICS_SERVICE},
        },
        (),
        # They change nothing but the session: tests/drivers/yahboom/test_twin.py.
        without=frozenset(("advertise", "unsubscribe")),
    )
    yield Walk(
        "topics",
        TOPICS,
        (ros.CMD_VEL, ros.ARM, "/beep", "/rgblight", "/arm_joint", "/servo_s1", "/initialpose", "/cmd_vel_nav"),
        bridge,
        ask_topic,
        {ros.CMD_VEL: TWIST, ros.ARM: arm},
        ({}, {"data": 1}),
    )
    yield Walk(
        "services",
        SERVICES,
        (*SERVICES.effects, "/rosapi/nodes", "/rosapi/set_param", "/slam_toolbox/save_map", "/CurrentAngle"),
        bridge,
        ask_service,
        {name: {"topic": ros.CMD_VEL} for name in SERVICES.effects},
        ({},),
    )


def drive(twin: DuckTwin) -> None:
    """Let a policy drive the duck."""
    ask_duck(twin, duck.ENABLE, {"on": True})
    twin.body._up_at_s = still()


TWIST = {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": 0.0}}
