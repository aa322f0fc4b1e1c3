"""Test ``driver="lerobot"``: LeRobot's class of a robot in our tree. The wire decides. A stand-in replaces
LeRobot; ``python -m tests lerobot`` uses the real one."""

from __future__ import annotations

import fcntl
import json
import os
import re
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest

from strands_actors import Robot
from strands_actors.contract.driver import Reason
from strands_actors.contract.loading import load
from strands_actors.drivers import LEROBOT, canonical_name, lerobot_missing, list_driver_coverage
from strands_actors.drivers.plain.lerobot import bus_access, follower
from strands_actors.drivers.plain.lerobot.follower import class_of
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until, why

from .rig import SmallArm

pytestmark = pytest.mark.real_time
"""The vendor's SDK requests a servo's answer once, and waits for milliseconds."""

STANDIN = Path(__file__).parent / "standin"
MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.fixture
def lerobot(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Put the stand-in on the path, for this process and its children."""
    monkeypatch.syspath_prepend(str(STANDIN))
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] in ("lerobot", "draccus")]:
        del sys.modules[name]


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("so101", tmp_path) as twin:
        yield twin


@pytest.fixture
def arm(twin: Twin, lerobot: None, tmp_path: Path) -> Iterator[Any]:
    robot = Robot("so101", mode="real", driver="lerobot", port=twin.port, **calibrated(tmp_path))
    try:
        # The vendor's SDK sends a request once. On a busy machine a servo may be late.
        until(lambda: robot.connect_eagerly() is None, "it connects")
        yield robot
    finally:
        robot.cleanup()


def calibrated(folder: Path) -> dict[str, str]:
    motors = {
        motor: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for at, motor in enumerate(MOTORS, start=1)
    }
    (folder / "black.json").write_text(json.dumps(motors))
    return {"tool_name": "black", "calibration_dir": str(folder)}


def test_every_type_of_lerobots_has_a_name_here_and_a_class() -> None:
    types = load(LEROBOT)
    assert {kind.type for kind in types.values()} >= {
        "so100_follower", "so101_follower", "koch_follower", "omx_follower", "openarm_follower", "lekiwi",
        "bi_so_follower", "bi_openarm_follower", "reachy2", "hope_jr_hand", "hope_jr_arm", "unitree_g1",
        "earthrover_mini_plus",
    }  # fmt: skip
    for robot, kind in types.items():
        assert robot == class_of(robot).ROBOT
        assert kind.stops, f"nothing stops {robot}"
        assert list_driver_coverage()[canonical_name(kind.type)][0] == "lerobot"


def test_without_lerobot_the_error_has_its_install_line() -> None:
    with pytest.raises(
        ValueError, match=r"omx is driven by LeRobot's own class, .* pip install 'lerobot\[dynamixel\]'"
    ):
        Robot("omx", mode="real", port="/dev/ttyACM0")
    with pytest.raises(ValueError, match="LeRobot has no class for ur5e"):
        Robot("ur5e", mode="real", port="192.0.2.1", driver="lerobot")


def test_the_missing_parts_of_an_installed_lerobot_are_named(lerobot: None) -> None:
    assert lerobot_missing("so101") == ""
    assert (
        lerobot_missing("omx") == "pip install -U 'lerobot[dynamixel]'"
    )  # the stand-in is older than this robot's class
    assert lerobot_missing("reachy2") == ""
    assert lerobot_missing("unitree_g1").endswith(", and unitree_sdk2py, from Unitree")


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({}, "so101 needs 'port'"),
        ({"port": "/dev/x", "transport": "twin"}, "has no simulated robot for"),
        ({"port": "/dev/x", "cameras": {"wrist": {}}}, "opens no cameras"),
        ({"port": "/dev/x", "tool_name": "no such"}, "tool_name is 'no such'"),
    ],
)
def test_impossible_keywords_are_refused_when_the_robot_is_made(
    lerobot: None, keywords: dict[str, Any], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        Robot("so101", mode="real", driver="lerobot", **keywords)


def test_an_object_that_cannot_be_made_or_is_not_calibrated_gives_the_reason(
    twin: Twin, lerobot: None, tmp_path: Path
) -> None:
    for keywords, text in (
        ({"tool_name": "white"}, "so101_follower 'white' is not calibrated .* Run lerobot-calibrate"),
        ({**calibrated(tmp_path), "gain": 3}, "so101_follower has no option gain. Use id, calibration_dir, port"),
    ):
        robot = Robot("so101", mode="real", driver="lerobot", port=twin.port, **keywords)
        try:
            problem = robot.connect_eagerly()
            assert problem is not None and re.search(text, problem)
        finally:
            robot.cleanup()


def test_saf_011_connecting_energises_nothing_and_arming_holds_the_present_position(twin: Twin, arm: Any) -> None:
    reported = status(arm)
    assert reported["lerobot_type"] == "so101_follower" and reported["axes_from"] == "its type"
    assert reported["stop_channel"].startswith("torque off by our own codec")
    kinds = [frame.kind for frame in twin.log.entries() if frame.sender == "host"]
    assert kinds.count("enable") == 6  # once each, by arming; LeRobot's own connect would add six more
    assert kinds.index("setpoint") < kinds.index("enable")  # its position is the goal before it has torque
    before = arm.get_observation()
    json_of(arm.send_action({"shoulder_pan": before["shoulder_pan"] + 10.0}))
    until(lambda: abs(arm.get_observation()["shoulder_pan"] - before["shoulder_pan"] - 10.0) < 1.0, "it moves")


def test_saf_014_a_refused_command_never_reaches_lerobot(twin: Twin, arm: Any) -> None:
    begun_ns = time.monotonic_ns()
    assert "shoulder_pan 400.0 deg is past" in why(arm.send_action({"shoulder_pan": 400.0}))
    assert "nan" in why(arm.send_action({"shoulder_pan.pos": float("nan")}))
    twin.log.silent_after(begun_ns, "setpoint")


def test_saf_005_a_stop_is_read_back_and_a_hold_keeps_the_torque(twin: Twin, arm: Any) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    json_of(arm.run_policy(lambda seen: {"shoulder_pan": seen["shoulder_pan"]}, n_steps=3))
    until(lambda: state(arm) == "holding", "the rollout ended, and it is held")
    begun_ns = time.monotonic_ns()
    assert json_of(arm.stop())["safe_state"] == "limp"
    twin.log.no_setpoint_after_safe(begun_ns)
    json_of(arm.resume())
    twin.fault("off:3")
    assert "stop: not confirmed" in why(arm.stop())
    twin.fault("ok")
    until(lambda: state(arm) == "disarmed", "it is heard again")


def test_saf_003_after_a_kill_of_the_wire_our_codec_turns_the_torque_off(twin: Twin, arm: Any) -> None:
    json_of(arm.send_action({"shoulder_pan": 8.0}))
    killed_ns = time.monotonic_ns()
    os.kill(pids(arm)["wire"], signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "it is limp")
    until(lambda: status(arm)["connected"] and state(arm) == "disarmed", "there is another wire")
    twin.log.no_setpoint_after_safe(killed_ns)
    twin.log.silent_after(killed_ns, "enable")  # SAF-008: LeRobot's connect would energise, and must not
    json_of(arm.resume())


def test_saf_016_root_and_wire_are_killed_and_the_standby_takes_the_torque(twin: Twin, arm: Any) -> None:
    json_of(arm.send_action({"shoulder_pan": 8.0}))
    both = [pids(arm)[role] for role in ("root", "wire")]
    killed_ns = time.monotonic_ns()
    for pid in both:
        os.kill(pid, signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "it is limp")


def test_a_type_with_an_unknown_bus_is_stopped_by_its_disconnect(small_arm: SmallArm, lerobot: None) -> None:
    robot = Robot("reachy2", mode="real", port=small_arm.port)
    try:
        assert robot.connect_eagerly() is None
        assert status(robot)["stop_channel"] == "none: a fresh process calls stop()"
        assert robot.driver.fallbacks[Reason.POLICY] == "stop"  # the driver does not know how to hold this robot
        json_of(robot.send_action({"pan": 3.0}))
        until(lambda: small_arm.said("goal"), "it moves")
        json_of(robot.stop())
        assert small_arm.log[-1].text == "off"
        json_of(robot.resume())
        json_of(robot.send_action({"pan": 4.0}))
        until(lambda: len(small_arm.said("goal")) == 2, "it moves")
        killed_ns = time.monotonic_ns()
        os.kill(pids(robot)["wire"], signal.SIGKILL)
        until(lambda: small_arm.said("off", killed_ns), "another process connects, and stops it")
        assert small_arm.said("goal", killed_ns) == []
    finally:
        robot.cleanup()


def test_saf_005_a_stop_takes_the_torque_of_the_others_when_one_servo_does_not_answer(twin: Twin, arm: Any) -> None:
    """LeRobot's own loop over the motors ends at the first motor that does not answer."""
    json_of(arm.send_action({"shoulder_pan": arm.get_observation()["shoulder_pan"] + 5.0}))
    twin.fault("off:2")
    stopped_ns = time.monotonic_ns()
    assert arm.stop()["status"] == "error"
    safe = twin.log.first_safe(stopped_ns)
    assert safe is not None and safe.safe_state == "limp", twin.log.story(stopped_ns)
    twin.log.no_setpoint_after_safe(stopped_ns)


def test_a_bus_without_sync_read_is_read_motor_by_motor() -> None:
    """LeRobot's bus of a HopeJR hand raises for a sync read."""

    class Bus:
        motors = ("thumb", "index")
        torque: ClassVar[dict[str, int]] = {"thumb": 0, "index": 1}

        def sync_read(self, *_: object, **__: object) -> None:
            raise NotImplementedError("'Sync Read' is not available")

        def read(self, register: str, motor: str, *, num_retry: int, normalize: bool) -> int:
            assert register == bus_access.TORQUE and not normalize
            return self.torque[motor]

    with pytest.raises(ConnectionError, match="index still has torque"):
        bus_access.require_limp(Bus(), ())


def test_saf_019_neither_a_hold_nor_an_action_energises_a_limp_servo(twin: Twin, arm: Any) -> None:
    """On an STS3215 a goal turns the torque on."""
    moved_ns = time.monotonic_ns()
    json_of(arm.send_action({"shoulder_pan": arm.get_observation()["shoulder_pan"] + 5.0}))
    until(lambda: twin.log.host("setpoint", moved_ns), "it is told")  # the goal does not energise the motor later
    twin.power_cycle()
    until(lambda: len(status(arm)["faults"]) == len(MOTORS), "their torque is looked at")
    assert set(status(arm)["faults"].values()) == {"limp"} and state(arm) == "armed"
    begun_ns = time.monotonic_ns()
    assert "shoulder_lift has lost its torque" in why(arm.send_action({"shoulder_lift": 0.0}))
    arm.release()
    until(lambda: state(arm) != "armed", "it was to be held")
    time.sleep(0.3)
    twin.log.silent_after(begun_ns, "setpoint")
    twin.log.silent_after(begun_ns, "enable")
    json_of(arm.stop())
    json_of(arm.resume())
    assert status(arm)["faults"] == {}
    json_of(arm.send_action({"shoulder_lift": arm.get_observation()["shoulder_lift"]}))


class Half:
    """One of LeRobot's arms, in which one motor has no torque."""

    action_features: ClassVar[dict[str, type]] = dict.fromkeys(("pan.pos", "lift.pos"), float)
    is_connected = True

    def __init__(self, motors: tuple[str, ...] = ("pan", "lift")) -> None:
        self.bus, self.motors = self, motors
        self.torque = dict.fromkeys(motors, 1)
        self.goals: dict[str, int] = {}

    def sync_read(
        self, register: str, motors: list[str] | None, *, num_retry: int, normalize: bool
    ) -> dict[str, int]:
        known = self.torque if register == bus_access.TORQUE else dict.fromkeys(self.motors, 2048)
        return {motor: known[motor] for motor in motors or self.motors}

    def sync_write(self, register: str, values: dict[str, int], *, normalize: bool) -> None:
        assert register == bus_access.GOAL
        self.goals |= values

    def enable_torque(self, num_retry: int) -> None:
        self.torque = dict.fromkeys(self.motors, 1)

    def get_observation(self) -> dict[str, float]:
        return dict.fromkeys(self.action_features, 0.0)

    def send_action(self, action: dict[str, float]) -> None:
        self.goals |= dict.fromkeys(action, 1)


def followed(robot: Half, kind: str = "so101") -> follower.Follower:
    made: follower.Follower = object.__new__(class_of(kind))
    made._robot_type, made._robot = load(LEROBOT)[kind], robot
    made._energise()
    robot.goals.clear()
    return made


def test_saf_019_a_hold_is_of_the_motors_that_have_torque() -> None:
    robot = Half()
    made = followed(robot)
    robot.torque["lift"] = 0
    assert made.hold() == ""
    assert robot.goals == {"pan": 2048} and made.limp == {"lift"}
    robot.torque["pan"] = 0
    robot.goals.clear()
    made.hold()
    assert robot.goals == {} and made.limp == {"pan", "lift"}


def test_saf_019_an_action_for_a_motor_without_torque_is_refused() -> None:
    robot = Half()
    made = followed(robot)
    robot.torque["lift"] = 0
    for _ in range(follower.TORQUE_EVERY):
        made.get_observation()
    with pytest.raises(RuntimeError, match="lift has no torque"):
        made.send_action({"lift.pos": 1.0, "pan.pos": 1.0})
    assert robot.goals == {}
    made.send_action({"pan.pos": 1.0})
    assert robot.goals == {"pan.pos": 1}
    made._energise()
    assert made.limp == set()


def test_a_limp_motor_is_named_as_the_robots_keys_name_it() -> None:
    """Two arms have the same motors. A wheel has no separate key, and any action may turn it."""
    assert follower._prefix("left_arm.bus") == "left_" and follower._prefix("bus") == ""
    robot = Half(motors=("pan", "lift", "wheel"))
    made = followed(robot)
    robot.torque["wheel"] = 0
    made.hold()
    assert made.limp_of({"pan.pos": 1.0}) == ["wheel"]


class Late:
    """A bus that delivers answers to earlier requests, which read like "no torque"."""

    motors = ("pan", "lift")

    def __init__(self, answers: list[dict[str, int] | Exception]) -> None:
        self.answers = answers
        self.robot, self.port = os.openpty()
        tty.setraw(self.port)
        self.unread: list[int] = []

    def sync_read(
        self, register: str, motors: None, *, num_retry: int, normalize: bool
    ) -> dict[str, int] | Exception:
        count = bytearray(4)
        fcntl.ioctl(self.port, termios.FIONREAD, count)
        self.unread.append(int.from_bytes(count, sys.byteorder))
        os.write(self.robot, b"a late answer")
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


ON, OFF = {"pan": 0, "lift": 1}, {"pan": 0, "lift": 0}


@pytest.mark.parametrize(
    ("answers", "agreeing", "limp"),
    [
        ([OFF], 1, True),
        ([ON, OFF], 1, True),
        ([OFF, OFF], 2, True),
        ([OFF, ON, OFF, OFF], 2, True),
        ([OFF, ON, OFF, ON], 2, False),
        ([ConnectionError("there is no status packet"), OFF, OFF], 2, True),
        ([ConnectionError("there is no status packet")] * 4, 1, False),
        ([ON] * 4, 1, False),
    ],
)
def test_saf_005_one_reading_of_a_bus_with_late_answers_confirms_nothing(
    answers: list[dict[str, int] | Exception], agreeing: int, limp: bool
) -> None:
    bus = Late([*answers])
    if limp:
        bus_access.require_limp(bus, (bus.port,), agreeing)
    else:
        with pytest.raises(ConnectionError, match=r"lift still has torque|no status packet"):
            bus_access.require_limp(bus, (bus.port,), agreeing)
    assert bus.unread == [0] * len(answers), "late bytes are dropped before each request"
    assert not bus.answers
