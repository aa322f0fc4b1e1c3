"""A subscriber written for strands-robots, with its keys and field names, reads our robots."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest

from strands_actors import Robot

from .subscriber import Subscriber

JOINTS = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]


@contextlib.contextmanager
def subscribed(robot: str) -> Iterator[Subscriber]:
    with Robot(robot, mode="real", transport="twin"):
        subscriber = Subscriber()
        try:
            yield subscriber
        finally:
            subscriber.close()


def test_an_so101() -> None:
    with subscribed("so101") as peer:
        presence = peer.record("presence")
        assert (presence["robot_id"], presence["robot_type"], presence["hw"]) == (peer.peer, "robot", "so101")
        assert presence["connected"] is True and "shoulder_pan" in presence["action_keys"]
        assert {"state", "health"} <= set(presence["topics"])
        assert not {"imu", "pose", "odom", "battery", "lidar"} & set(presence["topics"])
        state = peer.record("state")
        assert state["joints"]["shoulder_pan.pos"] == state["joints"]["shoulder_pan"]
        assert state["task"]["status"] == "idle" and state["task"]["instruction"] == ""
        assert peer.known("health", "temps")["gripper"] == pytest.approx(30.0, abs=15.0)
        assert peer.silent("imu") and peer.silent("pose")


def test_a_ur() -> None:
    with subscribed("ur5e") as peer:
        assert "pose" in peer.record("presence")["topics"]
        pose = peer.record("pose")
        assert pose["peer_id"] == peer.peer and len(pose["tcp_pose"]) == 6 and pose["frame"] == "base"
        assert [pose["x"], pose["y"], pose["z"]] == pose["tcp_pose"][:3] == pose["xyz"][:3]
        assert len(peer.record("state")["joints"]) == 12
        assert set(peer.known("health", "temps")) == set(JOINTS)


def test_a_g1() -> None:
    with subscribed("unitree_g1") as peer:
        assert {"imu", "battery"} <= set(peer.record("presence")["topics"])
        imu = peer.record("imu")
        for field, numbers in (("rpy", 3), ("gyro", 3), ("accel", 3), ("gyroscope", 3), ("quaternion", 4)):
            assert len(imu[field]) == numbers, field
        assert imu["accelerometer"] == imu["accel"]
        assert peer.record("battery")["pct"] == peer.known("health", "battery_pct") == 80.0
        assert "left_knee" in peer.record("state")["joints"]
