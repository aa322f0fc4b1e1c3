"""The tool specification and the calls that follow from a driver's declaration. No I/O."""

from __future__ import annotations

import json
from typing import Any

import numpy
import pytest

from strands_actors.contract.agent_verbs import verbs_of
from strands_actors.contract.driver import Driver
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.agents.calls import Call, read, tool_spec

VERBS = {
    "Feetech": ["status", "sensors", "move_to", "set_torque", "stop"],
    "Dynamixel": ["status", "sensors", "move_to", "set_torque", "stop"],
    "UR": ["state", "status", "get_pose", "move_to", "stop"],
    "Robotiq": ["open", "close", "move_to", "sensors", "status", "stop"],
}


def driver(robot: str) -> Driver:
    driver_class = get_native_driver_class(robot)
    assert driver_class is not None
    boards = driver_class.PORT_KIND == "serial" and driver_class.PORT_OPTIONAL  # without a port
    made: Driver = driver_class(robot, "" if boards else "192.0.2.1", {})
    return made


ARM, GRIPPER = driver("so101"), driver("robotiq_2f85")


def called(of: Driver, given: Any) -> Call:
    call = read(of, given)
    assert isinstance(call, Call), call
    return call


def refused(of: Driver, given: Any) -> Refused:
    refusal = read(of, given)
    assert isinstance(refusal, Refused), refusal
    return refusal


@pytest.mark.parametrize("robot", sorted(list_native_drivers()))
def test_every_driver_declares_verbs_and_a_stop(robot: str) -> None:
    made = driver(robot)
    names = [verb.name for verb in made.TOOL_VERBS]
    of_all = VERBS.get(type(made).__name__, names)
    has_pose = made.arm_model({}) is not None
    assert ("get_pose" in names) is has_pose
    assert [name for name in names if name != "get_pose"] == [name for name in of_all if name != "get_pose"]
    assert len(set(names)) == len(names)
    assert {"status", "stop"} <= set(names)
    assert set(made.GUARDED).isdisjoint({"stop"})
    spec = tool_spec("tool", made)
    schema = spec["inputSchema"]["json"]
    assert (spec["name"], schema["type"], schema["required"]) == ("tool", "object", ["action"])
    verbs = verbs_of(made)
    assert schema["properties"]["action"]["enum"] == [verb.name for verb in verbs]
    assert [verb.name for verb in verbs][: len(names)] == names
    assert set(schema["properties"]) == {"action", *(name for verb in verbs for name in verb.inputs)}
    assert all(axis in spec["description"] for axis in made.axes)


def test_targets_are_keyed_by_joint() -> None:
    targets = tool_spec("so101", ARM)["inputSchema"]["json"]["properties"]["targets"]
    assert list(targets["properties"]) == list(ARM.axes)
    assert targets["additionalProperties"] is False


def test_inputs_become_an_action() -> None:
    assert called(ARM, {"action": "move_to", "targets": {"gripper": 3.0}}).action == {"gripper": 3.0}
    assert called(GRIPPER, {"action": "open"}).action == {"gripper": 0.0}
    assert called(GRIPPER, {"action": "close", "force": 0.2, "speed": None}).action == {
        "gripper": 1.0,
        "force": 0.2,
    }


@pytest.mark.parametrize(
    ("given", "needs_approval"),
    [
        ({"action": "set_torque", "enabled": True}, True),
        ({"action": "set_torque", "enabled": False}, False),
        ({"action": "stop"}, False),
        ({"action": "move_to", "targets": {}}, False),
    ],
)
def test_saf_014_energising_needs_an_approval_and_releasing_needs_none(
    given: dict[str, Any], needs_approval: bool
) -> None:
    assert called(ARM, given).needs_approval is needs_approval


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        ({"action": "status"}, "read"),
        ({"action": "sensors", "targets": None}, "read"),
        ({"action": "move_to", "targets": {}}, "motion"),
        ({"action": "set_torque", "enabled": True}, "motion"),
        ({"action": "set_torque", "enabled": False}, "stop"),
        ({"action": "stop"}, "stop"),
        ({"action": " STOP "}, "stop"),
        ({"action": "stop", "why": ["I", "said", "so"]}, "stop"),
    ],
)
def test_a_call_has_the_kind_of_its_verb(given: dict[str, Any], kind: str) -> None:
    assert called(ARM, given).kind == kind


