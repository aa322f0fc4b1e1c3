"""Calibrate twins by simulated hand motion. Check the values in the servos and in LeRobot's file, and that a
robot then connects with them."""

from __future__ import annotations

import errno
import importlib
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot
from strands_actors.drivers import leader_name
from strands_actors.drivers.common.kit.calibration import FIELDS, save
from strands_actors.drivers.common.kit.calibration import load as read_calibration
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.drivers.common.servo.calibrating import Proposal
from strands_actors.drivers.common.servo.setup import Setup
from strands_actors.testing import Twin
from tests.answers import status, until

from .hands import ENDS, JOINTS, Hands, class_of, setup_of, sweep

commands = importlib.import_module("strands_actors.surfaces.cli.calibrate")  # the command has the module's name
person = importlib.import_module("strands_actors.surfaces.cli.person")

MIDDLE, TURN = 2047, 4095
COUNTS_PER_RADIAN = 4096 / 6.2831853
WIDTH = (ENDS[1] - ENDS[0]) * COUNTS_PER_RADIAN
CENTRE = sum(ENDS) / 2 * COUNTS_PER_RADIAN
NEAR = 45


class NoisyPort:
    """A port that regularly flips a received byte, or loses all received bytes."""

    EVERY = 41

    def __init__(self, port: str, baud: int) -> None:
        self._port = open_serial(port, baud)
        self._reads = 0
        self.spoiled = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._port, name)

    async def read(self) -> bytes:
        data = await self._port.read()
        self._reads += 1
        if self._reads % self.EVERY:
            return data
        self.spoiled += 1
        return await self._port.read() if self.spoiled % 2 else data[:-1] + bytes([data[-1] ^ 0x40])


@pytest.mark.parametrize("robot", ["so101", "so101_leader", "koch", "koch_leader"])
def test_a_robot_is_calibrated_by_hand_and_connects_with_lerobots_file(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "lerobot"))
    with Twin(robot, tmp_path, by_hand=True) as twin:
        hands = Hands(twin)
        found = sweep(robot, twin, hands).motors
        assert len(hands.asked) == len(JOINTS), "each joint is asked for once"
        for name, motor in found.items():
            if name in class_of(robot).TABLES.robots[robot]["whole_turn"]:
                assert (motor.range_min, motor.range_max) == (0, TURN)
            else:
                assert motor.range_max - motor.range_min == pytest.approx(WIDTH, abs=NEAR), name
                assert motor.range_min + motor.range_max == pytest.approx(2 * MIDDLE, abs=3), name
            assert abs(motor.homing_offset) == pytest.approx(CENTRE, abs=NEAR), name
        inverted = [name for name, motor in found.items() if motor.drive_mode]
        assert inverted == (["elbow_flex"] if robot == "koch_leader" else [])
        path = class_of(robot).calibration_file(robot, "left")
        save(path, found)
        folder = {
            "so101": "robots/so_follower",
            "koch": "robots/koch_follower",
            "so101_leader": "teleoperators/so_leader",
            "koch_leader": "teleoperators/koch_leader",
        }[robot]
        assert path == tmp_path / "lerobot" / folder / "left.json"
        written = json.loads(path.read_text())
        assert list(written) == list(JOINTS) and list(written["gripper"]) == list(FIELDS)
        kinds = {entry.kind for entry in twin.log.entries() if entry.sender == "host"}
        assert not kinds & {"enable", "setpoint"}, "no motor was energised"
        if leader_name(robot) is not None:
            return
        arm = Robot(robot, mode="real", port=twin.port, tool_name="left")
        try:
            assert until(lambda: arm.connect_eagerly() is None, "it connects")
            assert status(arm)["calibration_source"] == str(path)
            assert "uncalibrated" not in status(arm)
        finally:
            arm.cleanup()


