"""The bytes, hashes, keys and tokens are those of ROS 2 Jazzy, as ``rosbags`` knows them."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys.store import Nodetype

from strands_actors.kernel.channels.ros2 import cdr
from strands_actors.kernel.channels.ros2.definitions import (
    ARRAY,
    FOLLOW,
    JOINT_STATE,
    MESSAGES,
    SERVICES,
    SINGLE,
    TRIGGER,
    Fields,
    Service,
    fields_of,
    parse_type,
)
from strands_actors.kernel.channels.ros2.names import (
    Attachment,
    Dialect,
    Entity,
    NodeName,
    Qos,
    gid_of,
    is_namespace,
    read_attachment,
    read_token,
    ros_name,
)
from strands_actors.kernel.channels.ros2.type_hash import type_hash

from .peer import STORE, TRIGGER_HASH

HERE_ONLY = {"service_msgs/msg/ServiceEventInfo"}
"""``rosbags`` hashes its ``char`` as a type of its own, and ROS 2 as ``uint8``. The hash of Trigger, which
contains it, is compared below with that of ROS 2."""

TRIGGER_PARTS = {
    "": TRIGGER_HASH,
    "_Request": "RIHS01_d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199",
    "_Event": "RIHS01_ec4a1d26b0575e61906890342aba9523a2360e9845857c5590fa6e23bc39e1c2",
}
"""As ROS 2 Jazzy computes them."""

# -- types


THEIRS = sorted(name for name in MESSAGES.keys() - HERE_ONLY if not name.startswith(("control_msgs/", "arm_msgs/")))
"""``rosbags`` does not have control_msgs, and no package of a vendor."""


@pytest.mark.parametrize("name", THEIRS)
def test_definitions_and_hashes_are_those_of_jazzy(name: str) -> None:
    assert {field: _text(node) for field, node in STORE.fielddefs[name][1]} == dict(MESSAGES[name])
    assert type_hash(name) == STORE.hash_rihs01(name)


def _text(node: Any) -> str:
    kind, content = node
    if kind == Nodetype.BASE:
        return {"octet": "byte"}.get(content[0], str(content[0]))
    if kind == Nodetype.NAME:
        return str(content)
    inner, size = content
    return f"{_text(inner)}[{size or ''}]"


def test_the_hash_of_a_service_covers_request_response_and_event() -> None:
    assert {part: type_hash(f"{TRIGGER}{part}") for part in TRIGGER_PARTS} == TRIGGER_PARTS


FIBONACCI = "example_interfaces/action/Fibonacci"
FIBONACCI_HASHES = {
    "_Goal": "RIHS01_226cb437e4355dcd3e914f930382a3b0cc1da81545bd319ed554e95a03255f51",
    "_SendGoal": "RIHS01_d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557",
    "_GetResult": "RIHS01_1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57",
    "_FeedbackMessage": "RIHS01_c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2",
}
"""As ROS 2 computes them. No such hashes of FollowJointTrajectory were found."""


def test_the_hashes_of_an_action_are_computed_as_ros_does(monkeypatch: pytest.MonkeyPatch) -> None:
    goal_id = {"goal_id": "unique_identifier_msgs/msg/UUID"}
    fibonacci = {
        "_Goal": {"order": "int32"},
        "_Result": {"sequence": "int32[]"},
        "_Feedback": {"sequence": "int32[]"},
        "_FeedbackMessage": {**goal_id, "feedback": f"{FIBONACCI}_Feedback"},
    }
    for part, fields in fibonacci.items():
        monkeypatch.setitem(MESSAGES, f"{FIBONACCI}{part}", fields)  # type: ignore[arg-type]
    services = {
        "_SendGoal": Service({**goal_id, "goal": f"{FIBONACCI}_Goal"}, SERVICES[f"{FOLLOW}_SendGoal"].response),
        "_GetResult": Service(goal_id, {"status": "int8", "result": f"{FIBONACCI}_Result"}),
    }
    for part, service in services.items():
        monkeypatch.setitem(SERVICES, f"{FIBONACCI}{part}", service)  # type: ignore[arg-type]
    assert {part: type_hash(f"{FIBONACCI}{part}") for part in FIBONACCI_HASHES} == FIBONACCI_HASHES


# -- bytes

NUMBERS = {
    "bool": st.booleans(),
    "byte": st.integers(0, 255),
    "uint8": st.integers(0, 255),
    "int8": st.integers(-128, 127),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
    "string": st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8),
}


def messages(fields: Fields) -> st.SearchStrategy[dict[str, Any]]:
    return st.fixed_dictionaries({field: _values(text) for field, text in fields.items()})


def _values(text: str) -> st.SearchStrategy[Any]:
    field = parse_type(text)
    one = NUMBERS[field.base] if field.base in NUMBERS else messages(fields_of(field.base))
    if field.kind == SINGLE:
        return one
    if field.kind == ARRAY:
        return st.lists(one, min_size=field.size, max_size=field.size)
    return st.lists(one, max_size=field.size or 4)


@settings(max_examples=5)
@given(st.data())
@pytest.mark.parametrize("name", THEIRS)
def test_bytes_are_those_that_rosbags_writes_and_reads(name: str, data: st.DataObject) -> None:
    message = data.draw(messages(MESSAGES[name]))
    payload = cdr.encode(name, message)
    theirs = STORE.deserialize_cdr(payload, name)
    assert bytes(STORE.serialize_cdr(theirs, name)) == payload
    assert _plain(cdr.decode(name, payload)) == _plain(message)
    big = bytes(STORE.serialize_cdr(theirs, name, little_endian=False))
    assert _plain(cdr.decode(name, big)) == _plain(message)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, bytes | list | tuple | np.ndarray):
        return [_plain(each) for each in value]
    return value


@given(st.binary(max_size=200))
@pytest.mark.parametrize("name", [JOINT_STATE, f"{TRIGGER}_Request", "geometry_msgs/msg/Twist"])
def test_any_bytes_are_a_message_or_malformed(name: str, data: bytes) -> None:
    for payload in (data, b"\0\1\0\0" + data, b"\0\0\0\0" + data):
        with contextlib.suppress(cdr.MalformedCdr):
            assert cdr.decode(name, payload).keys() == fields_of(name).keys()


@given(st.data())
def test_a_message_that_is_cut_is_malformed(data: st.DataObject) -> None:
    payload = cdr.encode(JOINT_STATE, {"name": ["a", "b"], "position": [1.0, 2.0], "effort": [1.0]})
    with pytest.raises(cdr.MalformedCdr):
        cdr.decode(JOINT_STATE, payload[: data.draw(st.integers(0, len(payload) - 1))])


@pytest.mark.parametrize(
    "message",
    [{"names": []}, {"name": [1]}, {"position": ["a"]}, {"header": {"stamp": {"sec": 2**40}}}],
)
def test_a_value_that_does_not_fit_is_a_value_error(message: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"sensor_msgs/msg/JointState|std_msgs/msg/Header"):
        cdr.encode(JOINT_STATE, message)


def test_a_missing_field_is_empty_and_nan_is_kept() -> None:
    decoded = cdr.decode(JOINT_STATE, cdr.encode(JOINT_STATE, {"position": [math.nan]}))
    assert decoded["name"] == [] and math.isnan(decoded["position"][0])


# -- names


def test_keys_and_tokens_are_those_of_rmw_zenoh() -> None:
    dialect = Dialect(domain=3)
    node = NodeName("aac3178e", 0, "/lab", "so101")
    assert (
        dialect.key("/lab/so101/stop", TRIGGER) == f"3/lab/so101/stop/std_srvs::srv::dds_::Trigger_/{TRIGGER_HASH}"
    )
    assert node.token(dialect) == "@ros2_lv/3/aac3178e/0/0/NN/%/%lab/so101"
    token = node.endpoint_token(dialect, 7, Entity.PUBLISHER, "/lab/so101/joint_states", JOINT_STATE, Qos.DEFAULT)
    assert token == (
        "@ros2_lv/3/aac3178e/0/7/MP/%/%lab/so101/%lab%so101%joint_states/"
        f"sensor_msgs::msg::dds_::JointState_/{STORE.hash_rihs01(JOINT_STATE)}/:2:,10:,:,:,,"
    )
    assert NodeName("a", 1, "", "n").token(dialect) == "@ros2_lv/3/a/1/1/NN/%/%/n"
    endpoint = read_token(token)
    assert endpoint is not None and (endpoint.kind, endpoint.node) == ("MP", "/lab/so101")
    assert endpoint.topic == "/lab/so101/joint_states"
    assert len(gid_of(token)) == 16


def test_humble_has_no_hashes() -> None:
    key = Dialect(hashed=False).key("/a", JOINT_STATE)
    assert key == "0/a/sensor_msgs::msg::dds_::JointState_/TypeHashNotSupported"


@given(st.integers(-(2**63), 2**63 - 1), st.integers(-(2**63), 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_has_33_bytes_and_is_read_again(sequence: int, sent_ns: int, gid: bytes) -> None:
    attachment = Attachment(sequence, sent_ns, gid)
    assert len(attachment.encode()) == 33
    assert read_attachment(attachment.encode()) == attachment
    assert read_attachment(attachment.encode()[:-1]) is None


@settings(max_examples=50)
@given(st.text(max_size=12))
def test_every_robot_has_a_name_that_ros_accepts(name: str) -> None:
    assert is_namespace(f"/{ros_name(name)}")


@pytest.mark.parametrize(
    ("text", "right"), [("", True), ("/a/b1", True), ("a", False), ("/", False), ("/1", False)]
)
def test_a_namespace_begins_with_a_slash(text: str, right: bool) -> None:
    assert is_namespace(text) is right
