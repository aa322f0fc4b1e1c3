"""Test that the tables match the vendor's messages, and that any input raises only the codec's own error."""

from __future__ import annotations

import importlib
import math
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import TABLES, decode, encode, table
from strands_actors.drivers.spot.twin import SpotTwin
from tests.drivers.disturbed import DISTURBED

KINDS = {1: "double", 2: "float", 3: "int", 4: "uint", 5: "int", 8: "bool", 9: "text", 13: "uint", 14: "uint"}
"""Kinds of the tables by the type number in the vendor's descriptors."""

MODULES = (
    *("auth", "directory", "time_sync", "estop", "lease", "power", "robot_state", "robot_command", "robot_id"),
    *("image", "data_buffer", "fault", "directory_registration"),
)


def services() -> dict[str, Any]:
    """Return the vendor's methods by path."""
    found = {}
    for module in MODULES:
        described = importlib.import_module(f"bosdyn.api.{module}_service_pb2").DESCRIPTOR
        for service in described.services_by_name.values():
            found |= {f"/{service.full_name}/{method.name}": method for method in service.methods}
    return found


def compare(name: str, theirs: Any, seen: set[tuple[str, str]]) -> None:
    """Check a table against a descriptor of the vendor's, and every message in it."""
    if (name, theirs.full_name) in seen:
        return
    seen.add((name, theirs.full_name))
    fields = {field.name: field for field in theirs.fields}
    for number, (key, ours) in enumerate(table(name).items()):
        field = fields.get(key) or theirs.fields_by_number[ours.number]
        assert field.number == ours.number, f"{theirs.full_name}.{key}"
        assert field.is_repeated == ours.repeated, f"{theirs.full_name}.{key}"
        if field.type == 11:
            compare(ours.kind, field.message_type, seen)
        elif field.type == 12:  # bytes: the content of an Any, or of a picture
            assert ours.kind in ("MobilityParams", "bytes")
        else:
            assert KINDS[field.type] == ours.kind, f"{theirs.full_name}.{key}, field {number}"


@pytest.mark.parametrize("method", p.METHODS.values(), ids=lambda method: method.name)
def test_the_tables_are_the_vendors_messages(method: p.Method) -> None:
    theirs = services()[method.path]
    seen: set[tuple[str, str]] = set()
    compare(method.request, theirs.input_type, seen)
    compare(method.reply, theirs.output_type, seen)
    assert len(seen) > 3


def test_the_parameters_of_a_walk_are_the_vendors() -> None:
    spot = importlib.import_module("bosdyn.api.spot.robot_command_pb2")
    compare("MobilityParams", spot.MobilityParams.DESCRIPTOR, set())
    assert p.MOBILITY_PARAMS.endswith(spot.MobilityParams.DESCRIPTOR.full_name)


def test_the_vendors_client_decodes_our_messages() -> None:
    commands = importlib.import_module("bosdyn.api.robot_command_pb2")
    method = p.METHODS["RobotCommand"]
    command = p.together(p.twist((0.5, -0.1, 0.2), 1_700_000_000_600_000_000), p.arm((0.1,) * 6, 2.5), p.claw(-1.0))
    lease = p.newer_lease({"resource": "body", "epoch": "e", "sequence": [7], "client_names": ["us"]}, 3)
    data = p.request(method, {"lease": lease, "command": command, "clock_identifier": "clock"}, "us", 1_000)
    read = commands.RobotCommandRequest.FromString(data)
    assert list(read.lease.sequence) == [7, 3] and read.clock_identifier == "clock"
    walk = read.command.synchronized_command.mobility_command.se2_velocity_request
    assert (walk.velocity.linear.x, walk.velocity.linear.y, walk.velocity.angular) == (0.5, -0.1, 0.2)
    assert (walk.end_time.seconds, walk.end_time.nanos, walk.se2_frame_name) == (1_700_000_000, 600_000_000, "body")
    trajectory = read.command.synchronized_command.arm_command.arm_joint_move_command.trajectory
    assert trajectory.points[0].position.wr1.value == 0.1 and trajectory.maximum_velocity.value == 2.5
    claw = read.command.synchronized_command.gripper_command.claw_gripper_command
    assert claw.trajectory.points[0].point == -1.0
    for ours, field in ((p.STOP, "stop_request"), (p.SAFE_POWER_OFF, "safe_power_off_request")):
        whole = commands.RobotCommandRequest.FromString(p.request(method, {"command": ours}, "us", 0))
        assert whole.command.full_body_command.HasField(field)


