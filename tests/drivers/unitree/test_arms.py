"""Test the topic ``rt/arm_sdk`` and the service ``arm`` of the twin, on a clock that the test controls."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import pytest

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.protocol import COMMAND_BYTES
from strands_actors.drivers.unitree.rpc import Request, Response
from strands_actors.drivers.unitree.twin import arm_actions as a
from strands_actors.drivers.unitree.twin.arm_sdk import SLOTS
from strands_actors.drivers.unitree.twin.standing import StandingBody

from .test_twin import Twin

HUMANOIDS = {"unitree_g1": "left_elbow", "unitree_h1": "left_elbow", "unitree_h1_2": "left_elbow_joint"}
"""The robots with this topic, and a joint of an arm."""
OFFSET = {"hg": (4, 28), "go": (24, 36)}
TURN_RAD = -0.6


def frame(twin: Twin, weight: float, targets: Mapping[str, float]) -> bytes:
    """Encode a message as the vendor's examples do: without checksum, ``mode_machine`` and motor modes."""
    body = bytearray(COMMAND_BYTES[twin.model.family])
    first, stride = OFFSET[twin.model.family]
    struct.pack_into("<f", body, first + stride * SLOTS[twin.model.name].weight, weight)
    for joint in twin.model.joints:
        if joint.key in targets:
            struct.pack_into("<5f", body, first + stride * joint.slot, targets[joint.key], 0.0, 0.0, 60.0, 1.5)
    return bytes(body)


def arms_at_home(twin: Twin) -> dict[str, float]:
    """Return a target for every joint of the topic: its position while the robot stands."""
    slots = SLOTS[twin.model.name].joints
    return {joint.key: twin.home[i] for i, joint in enumerate(twin.model.joints) if joint.slot in slots}


def send(twin: Twin, weight: float, seconds: float, **targets: float) -> None:
    """Send messages at 50 Hz, as the vendor's examples do."""
    body = frame(twin, weight, {**arms_at_home(twin), **targets})
    for _ in range(round(seconds / 0.02)):
        twin.onboard.command_arms(body, twin.now_s)
        twin.run(0.02)


def turned(twin: Twin, joint: str) -> float:
    index = twin.model.axes.index(joint)
    return twin.onboard.state().q[index] - twin.home[index]


@pytest.mark.parametrize("robot", HUMANOIDS)
def test_arms_follow_the_topic_while_the_robot_stands_by_its_own_controller(robot: str) -> None:
    twin, joint = Twin(robot), HUMANOIDS[robot]
    send(twin, 1.0, 1.5, **{joint: twin.home[twin.model.axes.index(joint)] + TURN_RAD})
    assert turned(twin, joint) == pytest.approx(TURN_RAD, abs=0.15)
    assert not twin.fell and not twin.onboard.commanded
    knee = next(axis for axis in twin.model.axes if "left_knee" in axis)
    assert abs(turned(twin, knee)) < 0.05, "the legs stay with the robot's own controller"
    twin.run(1.0)
    assert turned(twin, joint) == pytest.approx(TURN_RAD, abs=0.15), "the last message stays in force"
    send(twin, 0.0, 0.1)
    twin.run(1.0)
    assert abs(turned(twin, joint)) < 0.1, "without a weight the controller has its arms back"


def test_a_joint_without_gains_stays_with_the_controller() -> None:
    """The message names only one joint, as some users' programs do. The waist does not go limp."""
    twin = Twin("unitree_g1")
    for _ in range(100):
        twin.onboard.command_arms(frame(twin, 1.0, {"left_elbow": twin.home[18] + TURN_RAD}), twin.now_s)
        twin.run(0.02)
    assert turned(twin, "left_elbow") == pytest.approx(TURN_RAD, abs=0.15)
    assert abs(turned(twin, "waist_pitch")) < 0.05 and not twin.fell
    twin.onboard.command_arms(frame(twin, 1.0, {}), twin.now_s)
    assert not twin.onboard.arm_joints


@pytest.mark.parametrize("robot", HUMANOIDS)
def test_a_command_to_a_leg_has_no_effect(robot: str) -> None:
    twin = Twin(robot)
    knee = next(axis for axis in twin.model.axes if "left_knee" in axis)
    send(twin, 1.0, 0.5, **{knee: 1.0})
    assert abs(turned(twin, knee)) < 0.05 and not twin.fell


def test_the_weight_is_the_share_of_the_message() -> None:
    turns = []
    for weight in (0.05, 0.5, 1.0, 7.0):
        twin = Twin("unitree_g1")
        send(twin, weight, 1.0, left_elbow=twin.home[18] + TURN_RAD)
        turns.append(turned(twin, "left_elbow"))
    assert 0.0 > turns[0] > turns[1] > turns[2] and turns[3] == pytest.approx(turns[2], abs=0.02)


