"""Walks of robots with legs, wheels or propellers."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from functools import partial

from strands_actors.drivers.booster import rpc as booster
from strands_actors.drivers.booster.protocol import Fall, Odometer
from strands_actors.drivers.booster.robots import model_of as booster_model
from strands_actors.drivers.booster.rpc import Api
from strands_actors.drivers.booster.twin.onboard import Onboard as BoosterOnboard
from strands_actors.drivers.booster.twin.requests import REQUESTS as BOOSTER
from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as stretch
from strands_actors.drivers.stretch.twin.boards import BoardDecoder
from strands_actors.drivers.stretch.twin.calls import PIMU_CALLS, STEPPER_CALLS, STEPPER_MODES, WACC_CALLS
from strands_actors.drivers.stretch.twin.server import decoders_of
from strands_actors.drivers.stretch.twin.stepper import StepperMotor
from strands_actors.drivers.stretch.twin.world import World as StretchWorld
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.twin import arm_actions, obstacles
from strands_actors.drivers.unitree.twin.onboard import Onboard
from strands_actors.drivers.unitree.twin.requests import ARM, OBSTACLES, SWITCHER, requests_of
from strands_actors.drivers.unitree.walking.sport import LIE, LOCK, SIT
from tests.drivers.crazyflie import walks as crazyflie

from .walk import Answer, Walk


def still() -> float:
    return 100.0


def ignore(kind: str, text: str) -> None:
    """Do nothing with an event."""


# -- Unitree


def onboard(robot: str) -> Onboard:
    return Onboard(model_of(robot), ignore)


def ask_unitree(service: str, twin: Onboard, api: int, parameter: str) -> Answer:
    response = twin.serve(service, rpc.Request(1, api, parameter))
    return Answer(response is not None and response.code == rpc.OK, "" if response is None else response.data)


def ask_gesture(twin: Onboard, api: int, parameter: str) -> Answer:
    """Send a request to the service ``arm``, which answers at the end of a gesture."""
    response = twin.serve(arm_actions.SERVICE, rpc.Request(1, api, parameter))
    now_s = 100.0
    while response is None and now_s < 110.0:
        now_s += 0.02
        twin.advance(now_s)
        response = next(iter(twin.take_responses()), None)
    return Answer(response is not None and response.code == rpc.OK, "" if response is None else response.data)


def take_remote(twin: Onboard) -> None:
    ask_unitree(obstacles.SERVICE, twin, obstacles.USE_REMOTE, '{"is_remote_commands_from_api": true}')


def become(mode: int) -> Callable[[Onboard], None]:
    def act(twin: Onboard) -> None:
        assert twin.gait is not None
        twin.gait.become(mode)

    return act


def unitree(robot: str, parameters: dict[int, str], prepare: dict[int, Callable[[Onboard], None]]) -> Walk:
    model = model_of(robot)
    others = ("", '{"data": 1}', '{"data": 1.0, "name": "ai", "enable": true}', '{"x": 0.1, "y": 0, "z": 0}')
    table = requests_of(model)
    requests = {**dict.fromkeys(table.effects, ""), **parameters}
    ask = partial(ask_unitree, model.service)
    return Walk(robot, table, range(10_000), lambda: onboard(robot), ask, requests, others, prepare)


def start_odometry(twin: Onboard) -> None:
    ask_unitree("loco", twin, rpc.LOCO_ENABLE_ODOM, "")


VELOCITY = json.dumps({"velocity": [0.2, 0.0, 0.0], "duration": 1.0})
MOVE = json.dumps({"x": 0.2, "y": 0.0, "z": 0.0})


def walk_go2(twin: Onboard) -> None:
    ask_unitree("sport", twin, rpc.MOVE, MOVE)


SPORT_PARAMETERS = {rpc.MOVE: MOVE}
SPORT_PREPARE = {
    rpc.BALANCE_STAND: become(LOCK),
    rpc.STOP_MOVE: walk_go2,
    rpc.STAND_UP: become(LIE),
    rpc.RECOVERY_STAND: become(LIE),
}


# -- Booster


def ask_booster(twin: BoosterOnboard, api: int, body: str) -> Answer:
    response = twin.serve(booster.Request("1", api, body))
    return Answer(response.status == booster.OK, response.body)


def lie(twin: BoosterOnboard) -> None:
    twin.fall = Fall.HAS_FALLEN


def move_odometer(twin: BoosterOnboard) -> None:
    twin.odometer = Odometer(1.0, 2.0, 0.5)


# -- Stretch


def board(kind: str) -> BoardDecoder:
    decoders = decoders_of(StretchWorld("stretch3", still))
    (decoder,) = (each for name, (each, _) in decoders.items() if kind in name)
    assert isinstance(decoder, BoardDecoder)
    return decoder


def ask_board(decoder: BoardDecoder, call: int, data: bytes) -> Answer:
    content = b""
    for frame in f.pushes(bytes((call,)) + data):
        for received in decoder.frames(frame, None):
            for reply in received.act().replies:
                content = b"".join(part.data for part in f.Decoder().feed(reply.data))
    return Answer(content[:1] == bytes((call + 1 & 0xFF,)), content[1:])


def lift() -> StepperMotor:
    return board("lift").world.steppers["lift"]


def ask_mode(motor: StepperMotor, mode: int, position: float) -> Answer:
    before = motor.command
    motor.take(stretch.Command(mode, position, 1.0, 1.0, step=1))
    return Answer(motor.command != before)


def hold(motor: StepperMotor) -> None:
    motor.take(stretch.Command(stretch.Mode.HOLD))


def wait_for_sync(decoder: BoardDecoder) -> None:
    motor = decoder.world.steppers["lift"]
    motor.gains = motor.gains._replace(config=motor.gains.config | stretch.Config.SYNC)
    motor.take(stretch.Command(stretch.Mode.HOLD))


CALLS = range(255)
"""The reply to a call has the next number in a byte, so there is no call 255."""


def gains_of_flash() -> bytes:
    flash = board("lift").world.steppers["lift"].flash
    return flash._replace(voltage_lpf=flash.voltage_lpf + 1.0).pack(5)


def walks() -> Iterator[Walk]:
    """Yield the walks of this module."""
    go2 = model_of("unitree_go2").sport_mode
    yield Walk(
        "motion_switcher",
        SWITCHER,
        range(10_000),
        lambda: onboard("unitree_go2"),
        partial(ask_unitree, rpc.MOTION_SWITCHER),
        {
            rpc.SERVER_VERSION: "",
            rpc.CHECK_MODE: "",
            rpc.SELECT_MODE: json.dumps({"name": go2}),
            rpc.RELEASE_MODE: "",
        },
        ("", json.dumps({"name": go2}), '{"silent": true}'),
        {rpc.SELECT_MODE: lambda twin: twin.set_mode("")},
    )
    yield unitree("unitree_go2", SPORT_PARAMETERS, {**SPORT_PREPARE, rpc.RISE_SIT: become(SIT)})
    yield unitree("b2", SPORT_PARAMETERS, dict(SPORT_PREPARE))
    yield unitree(
        "unitree_g1",
        {rpc.SET_FSM_ID: '{"data": 1}', rpc.SET_BALANCE_MODE: '{"data": 1}', rpc.SET_VELOCITY: VELOCITY},
        {},
    )
    yield unitree(
        "unitree_h1",
        {
            rpc.LOCO_SET_FSM_ID: '{"data": 1}',
            rpc.LOCO_SET_BALANCE_MODE: '{"data": 1}',
            rpc.LOCO_SET_VELOCITY: VELOCITY,
        },
        {rpc.LOCO_GET_ODOM: start_odometry},
    )
    yield unitree("unitree_h1_2", {}, {})
    yield Walk(
        "gestures",
        ARM,
        range(10_000),
        lambda: onboard("unitree_g1"),
        ask_gesture,
        {**dict.fromkeys(ARM.effects, ""), arm_actions.EXECUTE: '{"data": 27}'},
        ("", '{"data": 27}', '{"action_name": "mine"}'),
    )
    yield Walk(
        "obstacle avoidance",
        OBSTACLES,
        range(10_000),
        lambda: onboard("unitree_go2"),
        partial(ask_unitree, obstacles.SERVICE),
        {
            **dict.fromkeys(OBSTACLES.effects, ""),
            obstacles.SWITCH_SET: '{"enable": true}',
            obstacles.MOVE: '{"x": 0.2, "y": 0.0, "yaw": 0.0, "mode": 0}',
            obstacles.USE_REMOTE: '{"is_remote_commands_from_api": true}',
        },
        ("", '{"enable": true}', '{"x": 0.2, "y": 0.0, "yaw": 0.0, "mode": 0}'),
        {obstacles.MOVE: take_remote},
    )
    yield Walk(
        "booster",
        BOOSTER,
        range(4000),
        lambda: BoosterOnboard(booster_model("booster_t1"), ignore),
        ask_booster,
        {
            **dict.fromkeys(BOOSTER.effects, ""),
            Api.CHANGE_MODE: '{"mode": 0}',
            Api.MOVE: '{"vx": 0.2, "vy": 0, "vyaw": 0}',
            Api.ROTATE_HEAD: '{"pitch": 0.2, "yaw": 0.1}',
            Api.UPPER_BODY: '{"start": true}',
            Api.GET_FRAME_TRANSFORM: '{"src": 0, "dst": 1}',
            Api.RESET_ODOMETRY: '{"x": 1.5, "y": 2.0, "theta": 0.5}',
        },
        ("", '{"mode": 1, "start": true, "pitch": 0.1, "yaw": 0.1}'),
        {Api.GET_UP: lie, Api.RESET_ODOMETRY: move_odometer},
    )
    yield from crazyflie.walks()
    pimu_config = struct.pack("<9f5B22f", *[0.0] * 9, *[0] * 5, *[0.0] * 22)
    one = struct.pack("<I", stretch.RUNSTOP_ON)
    status = (b"", b"\0", bytes(4), bytes(8), bytes(29))
    yield Walk(
        "stepper",
        STEPPER_CALLS,
        CALLS,
        partial(board, "lift"),
        ask_board,
        {
            **dict.fromkeys(STEPPER_CALLS.effects, b""),
            stretch.COMMAND: stretch.Command(stretch.Mode.HOLD).call()[1:],
            stretch.GAINS: gains_of_flash(),
            stretch.TRIGGER: struct.pack("<If", stretch.RESET_HOMED, 0.0),
            stretch.MOTION_LIMITS: stretch.motion_limits(0.0, 1.0)[1:],
        },
        status,
    )
    yield Walk(
        "stepper modes",
        STEPPER_MODES,
        range(256),
        lift,
        ask_mode,
        dict.fromkeys(STEPPER_MODES.effects, 3.0),
        (0.0, 1.0),
        {stretch.Mode.SAFETY: hold},
    )
    yield Walk(
        "pimu",
        PIMU_CALLS,
        CALLS,
        partial(board, "pimu"),
        ask_board,
        {
            **dict.fromkeys(PIMU_CALLS.effects, b""),
            stretch.PIMU_CONFIG: pimu_config,
            stretch.PIMU_TRIGGER: one,
        },
        status,
        {stretch.MOTOR_SYNC: wait_for_sync},
    )
    yield Walk(
        "wacc",
        WACC_CALLS,
        CALLS,
        partial(board, "wacc"),
        ask_board,
        {
            **dict.fromkeys(WACC_CALLS.effects, b""),
            stretch.WACC_CONFIG: struct.pack("<Bff2Bf", 4, 1.0, 1.0, 0, 0, 2.0),
            stretch.WACC_COMMAND: b"\1\0" + bytes(4),
        },
        status,
    )