def test_we_decode_the_vendors_messages() -> None:
    states = importlib.import_module("bosdyn.api.robot_state_pb2")
    reply = states.RobotStateResponse()
    reply.header.error.code = 1
    state = reply.robot_state
    state.power_state.motor_power_state = 2
    state.battery_states.add().charge_percentage.value = 55.0
    state.estop_states.add(name="button", state=1)
    state.kinematic_state.joint_states.add(name="arm0.sh0").position.value = 0.25
    state.kinematic_state.joint_states.add(name="arm0.sh1").velocity.value = 0.0
    state.kinematic_state.acquisition_timestamp.seconds = 5
    odom = state.kinematic_state.transforms_snapshot.child_to_parent_edge_map["odom"]
    odom.parent_frame_name = "body"
    # The body is at x 1, y 2 and has turned left by 90 degrees.
    odom.parent_tform_child.position.x, odom.parent_tform_child.position.y = -2.0, 1.0
    odom.parent_tform_child.rotation.w, odom.parent_tform_child.rotation.z = math.sqrt(0.5), -math.sqrt(0.5)
    state.kinematic_state.velocity_of_body_in_odom.linear.y = 0.5
    read = p.reading(p.reply(p.METHODS["GetRobotState"], reply.SerializeToString()))
    assert read.motors is p.Motors.ON and read.pressed == ("button",) and read.battery_pct == 55.0
    assert read.joints["arm0.sh0"][0] == 0.25 and read.stamp_ns == 5_000_000_000
    assert math.isnan(read.joints["arm0.sh0"][1]) and read.joints["arm0.sh1"][1] == 0.0, "a zero is encoded"
    assert read.xyz_m == pytest.approx((1.0, 2.0, 0.0))
    assert read.rpy_rad == pytest.approx((0.0, 0.0, math.pi / 2))
    assert read.twist == pytest.approx((0.5, 0.0, 0.0)), "the twist is in the frame of the body"
    assert math.isnan(read.battery_v)


@given(st.integers(-(2**62), 2**62))
def test_times_survive_both_ways(ns: int) -> None:
    assert p.stamp_ns(decode("Timestamp", encode("Timestamp", p.stamp(ns)))) == ns


@given(st.integers(0, 2**64 - 1))
def test_a_challenge_is_answered_by_its_ones_complement(challenge: int) -> None:
    response = p.challenge_response(challenge)
    assert response == ~challenge & (2**64 - 1) and p.challenge_response(response) == challenge


def test_a_header_with_an_error_is_an_error() -> None:
    method = p.METHODS["GetRobotState"]
    for code in (0, 2, 3):
        data = encode(method.reply, {"header": {"error": {"code": code, "message": "no"}}})
        with pytest.raises(MalformedFrame, match="GetRobotState: error"):
            p.reply(method, data)
    with pytest.raises(MalformedFrame):
        p.reply(method, b"")


def test_a_field_that_no_table_has_is_not_written() -> None:
    with pytest.raises(KeyError):
        encode("Lease", {"owner": "us"})


def samples() -> list[tuple[p.Method, bytes, bytes]]:
    """Return requests and replies of the twin: one of each method."""
    twin = SpotTwin("spot", lambda: 0.0)
    found = []
    bodies = {"EstopCheckIn": {"stop_level": 4}, "RobotCommand": {"command": p.stand()}}
    for method in p.METHODS.values():
        requested = p.request(method, bodies.get(method.name, {}), "us", 1)
        reported, _ = twin.answer(method.name, decode(method.request, requested))
        found.append((method, requested, encode(method.reply, {"header": {"error": {"code": 1}}, **reported})))
    return found


def test_any_bytes_are_decoded_or_malformed() -> None:
    chance = random.Random(22)
    twin, whole = SpotTwin("spot", lambda: 0.0), samples()
    refused = 0
    for _ in range(DISTURBED):
        method, requested, reported = chance.choice(whole)
        try:
            request = decode(method.request, disturbed(chance, requested))
            answer, _ = twin.answer(method.name, request)
            encode(method.reply, answer)
        except MalformedFrame:
            refused += 1
        try:
            reply = p.reply(method, disturbed(chance, reported))
            if method.name == "GetRobotState":
                p.reading(reply)
        except MalformedFrame:
            refused += 1
    assert DISTURBED / 20 < refused < 2 * DISTURBED


def disturbed(chance: random.Random, data: bytes) -> bytes:
    """Return bytes that are changed, cut, grown or noise."""
    if not data:
        return chance.randbytes(chance.randrange(20))
    at = chance.randrange(len(data))
    match chance.randrange(4):
        case 0:
            return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
        case 1:
            return data[:at]
        case 2:
            return data[:at] + chance.randbytes(chance.randrange(1, 9)) + data[at:]
    return chance.randbytes(chance.randrange(len(data) + 1))


def test_every_table_can_be_read() -> None:
    for name in TABLES:
        assert decode(name, b"") == {} and all(field.number > 0 for field in table(name).values())