def test_arms_follow_while_the_robot_walks() -> None:
    twin = Twin("unitree_g1", keeps_s=0.0)
    assert twin.ask("sport", rpc.SET_VELOCITY, velocity=[0.3, 0.0, 0.0], duration=1000.0) == (0, {})
    send(twin, 1.0, 1.5, left_elbow=twin.home[18] + TURN_RAD)
    assert twin.onboard.gait is not None and twin.onboard.gait.position[0] == pytest.approx(0.45, abs=0.02)
    assert turned(twin, "left_elbow") == pytest.approx(TURN_RAD, abs=0.15) and not twin.fell


@pytest.mark.parametrize("fsm", [0, 1, 3, 4])
def test_arms_are_the_robot_s_own_in_states_in_which_it_does_not_balance(fsm: int) -> None:
    twin = Twin("unitree_g1")
    send(twin, 1.0, 0.2, left_elbow=twin.home[18] + TURN_RAD)
    twin.onboard.set_fsm(fsm)
    assert not twin.onboard.arm_joints
    send(twin, 1.0, 0.1, left_elbow=twin.home[18] + TURN_RAD)
    assert not twin.onboard.arm_joints, "the message is ignored"


def test_a_low_cmd_has_all_joints_and_a_released_robot_ignores_the_topic() -> None:
    twin = Twin("unitree_g1")
    twin.command(twin.home, kp=200.0, kd=6.0)
    send(twin, 1.0, 0.1, left_elbow=0.0)
    assert not twin.onboard.arm_joints and twin.onboard.commanded
    twin.onboard.set_mode("")
    send(twin, 1.0, 0.1, left_elbow=0.0)
    assert not twin.onboard.arm_joints


def test_a_simulation_does_not_have_the_arms_that_a_client_commands() -> None:
    twin = Twin("unitree_g1")
    body = StandingBody(twin.onboard)
    body.energise(True)
    assert set(body.commanders) == {Commander.SIM}
    send(twin, 1.0, 0.02)
    wire = {axis for axis, who in zip(twin.model.axes, body.commanders, strict=True) if who is Commander.WIRE}
    assert wire == set(arms_at_home(twin))


def test_a_quadruped_has_no_such_topic() -> None:
    assert Twin("unitree_go2").onboard.arms is None
    assert Twin("unitree_g1", simulator=True).onboard.arms is None


@pytest.mark.parametrize("body", [b"", bytes(999), bytes(1001)])
def test_a_message_of_another_length_is_refused(body: bytes) -> None:
    with pytest.raises(MalformedFrame, match="1000 bytes"):
        Twin("unitree_g1").onboard.command_arms(body, 100.0)


@pytest.mark.parametrize("targets", [{"left_elbow": float("nan")}, {"left_knee": float("inf")}])
def test_a_message_with_an_invalid_number_changes_nothing(targets: dict[str, float]) -> None:
    twin = Twin("unitree_g1")
    with pytest.raises(MalformedFrame, match="not finite"):
        twin.onboard.command_arms(frame(twin, 1.0, targets), twin.now_s)
    assert not twin.onboard.arm_joints


# -- the service


def ask(twin: Twin, number: int, api: int = a.EXECUTE, key: str = "data", within_s: float = 9.9) -> Response:
    """Request a gesture, and return the response. The vendor's example waits at most 10 s for it."""
    request = Request(number, api, json.dumps({key: number}))
    answer = twin.onboard.serve(a.SERVICE, request)
    began_s = twin.now_s
    while answer is None:
        twin.run(0.1)
        answer = next(iter(twin.onboard.take_responses()), None)
        assert twin.now_s - began_s < within_s, "the vendor's client waits no longer"
    return answer


def state(twin: Twin) -> dict[str, Any]:
    assert twin.onboard.actions is not None
    return twin.onboard.actions.state


@pytest.mark.parametrize("number", a.GESTURES)
def test_every_gesture_moves_its_arms_and_is_answered(number: int) -> None:
    twin, gesture = Twin("unitree_g1"), a.GESTURES[number]
    assert state(twin) == {"holding": False, "id": 0, "name": ""}
    answer = ask(twin, number, key="action_id" if number % 2 else "data")
    assert (answer.id, answer.api, answer.code) == (number, a.EXECUTE, 0)
    moved = {side[0] for side in ("left", "right") if abs(turned(twin, f"{side}_shoulder_pitch")) > 0.2}
    assert state(twin)["holding"] is gesture.holds
    assert moved == (set(gesture.arms) if gesture.holds else set()), "what does not hold has returned"
    if gesture.holds:
        assert state(twin) == {"holding": True, "id": number, "name": gesture.name}
        assert ask(twin, a.RELEASE).code == 0
        twin.run(1.0)
    assert abs(turned(twin, "right_shoulder_pitch")) < 0.1 and abs(turned(twin, "left_shoulder_pitch")) < 0.1
    assert state(twin)["id"] == 0 and not twin.onboard.arm_joints and not twin.fell


