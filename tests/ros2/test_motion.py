"""A program of ROS moves an arm: through the lease, the gate and the lifetime of every other writer."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable
from math import radians
from typing import Any

import numpy as np
import pytest

from tests.answers import until

from .conftest import World
from .peer import STORE, Program

JOINT_COMMAND = "/lab/so101/joint_command"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def joint_state(**radians_of: float) -> Any:
    types = STORE.types
    stamp = types["builtin_interfaces/msg/Time"](0, 0)
    header = types["std_msgs/msg/Header"](stamp, "")
    empty = np.empty(0)
    return types["sensor_msgs/msg/JointState"](
        header, list(radians_of), np.array(list(radians_of.values())), empty, empty
    )


class Stream:
    """Publishes a message again and again, as a controller does, until the end of the ``with`` block."""

    def __init__(self, program: Program, topic: str, make: Callable[[], Any]) -> None:
        self._program, self._topic, self._make = program, topic, make
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._ended.wait(0.02):
            self._program.publish(self._topic, self._make())

    def __enter__(self) -> Stream:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._thread.join()


def pan(world: World) -> float:
    return float(world.arm.get_observation()["shoulder_pan"])


def refused(world: World, part: str) -> str | None:
    return next((line for line in world.bridge.lines if part in line), None)


def test_saf_001_a_stream_moves_the_arm_and_its_end_is_a_hold(world: World) -> None:
    before_ns = time.monotonic_ns()
    start = pan(world)
    with Stream(world.program, JOINT_COMMAND, lambda: joint_state(shoulder_pan=radians(start + 8.0))):
        until(lambda: abs(pan(world) - start - 8.0) < 1.5, f"it moves: {world.bridge.lines}")
    until(lambda: "holding" in str(world.arm.get_status()), "a hold")
    assert world.twin.log.host("setpoint", before_ns)
    # The stream has begun once. A new stream is refused, because the robot holds, until a resume.
    time.sleep(1.1)
    with Stream(world.program, JOINT_COMMAND, lambda: joint_state(shoulder_pan=radians(start))):
        until(lambda: refused(world, "holds"), "the refusal of a new stream")
        # This stream goes on, and a resume must not start its motion.
        success, message = world.program.trigger("/lab/so101/resume")
        assert success, message
        until(lambda: refused(world, "has refused this stream"), "the refusal of the stream that went on")
        assert abs(pan(world) - start - 8.0) < 1.5
    time.sleep(1.1)
    with Stream(world.program, JOINT_COMMAND, lambda: joint_state(shoulder_pan=radians(start))):
        until(lambda: abs(pan(world) - start) < 1.5, f"it moves again: {world.bridge.lines}")


def test_saf_009_a_second_writer_is_refused_with_the_name_of_the_first(world: World) -> None:
    start = pan(world)
    with (
        Program(world.endpoint, gid=b"another program!") as other,
        Stream(world.program, JOINT_COMMAND, lambda: joint_state(shoulder_pan=radians(start + 5.0))),
    ):
        until(lambda: abs(pan(world) - start - 5.0) < 1.5, f"it moves: {world.bridge.lines}")
        received = world.program.listen("/diagnostics", DIAGNOSTICS)
        with Stream(other, JOINT_COMMAND, lambda: joint_state(shoulder_pan=radians(start - 20.0))):
            line = until(lambda: refused(world, "are not sent"), "the refusal of the second writer")
        assert b"a program of ROS".hex()[:8] in line and b"another program!".hex()[:8] in line
        assert pan(world) > start + 3.0
        # A program on the mesh, too, is refused with the holder's name.
        answer = world.arm.send_action({"shoulder_pan": start})
        assert answer["status"] == "error"

        def values() -> dict[str, str] | None:
            status = received[-1].status[0] if received else None
            found = {each.key: each.value for each in status.values} if status else {}
            return found if found.get("ros_last_refusal") else None

        found = until(values, "diagnostics")
        assert "are not sent" in found["ros_last_refusal"] and found["lease"] and found["ros_writer"]
        assert found["state"] == "armed" and float(found["reading_age_s"]) < 1.0


WRONG: list[tuple[dict[str, float], str]] = [
    ({"elbow": 0.1}, "no joint 'elbow'"),
    ({"shoulder_pan": 9.0}, "past"),
    ({"shoulder_pan": float("nan")}, "as JSON"),
]
GARBAGE = [b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40, b"\0\7\0\0" + bytes(80), bytes(1_100_000)]


@pytest.mark.long
def test_saf_014_what_is_wrong_is_refused_with_a_reason_and_writes_nothing(world: World) -> None:
    before = pan(world)
    for joints, why in WRONG:
        with Stream(world.program, JOINT_COMMAND, functools.partial(joint_state, **joints)):
            until(functools.partial(refused, world, why), f"a refusal with {why}: {world.bridge.lines}")
    for payload in GARBAGE:
        for attachment in (None, b"x" * 33, bytes(16) + b"\x10" + b"g" * 16):
            world.program.publish_raw(JOINT_COMMAND, "sensor_msgs/msg/JointState", payload, attachment)
    until(lambda: refused(world, "a message was dropped"), "the reason")
    assert pan(world) == pytest.approx(before, abs=1.0)
    assert world.program.trigger("/lab/so101/stop")[0]