STOPS: list[Any] = [
    "stop",
    " Stop! ",
    "please stop the robot now",
    "e-stop",
    "emergency_stop",
    b"STOP",
    "stop()",
    ["stop"],
    ("stop",),
    [{"action": "move_to", "targets": {}}, {"action": "stop"}],
    '{"action":"stop"}',
    "{'action': 'stop'}",
    '{"name": "so101", "arguments": {"action": "stop"}}',
    '[{"name": "so101", "input": "{\\"action\\":\\"stop\\"}"}]',
    "action: stop",
    "<action>stop</action>",
    {"Action": "stop"},
    {" ACTION ": "Stop."},
    {"action": ["stop"]},
    {"action": {"name": "stop"}},
    {"action": "stop_robot"},
    {"action": '{"action": "stop"}'},
    {"command": "stop", "why": "it smokes"},
    {"input": '{"action":"stop"}'},
    {"arguments": {"action": "stop"}},
    {"stop": True},
    {"stop": None},
    {"stop": {}},
    {"HALT": ""},
    {"stop": {"lock": False}},
    {"stop": numpy.array([1, 2])},
    {"stop": "yes", "action": "fly"},
    "stop the arms",
    "I want you to stop!",
    "STOP! " * 200,
    "\uff33\uff34\uff2f\uff30",
    "emergencyStop",
    "my_tool.stop()",
    'my_tool(action="stop", reason="a hand is there")',
    bytearray(b"stop"),
    {"stop"},
    {"cmd": "stop"},
    {"toolUse": {"toolUseId": "t", "input": {"action": "stop"}}},
    {"tool_calls": [{"type": "function", "function": {"name": "my_tool", "arguments": '{"action": "stop"}'}}]},
    {"action": "my_tool", "action_input": "stop"},
    {"role": "user", "content": [{"type": "text", "text": "stop"}]},
    '{"action": "stop", "reason": "a hand is there",}',
    '{"action": "stop", "reason": "a hand is th',
    "{'action': 'stop', 'reason': 'a hand is there'}",
    '```json\n{"action": "stop", "reason": "a hand is there"}\n```',
    '<tool_call>\n{"name": "my_tool", "arguments": {"action": "stop", "reason": "smoke"}}\n</tool_call>',
    '\ufeff{"action": "stop", "reason": "smoke"}',
    json.dumps({"action": "stop", "reason": "smoke " * 1500}),
    {**{f"more{at}": at for at in range(1000)}, "Action": "stop"},
]


@pytest.mark.parametrize("given", STOPS, ids=lambda given: str(given)[:40])
@pytest.mark.parametrize("driver", [ARM, GRIPPER], ids=["arm", "gripper"])
def test_saf_006_a_stop_is_understood_in_every_form(driver: Driver, given: Any) -> None:
    found = read(driver, given, "my_tool")
    assert isinstance(found, Call) and found.kind == "stop"


@pytest.mark.parametrize("off", [False, numpy.False_])
def test_saf_006_switching_torque_off_ignores_any_other_input(off: Any) -> None:
    found = called(ARM, {"action": "set_torque", "enabled": off, "why": "a hand"})
    assert (found.kind, found.inputs) == ("stop", {"enabled": False})


NO_STOPS: list[Any] = [
    "do not stop",
    "stop at the red sign and go on",
    "unstoppable",
    "stop" * 1000,
    {"stop": False},
    {"action": "status", "why": "stop"},
    {"action": "fly", "note": "stop"},
    ["go", "on"],
    '{"action": "move_to", "targets": {"stop": 1}}',
    [[[[[[[["stop"]]]]]]]],
    float("nan"),
    "[" * 4000,
    '{"action": "sto',
    {"stop": "false"},
    {"stop": None, "action": "fly"},
    {"action": "fly", "name": "stop"},
    {"action": "fly", "command": "faster", "input": "stop"},
    "{'stop': False}",
    "stop: false",
    "stop_task",
    'do not send {"action": "stop"}',
    "{'action': 'fly', 'input': 'stop'}",
    "\u043d\u0435 stop",
    "stop another_tool",
    {"action": numpy.array([1, 2])},
]


@pytest.mark.parametrize("given", NO_STOPS, ids=lambda given: str(given)[:40])
def test_nothing_else_is_taken_for_a_stop(given: Any) -> None:
    found = read(ARM, given, "my_tool")
    assert isinstance(found, Refused) or found.kind != "stop"


