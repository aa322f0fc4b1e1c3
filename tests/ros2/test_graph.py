"""A program of ROS sees an arm on its graph, reads its joints and stops it."""

from __future__ import annotations

import time
from math import radians
from pathlib import Path

import pytest
from rosbags.rosbag2 import Reader, Writer

from tests.answers import until

from .conftest import World
from .peer import STORE

JOINT_STATE = "sensor_msgs/msg/JointState"


def test_the_arm_is_a_node_with_topics_and_services_until_it_leaves(world: World) -> None:
    program = world.program
    assert "/lab/so101/joint_states" in program.names("MP")
    assert {"/lab/so101/stop", "/lab/so101/estop", "/lab/so101/resume"} <= program.names("SS")
    received = program.listen("/lab/so101/joint_states", JOINT_STATE)
    message = until(lambda: received[-1] if len(received) > 2 else None, "joint states")
    observed = world.arm.get_observation()
    assert message.name[:2] == ["shoulder_pan", "shoulder_lift"] and len(message.position) == 6
    assert message.position[0] == pytest.approx(radians(observed["shoulder_pan"]), abs=0.02)
    stamp_s = message.header.stamp.sec + message.header.stamp.nanosec / 1e9
    assert -0.1 < time.time() - stamp_s < 10.0  # the time of the reading, on this computer's clock
    described = program.listen("/lab/so101/robot_description", "std_msgs/msg/String", latched=True)
    assert (
        'joint name="shoulder_pan"'
        in until(lambda: described, "the description, though it was sent before")[0].data
    )
    world.arm.cleanup()
    until(lambda: "/lab/so101" not in program.nodes(), "the node disappears")


@pytest.mark.long
def test_rosbags_writes_and_reads_a_bag_of_the_topics(world: World, tmp_path: Path) -> None:
    topics = {
        "/lab/so101/joint_states": JOINT_STATE,
        "/lab/so101/tool_pose": "geometry_msgs/msg/PoseStamped",
        "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    }
    received = {topic: world.program.listen(topic, name) for topic, name in topics.items()}
    until(lambda: all(len(messages) > 1 for messages in received.values()), "messages of each topic")
    bag = tmp_path / "bag"
    with Writer(bag, version=9) as writer:
        for topic, name in topics.items():
            connection = writer.add_connection(topic, name, typestore=STORE)
            for message in received[topic]:
                stamp = message.header.stamp
                time_ns = stamp.sec * 10**9 + stamp.nanosec
                writer.write(connection, time_ns, STORE.serialize_cdr(message, name))
    with Reader(bag) as reader:
        read = [STORE.deserialize_cdr(data, connection.msgtype) for connection, _, data in reader.messages()]
    names = {message.__msgtype__ for message in read}
    assert names == set(topics.values()) and len(read) >= 6


def test_saf_005_a_stop_from_the_graph_reports_each_motor_and_is_on_the_wire(world: World) -> None:
    before_ns = time.monotonic_ns()
    success, message = world.program.trigger("/lab/so101/stop")
    assert success, message
    for joint in ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"):
        assert f"{joint} confirmed" in message
    safe = world.twin.log.first_safe(before_ns)
    assert safe is not None
    assert not world.twin.log.host("setpoint", safe.t_ns)
    world.twin.fault("off:3")  # this motor does not answer any more

    def refusal() -> str | None:
        success, message = world.program.trigger("/lab/so101/stop")
        return None if success else message

    assert "NOT CONFIRMED" in until(refusal, "a stop that is not confirmed")


@pytest.mark.long
def test_saf_007_an_estop_from_the_graph_locks_the_arm_until_a_resume(world: World) -> None:
    success, message = world.program.trigger("/lab/so101/estop")
    assert success and "locked" in message
    assert world.arm.send_action({"shoulder_pan": 1.0})["status"] == "error"
    assert world.arm.get_status()["content"][0]
    success, message = world.program.trigger("/lab/so101/resume")
    assert success and "armed" in message, message