def test_a_gesture_that_does_not_hold_moves_in_between() -> None:
    twin = Twin("unitree_g1")
    twin.onboard.serve(a.SERVICE, Request(1, a.EXECUTE, '{"data": 26}'))
    twin.run(2.3)
    assert turned(twin, "right_shoulder_pitch") < -1.5 and not twin.onboard.take_responses()
    assert state(twin) == {"holding": False, "id": 26, "name": "high_wave"}
    yaws = []
    for _ in range(10):
        twin.run(0.1)
        yaws.append(turned(twin, "right_shoulder_yaw"))
    assert max(yaws) - min(yaws) > 0.3, "it waves"


def test_a_held_gesture_allows_only_release_or_itself() -> None:
    twin = Twin("unitree_g1")
    assert ask(twin, 18).code == 0
    assert ask(twin, 19).code == a.HOLDING and state(twin)["id"] == 18
    assert ask(twin, 18).code == 0 and state(twin)["id"] == 0, "the same number again releases"
    assert ask(twin, a.RELEASE).code == 0, "nothing is held"


def test_a_pose_is_held_for_twenty_seconds_at_most() -> None:
    twin = Twin("unitree_g1")
    assert ask(twin, 15).code == 0
    twin.run(19.0)
    assert state(twin)["holding"]
    twin.run(3.5)
    assert state(twin)["id"] == 0 and not twin.onboard.take_responses()


def test_a_gesture_during_another_one_is_refused_and_release_ends_it() -> None:
    twin = Twin("unitree_g1")
    twin.onboard.serve(a.SERVICE, Request(1, a.EXECUTE, '{"data": 26}'))
    twin.run(0.5)
    assert ask(twin, 27).code == a.OCCUPIED
    assert twin.onboard.serve(a.SERVICE, Request(2, a.EXECUTE, '{"data": 99}')) is None
    twin.run(2.2)
    assert [(response.id, response.code) for response in twin.onboard.take_responses()] == [(1, 0), (2, 0)]
    assert not twin.onboard.arm_joints


def test_a_client_of_the_topic_occupies_it() -> None:
    twin = Twin("unitree_g1")
    send(twin, 1.0, 0.1)
    assert ask(twin, 27).code == a.OCCUPIED
    send(twin, 0.0, 0.1)
    twin.run(1.1)
    assert ask(twin, 27).code == 0


@pytest.mark.parametrize("fsm", [1, 4])
def test_a_gesture_needs_a_robot_that_balances(fsm: int) -> None:
    twin = Twin("unitree_g1")
    twin.onboard.serve(a.SERVICE, Request(1, a.EXECUTE, '{"data": 26}'))
    twin.run(0.5)
    twin.onboard.set_fsm(fsm)
    twin.run(0.1)
    assert [response.code for response in twin.onboard.take_responses()] == [a.WRONG_FSM]
    answer = twin.onboard.serve(a.SERVICE, Request(2, a.EXECUTE, '{"data": 27}'))
    assert answer is not None and answer.code == a.WRONG_FSM, "it is answered at once"
    assert state(twin)["id"] == 0 and not twin.onboard.arm_joints


@pytest.mark.parametrize(
    ("api", "parameter", "code"),
    [
        (a.EXECUTE, '{"data": 14}', a.NO_SUCH_ACTION),
        (a.EXECUTE, '{"data": "clap"}', rpc.BAD_DATA),
        (a.EXECUTE, "{}", rpc.BAD_DATA),
        (a.EXECUTE, "{", rpc.BAD_DATA),
        (7108, '{"action_name": "mine"}', rpc.NOT_IMPLEMENTED),
        (7113, "", rpc.NOT_IMPLEMENTED),
        (rpc.SERVER_VERSION, "", rpc.OK),
        (a.LIST, "", rpc.OK),
    ],
)
def test_the_answers_of_the_service(api: int, parameter: str, code: int) -> None:
    answer = Twin("unitree_g1").onboard.serve(a.SERVICE, Request(1, api, parameter))
    assert answer is not None and answer.code == code
    if api == a.LIST:
        presets, customs = json.loads(answer.data)
        assert {entry["id"] for entry in presets} == {*a.GESTURES, a.RELEASE} and customs == []


def test_only_a_g1_has_the_service() -> None:
    have = [robot for robot in (*HUMANOIDS, "unitree_go2") if a.SERVICE in Twin(robot).onboard.services]
    assert have == ["unitree_g1"]