def test_saf_006_a_stop_ignores_any_number_of_other_inputs() -> None:
    many = {f"more{at}": at for at in range(1000)}
    assert called(ARM, {**many, "action": "stop"}).kind == "stop"
    assert refused(ARM, {**many, "action": "status"}).text == "tool: the call has 1001 inputs. Give at most 64"


SAYS_OR_TELLS = {
    "reachy_mini": {
        "list_moves", "say", "play_sound", "volume", "set_volume", "tracking_status", "camera", "record_audio",
        "turn_to_sound_status",
    },
    "microduck": {
        "skills", "sounds", "play_sound", "mode", "policies", "health", "version", "model", "odometry", "monitor",
        "tof",
    },
    "earthrover": {"speak"},
}  # fmt: skip
"""Services that need no approval. A new service needs approval, or must be added here."""


@pytest.mark.parametrize("robot", sorted(list_native_drivers()))
def test_switching_power_needs_the_approval_of_a_motion(robot: str) -> None:
    made = driver(robot)
    read = {verb.name for verb in made.TOOL_VERBS if verb.does == "service" and kind_of(made, verb) == "read"}
    assert read == SAYS_OR_TELLS.get(made.robot, set())


def kind_of(of: Driver, verb: ToolVerb) -> str:
    values: dict[str, Any] = {"string": "x", "number": 1.0, "boolean": True, "object": {}}
    return called(
        of, {"action": verb.name, **{name: values[verb.inputs[name]["type"]] for name in verb.required}}
    ).kind


@pytest.mark.parametrize("given", [{}, {"action": None}, {"action": None, "targets": None}])
def test_an_empty_input_reads_the_status(given: dict[str, Any]) -> None:
    for driver in (ARM, GRIPPER):
        assert called(driver, given).verb.does == "status"
    assert refused(ARM, {"targets": {"gripper": 1.0}}).code == "unknown_verb"  # targets alone are not a motion


def test_a_truth_value_of_numpy_is_one() -> None:
    assert called(ARM, {"action": "set_torque", "enabled": numpy.True_}).kind == "motion"
    assert called(ARM, {"action": "set_torque", "enabled": numpy.False_}).kind == "stop"
    assert called(GRIPPER, {"action": "close", "force": numpy.float32(0.5)}).inputs == {"force": 0.5}
    assert refused(GRIPPER, {"action": "close", "force": numpy.True_}).code == "bad_input"


@pytest.mark.parametrize("given", [None, "sit", 3, [], [("action", "move_to")], '{"action": "status"}'])
def test_an_input_that_is_not_an_object_is_refused(given: Any) -> None:
    assert refused(ARM, given).code == "bad_input"


@pytest.mark.parametrize("action", ["", "fly", 3, True, ["go"], {"a": 1}, "x" * 10_000])
def test_an_undeclared_verb_is_refused_with_the_declared_ones(action: Any) -> None:
    refusal = refused(ARM, {"action": action})
    assert refusal.code == "unknown_verb"
    assert refusal.remedy == "use status, sensors, get_pose, move_to, set_torque, stop"
    assert len(refusal.text) < 300


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"action": "move_to", "target": {}},
            "move_to: there is no input 'target' ('targets'?). Use targets, seconds, "
            "xyz, rpy, quat, frame, speed, linear, keep_out",
        ),
        ({"action": "status", "now": True}, "status: there is no input 'now'. Use no input"),
        ({"action": "set_torque", "enabled": 1}, "set_torque: enabled is 1. Give enabled as boolean"),
        ({"action": "set_torque", "enabled": None}, "set_torque: enabled is missing. Give enabled"),
        ({"action": "move_to", "targets": "home"}, "move_to: targets is 'home'. Give targets as object"),
    ],
)
def test_a_wrong_input_is_refused_with_the_accepted_values(given: dict[str, Any], text: str) -> None:
    assert refused(ARM, given).text == text


def test_a_bool_does_not_count_as_a_number() -> None:
    assert refused(GRIPPER, {"action": "close", "force": True}).text == "close: force is True. Give force as number"


def test_a_verb_without_inputs_has_its_action() -> None:
    assert Call(ToolVerb("home", "action", "Go home.", action={"a": 1.0})).action == {"a": 1.0}
