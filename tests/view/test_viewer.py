"""Samples of telemetry become readings, frames and events."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import trio

from strands_actors.drivers.common.kinematics.link_rows import parse_rows
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control.drawn import DrawnModel
from strands_actors.drivers.feetech.robots import TABLES
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.mesh.schemas import EVENT_KEY
from strands_actors.surfaces.view.events import LEVELS, Event, Kind, Level
from strands_actors.surfaces.view.model import Frame, RobotModel, positions_of, read_model
from strands_actors.surfaces.view.sinks import Reading
from strands_actors.surfaces.view.viewer import SILENT_S, Viewer


class Shown:
    """A display that keeps what it gets."""

    def __init__(self) -> None:
        self.readings: list[Reading] = []
        self.moved: list[list[Frame]] = []
        self.events: list[Event] = []
        self.pictures: list[tuple[str, bytes]] = []
        self.topics: dict[str, dict[str, Any]] = {}

    def reading(self, reading: Reading) -> None:
        self.readings.append(reading)

    def model(self, model: RobotModel) -> None:
        pass

    def frames(self, t: float, frames: Sequence[Frame]) -> None:
        self.moved.append(list(frames))

    def event(self, event: Event) -> None:
        self.events.append(event)

    def picture(self, t: float, camera: str, jpeg: bytes) -> None:
        self.pictures.append((camera, jpeg))

    def topic(self, t: float, topic: str, values: dict[str, Any]) -> None:
        self.topics[topic] = values

    def close(self) -> None:
        pass


class Robot:
    """Sends samples to a viewer, at a time that the test sets."""

    def __init__(self) -> None:
        self.now = 100.0
        self.shown = Shown()
        self.viewer = Viewer("arm", [self.shown], now=lambda: self.now, elapsed=lambda: self.now)

    def send(self, topic: str, **values: Any) -> None:
        key = EVENT_KEY if topic == "event" else f"strands/arm/{topic}"
        self.viewer.receive(Received(key, msgspec.json.encode(values), "application/json", None))

    def state(self, **values: Any) -> None:
        usual = {"peer_id": "arm", "t": self.now, "state": "armed", "epoch": 1, "joints": {"a": 1.0, "a.pos": 1.0}}
        self.send("state", **usual | values)

    def kinds(self) -> list[tuple[Kind, str]]:
        return [(event.kind, event.code) for event in self.shown.events]


def test_a_sample_is_a_reading_with_each_joint_once() -> None:
    robot = Robot()
    robot.state(targets={"a": 2.0}, age_s=0.5, joints={"a": 1.0, "a.pos": 1.0, "b": None, "word": "x"})
    (reading,) = robot.shown.readings
    assert [(joint.name, joint.measured, joint.commanded) for joint in reading.joints] == [
        ("a", 1.0, 2.0),
        ("b", None, None),
        ("word", None, None),
    ]
    assert reading.read_t == 99.5


def test_what_has_happened_before_the_view_began_is_no_event() -> None:
    robot = Robot()
    stop = {"epoch": 1, "reason": "start", "safe_state": "limp", "confirmed": True, "took_ms": 1.0}
    robot.state(refused={"lease": 7}, last_refusal="no lease", last_stop=stop)
    robot.state(refused={"lease": 7}, last_refusal="no lease", last_stop=stop)
    assert robot.kinds() == [(Kind.STATE, "armed")]


def test_refusals_are_counted_by_code_also_after_lost_samples() -> None:
    robot = Robot()
    robot.state(refused={"lease": 2})
    robot.state(refused={"lease": 2, "past_travel": 3}, last_refusal="move: too far")
    assert robot.kinds()[1:] == [(Kind.REFUSED, "past_travel")]
    event = robot.shown.events[-1]
    assert (event.count, event.text, event.level) == (3, "move: too far", Level.WARNING)
    robot.state(refused={"lease": 1}, last_refusal="no lease")  # the robot was started again
    assert (robot.shown.events[-1].code, robot.shown.events[-1].count) == ("lease", 1)


def test_a_stop_is_shown_with_its_result() -> None:
    robot = Robot()
    robot.state()
    stop = {"epoch": 2, "reason": "stop", "safe_state": "limp", "confirmed": True, "took_ms": 4.25}
    robot.state(state="disarmed", epoch=2, last_stop=stop, cause="stopped by me")
    assert robot.kinds()[1:] == [(Kind.STATE, "disarmed"), (Kind.STOP, "limp")]
    assert [event.text for event in robot.shown.events[1:]] == [
        "disarmed, epoch 2: stopped by me",
        "limp confirmed in 4.2 ms (stop)",
    ]
    failed = stop | {"epoch": 3, "confirmed": False, "unconfirmed": ["a", "b"]}
    robot.state(state="unconfirmed", epoch=3, last_stop=failed)
    assert (robot.shown.events[-1].level, robot.shown.events[-1].text) == (
        Level.ERROR,
        "limp NOT CONFIRMED by a, b",
    )


def test_a_change_of_the_state_is_shown_once_and_an_older_sample_does_not_undo_it() -> None:
    robot = Robot()
    robot.state()
    robot.send("event", peer_id="arm", t=100.2, event="state", state="disarmed", epoch=2, cause="stopped")
    robot.state(t=100.1)  # was made before the change
    robot.state(t=100.3, state="disarmed", epoch=2)
    robot.send("event", peer_id="another", t=100.4, event="state", state="lost", epoch=9)
    assert robot.kinds() == [(Kind.STATE, "armed"), (Kind.STATE, "disarmed")]


def test_operators_faults_leases_and_tasks_are_events() -> None:
    robot = Robot()
    robot.state()
    robot.send("event", peer_id="arm", t=100.0, event="estop", by="me", outcome="unconfirmed")
    robot.send("presence", robot_id="arm", timestamp=100.0, hw="fake", lease="")
    robot.send("presence", robot_id="arm", timestamp=100.5, hw="fake", lease="a script")
    for faults in ({}, {"a": "hot"}, {"a": "hot"}):
        robot.send("health", peer_id="arm", t=100.0, ok=True, connected=True, faults=faults)
    robot.state(task={"status": "running", "instruction": "wave"})
    assert robot.kinds()[1:] == [
        (Kind.ORDER, "estop"),
        (Kind.LEASE, "held"),
        (Kind.FAULT, "a"),
        (Kind.TASK, "running"),
    ]
    assert robot.shown.topics["presence"]["hw"] == "fake" and "health" in robot.shown.topics


def test_silence_is_reported_once_and_so_is_its_end() -> None:
    robot = Robot()
    robot.viewer.look()  # nothing has arrived yet
    robot.state()
    for _ in range(12):
        robot.now += SILENT_S / 4
        robot.viewer.look()
    robot.state()
    assert robot.kinds()[1:] == [(Kind.SILENT, "silent"), (Kind.SILENT, "back")]


def test_a_late_view_does_not_call_the_robot_silent() -> None:
    robot = Robot()
    robot.viewer.look()
    robot.state()
    robot.now += 3 * SILENT_S  # the view was suspended, and samples wait for it
    robot.viewer.look()
    robot.state()
    assert robot.kinds() == [(Kind.STATE, "armed")]


def test_a_bad_sample_is_reported_once_for_its_topic() -> None:
    robot = Robot()
    for _ in range(2):
        robot.send("state", peer_id="arm", t=-5, state="armed", epoch=1)
    robot.send("imu", gyro=[1, 2, 3])
    assert robot.kinds() == [(Kind.PROBLEM, "view")] and not robot.shown.readings
    assert robot.shown.topics == {"imu": {"gyro": [1, 2, 3]}}


def test_pictures_are_passed_on_unchanged() -> None:
    robot = Robot()
    robot.viewer.receive(Received("strands/arm/camera/wrist", b"\xff\xd8", "image/jpeg", None))
    assert robot.shown.pictures == [("wrist", b"\xff\xd8")]


def test_every_state_has_a_level() -> None:
    assert set(LEVELS) == set(Mode)


def test_the_frames_of_an_arm_are_those_of_its_table() -> None:
    model = trio.run(read_model, "so101")
    rows = parse_rows(TABLES.robots["so101"]["model_rows"])
    degrees = {row.joint: 10.0 * number for number, row in enumerate(rows) if row.joint}
    radians = positions_of(degrees, dict.fromkeys(degrees, (0.0, math.degrees(1.0))))
    frames = {frame.name: frame for frame in model.frames({**radians, "no joint": 1.0})}
    for row in rows:
        if row.joint is None:  # a finger that is fixed to the hand
            continue
        turn, expected = np.empty(4), np.empty(4)
        mujoco.mju_axisAngle2Quat(turn, np.array(row.axis), radians[row.joint])
        mujoco.mju_mulQuat(expected, np.array(row.quat), turn)
        frame = frames[row.body]
        assert frame.parent == row.parent and np.allclose(frame.xyz, row.xyz)
        assert abs(np.dot(frame.quat, expected) / np.linalg.norm(expected)) > 1 - 1e-6
    assert {mesh.body for mesh in model.meshes()} >= {"base", "jaw"}


def test_shapes_that_are_no_meshes_have_surfaces_of_their_size() -> None:
    shapes = {
        "box": "0.1 0.2 0.3",
        "sphere": "0.1",
        "capsule": "0.1 0.2",
        "cylinder": "0.1 0.2",
        "ellipsoid": ".1 .2 .3",
    }
    geoms = "".join(
        f'<body name="{name}"><geom type="{name}" size="{size}"/></body>' for name, size in shapes.items()
    )
    compiled = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>")
    high = {mesh.body: mesh.points.max(axis=0).round(3).tolist() for mesh in DrawnModel(compiled, ()).meshes()}
    assert {name: top[2] for name, top in high.items()} == {
        "box": 0.3,
        "sphere": 0.1,
        "capsule": 0.3,
        "cylinder": 0.2,
        "ellipsoid": 0.3,
    }