def test_a_file_of_lerobots_command_is_read_and_written_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arm is as real arms are: no joint has its middle at the middle of the encoder, one offset is at the
    end of its register, and the gripper closes at half a turn."""
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    theirs = Path(__file__).with_name("as_lerobot_writes_it.json").read_bytes()
    follower = tmp_path / "robots" / "so_follower" / "blue.json"
    follower.parent.mkdir(parents=True)
    follower.write_bytes(theirs)
    driver = class_of("so101")("so101", "port", class_of("so101").resolve("so101", {"tool_name": "blue"}))
    # In LeRobot's degrees, 0 is the middle of the range and a turn has 4095 counts.
    half_turns = {"shoulder_pan": 2255 / 2, "wrist_flex": 2286 / 2, "wrist_roll": 4095 / 2}
    for joint, half in half_turns.items():
        assert driver.travel()[joint] == pytest.approx((-half * 360 / 4095, half * 360 / 4095), abs=0.1)
    assert driver.travel()["gripper"] == pytest.approx((0.0, 100.0))
    again = tmp_path / "again.json"
    save(again, read_calibration(follower, {axis: at for at, axis in enumerate(JOINTS, 1)}, MIDDLE))
    assert again.read_bytes() == theirs


@pytest.mark.parametrize("robot", ["so101", pytest.param("koch", marks=pytest.mark.long)])
def test_requests_with_lost_or_damaged_answers_are_repeated(robot: str, tmp_path: Path) -> None:
    with Twin(robot, tmp_path, by_hand=True) as twin:
        ports: list[NoisyPort] = []

        def noisy(port: str, baud: int) -> BytePort:
            ports.append(NoisyPort(port, baud))
            return ports[-1]

        found = sweep(robot, twin, Hands(twin), open_port=noisy).motors
    assert sum(port.spoiled for port in ports) > 1
    assert all(motor.range_max - motor.range_min > WIDTH - NEAR for motor in found.values())


@pytest.mark.parametrize(
    ("robot", "robot_id", "why"),
    [
        ("so101", "my.arm", "so101 cannot be called so. Use 1 to 64 of A-Z"),
        ("so101", "../left", "so101 cannot be called so"),
        ("so101", "", "so101 cannot be called so"),
        ("so101_leader", "../../left", "which cannot name a calibration file"),
        ("koch_leader", "", "which cannot name a calibration file"),
    ],
)
def test_an_id_that_nothing_could_use_is_refused_before_the_work(robot: str, robot_id: str, why: str) -> None:
    with pytest.raises(commands.Problem, match=why):
        commands.calibrate(robot, "/dev/null", robot_id, as_json=True)


def test_an_unwritable_file_is_reported_before_the_calibration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "file"))
    with pytest.raises(commands.Problem, match=r"so_leader/left.json cannot be written \(Not a directory\). Make"):
        commands.calibrate("so101_leader", "/dev/null", "left", as_json=True)


def test_a_file_that_cannot_be_written_after_the_calibration_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk became full in the meantime."""
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))

    def no_space(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    measured = Proposal({}, {}, (), {}, {}), None
    monkeypatch.setattr(commands, "run_for_person", lambda *_: measured)
    monkeypatch.setattr("strands_actors.drivers.common.kit.calibration.save", no_space)
    with pytest.raises(commands.Problem, match=r"the servos are calibrated, and .*left.json could not be written"):
        commands.calibrate("so101_leader", "/dev/null", "left", as_json=True)


@pytest.mark.parametrize(("robot", "new_id"), [("so101", 11), ("koch", 11)])
def test_a_new_servo_is_given_its_id_and_the_speed_of_the_bus(robot: str, new_id: int, tmp_path: Path) -> None:
    """The gripper's servo gets the state of a new servo: alone on the bus, with another id and speed."""
    with Twin(robot, tmp_path) as twin:
        setup = setup_of(robot, twin.port)
        gripper = setup.axes[-1]
        for axis in setup.axes[:-1]:
            twin.fault(f"off:{axis.id}")

        async def main() -> None:
            slow = setup.CODEC.BAUD_RATES[1]
            await alone(setup)
            shop = type(gripper)(**{**{n: getattr(gripper, n) for n in gripper.__struct_fields__}, "id": new_id})
            await setup.give(gripper.id, shop, slow)
            bauds = (setup.config.baud, slow)
            found = await setup.seek(bauds)
            assert found == [(slow, new_id)]
            await setup.adopt(found[0], gripper)
            assert await setup.seek(bauds) == [(setup.config.baud, gripper.id)]
            setup.close()

        trio.run(main)


async def alone(setup: Setup[Any]) -> None:
    """Wait until the other servos are off."""
    with trio.fail_after(20.0):
        while [found.id for found in await setup.seek((setup.config.baud,))] != [setup.axes[-1].id]:
            pass
    setup._open(setup.config.baud)


def test_an_unplugged_adapter_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("left", "right"):
        (tmp_path / name).touch()
    pull = _when_asked(lambda: (tmp_path / "right").unlink())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(person.Terminal, "ready", pull)
        assert commands.ports([f"{tmp_path}/*"], as_json=True) == 0
    assert json.loads(capsys.readouterr().out)["port"] == f"{tmp_path}/right"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(person.Terminal, "ready", _when_asked(lambda: None))
        with pytest.raises(commands.Problem, match=r"no adapter was unplugged\. Unplug only"):
            commands.ports([f"{tmp_path}/*"], as_json=True)


def _when_asked(act: Callable[[], None]) -> Any:
    async def ready(self: object, text: str) -> None:
        assert "unplug" in text
        act()

    return ready
