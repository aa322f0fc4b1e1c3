"""What the console shows of robots, from their telemetry and from what pretends to be telemetry."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh.schemas import key
from strands_actors.surfaces.web.robots import FORGET_S, MOST_EVENTS, Robots

STATE: dict[str, Any] = {
    "peer_id": "arm",
    "t": 1.0,
    "state": "armed",
    "epoch": 3,
    "age_s": 0.01,
    "joints": {"pan": 1.0, "pan.pos": 1.0},
}


class Mesh:
    """A mesh on which tests publish."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.robots = Robots(lambda: self.now_s)

    def put(self, topic: str, robot: str = "arm", **fields: Any) -> None:
        self.put_bytes(topic, msgspec.json.encode(fields), robot)

    def put_bytes(self, topic: str, payload: bytes, robot: str = "arm") -> None:
        self.robots.receive(Received(key(robot, topic), payload, "", None))


@pytest.fixture
def mesh() -> Mesh:
    return Mesh()


def test_a_robot_is_summed_up(mesh: Mesh) -> None:
    task = {"status": "running", "instruction": "wave", "steps": 1}
    mesh.put("state", **STATE, task=task, cause="a stop", last_refusal="past its travel")
    mesh.put(
        "presence", robot_id="arm", timestamp=1.0, hw="so101", hostname="bench", connected=True, lease="a page"
    )
    mesh.put("health", peer_id="arm", t=1.0, ok=False, connected=True, faults={"pan": "overheated"})
    mesh.put("battery", pct=81)
    mesh.now_s += 2.5
    (robot,) = mesh.robots.summaries()
    assert (robot.name, robot.type, robot.host, robot.state, robot.epoch) == ("arm", "so101", "bench", "armed", 3)
    assert (robot.lease, robot.task, robot.battery, robot.problem) == ("a page", "wave", 81.0, "pan: overheated")
    assert robot.silent_s == 2.5 and robot.last_refusal == "past its travel"


def test_a_robot_of_which_only_one_topic_is_known_is_shown(mesh: Mesh) -> None:
    mesh.put("battery", pct="full")
    (robot,) = mesh.robots.summaries()
    assert (robot.name, robot.state, robot.battery, robot.age_s) == ("arm", "", None, -1.0)


@pytest.mark.parametrize(
    "payload",
    [b"", b"[]", b"null", b"\xff", b'{"state": 3}', b"[" * 5000, b'{"t": 1e400}', b'{"t":"x","state":"armed"}'],
)
@pytest.mark.parametrize("topic", ["state", "presence", "health", "battery"])
def test_a_message_that_is_no_telemetry_changes_nothing(mesh: Mesh, topic: str, payload: bytes) -> None:
    mesh.put("state", **STATE)
    mesh.put_bytes(topic, payload)
    assert mesh.robots.summaries()[0].state == "armed"


def test_texts_of_other_hosts_have_no_control_characters(mesh: Mesh) -> None:
    mesh.put("state", **{**STATE, "cause": "a\x1b[31mb\n"})
    assert "\x1b" not in mesh.robots.summaries()[0].cause and "\n" not in mesh.robots.summaries()[0].cause


def test_names_that_are_no_names_are_ignored(mesh: Mesh) -> None:
    mesh.put("state", robot="<script>", **STATE)
    assert mesh.robots.summaries() == []


def test_events_are_counted_and_limited(mesh: Mesh) -> None:
    for epoch in range(MOST_EVENTS + 20):
        mesh.put("state", **{**STATE, "epoch": epoch, "state": "armed" if epoch % 2 else "holding"})
    robot = mesh.robots.get("arm")
    assert robot is not None and len(robot.events) == MOST_EVENTS and robot.event_count > MOST_EVENTS


def test_a_robot_that_is_gone_for_long_is_forgotten(mesh: Mesh) -> None:
    mesh.put("state", **STATE)
    mesh.now_s += FORGET_S + 1
    mesh.robots.look()
    assert mesh.robots.summaries() == []
