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
from strands_actors.contract.loading import load
from strands_actors.drivers import get_native_driver_class, leader_name, list_leaders
from strands_actors.drivers.common.kit.calibration import FIELDS, save
from strands_actors.drivers.common.kit.calibration import load as read_calibration
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.drivers.common.servo.calibrating import calibrate
from strands_actors.drivers.common.servo.setup import Ranges, Setup
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import Twin
from tests.answers import status, until

commands = importlib.import_module("strands_actors.surfaces.cli.calibrate")  # the command has the module's name

MIDDLE, TURN = 2047, 4095
SWING = 0.6
LEAST = 250
COUNTS_PER_RADIAN = 4096 / 6.2831853


def class_of(robot: str) -> Any:
    return get_native_driver_class(robot) if leader_name(robot) is None else list_leaders()[robot]


def setup_of(robot: str, port: str, open_port: Callable[[str, int], BytePort] = open_serial) -> Setup[Any]:
    driver_class = class_of(robot)
    driver = driver_class(robot, port, driver_class.resolve(robot, {}))
    setup: Setup[Any] = load(driver_class.SETUP)(driver.config, MonotonicClock(), open_port)
    return setup


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


class Hands:
    """Moves the joints of a twin as a person would, except the joints ``still``."""

    def __init__(self, twin: Twin, joints: tuple[str, ...], still: tuple[str, ...] = ()) -> None:
        self._twin = twin
        self._joints = joints
        self._still = still
        self._ranges: Ranges | None = None
        self._shown = trio.Event()
        self.asked: list[str] = []

    async def ready(self, text: str) -> None:
        self.asked.append(text)
        if "middle" in text:
            await self._move(dict.fromkeys(self._joints, 0.1))
            await trio.sleep(0.6)
            return
        moved = [joint for joint in self._joints if joint not in self._still]
        for angle, counts in ((SWING, LEAST // 2), (-SWING, LEAST)):
            await self._move(dict.fromkeys(moved, angle))
            with trio.move_on_after(60.0):
                while not all(self._width(joint) > counts for joint in moved):
                    await self._shown.wait()
                continue
            raise AssertionError({joint: self._width(joint) for joint in moved})

    async def _move(self, angles: dict[str, float]) -> None:
        await trio.to_thread.run_sync(lambda: self._twin.move_by_hand(**angles))

    def _width(self, joint: str) -> int:
        return 0 if self._ranges is None else self._ranges.high[joint] - self._ranges.low[joint]

    def show(self, ranges: Ranges) -> None:
        self._ranges = ranges
        self._shown.set()
        self._shown = trio.Event()


def run(
    robot: str, twin: Twin, hands: Hands, open_port: Callable[[str, int], BytePort] = open_serial
) -> dict[str, Any]:
    driver_class = class_of(robot)
    table = driver_class.TABLES.robots[robot]
    setup = setup_of(robot, twin.port, open_port)

    async def main() -> dict[str, Any]:
        try:
            return dict(
                await calibrate(
                    setup, hands, table.get("whole_turn", ()), table.get("inverted", ()), driver_class.MAX_OFFSET
                )
            )
        finally:
            setup.close()

    return trio.run(main)


JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.mark.parametrize("robot", ["so101", "so101_leader", "koch", "koch_leader"])
def test_a_robot_is_calibrated_by_hand_and_connects_with_lerobots_file(
    robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path / "lerobot"))
    with Twin(robot, tmp_path, by_hand=True) as twin:
        twin.move_by_hand(**dict.fromkeys(JOINTS, 0.1))
        found = run(robot, twin, Hands(twin, JOINTS))
        for name, motor in found.items():
            if name in class_of(robot).TABLES.robots[robot]["whole_turn"]:
                assert (motor.range_min, motor.range_max) == (0, TURN)
            else:
                assert LEAST < motor.range_max - motor.range_min < 900, (name, motor)
            assert abs(motor.homing_offset) == pytest.approx(0.1 * COUNTS_PER_RADIAN, abs=25)
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
        twin.move_by_hand(**dict.fromkeys(JOINTS, 0.1))
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


def test_an_unmoved_joint_is_named_and_the_servos_keep_their_values(tmp_path: Path) -> None:
    with Twin("so101", tmp_path, by_hand=True) as twin:
        twin.move_by_hand(**dict.fromkeys(JOINTS, 0.1))
        with pytest.raises(ValueError, match="elbow_flex was hardly moved"):
            run("so101", twin, Hands(twin, JOINTS, still=("elbow_flex",)))
        setup = setup_of("so101", twin.port)

        async def look() -> list[int]:
            await setup.open()
            kept = [await setup.read_calibration(axis) for axis in setup.axes]
            setup.close()
            return [motor.homing_offset for motor in kept] + [motor.range_max for motor in kept]

        assert trio.run(look) == [0] * 6 + [TURN] * 6


@pytest.mark.parametrize("robot", ["so101", "koch"])
def test_requests_with_lost_or_damaged_answers_are_repeated(robot: str, tmp_path: Path) -> None:
    with Twin(robot, tmp_path, by_hand=True) as twin:
        twin.move_by_hand(**dict.fromkeys(JOINTS, 0.1))
        ports: list[NoisyPort] = []

        def noisy(port: str, baud: int) -> BytePort:
            ports.append(NoisyPort(port, baud))
            return ports[-1]

        found = run(robot, twin, Hands(twin, JOINTS), noisy)
    assert sum(port.spoiled for port in ports) > 1
    assert all(motor.range_max - motor.range_min > LEAST for motor in found.values())


@pytest.mark.parametrize(("low", "high"), [(2047, 4368), (-300, 2500), (-200, 3700)])
def test_a_range_beyond_one_turn_is_named_and_not_cut(low: int, high: int) -> None:
    ranges = Ranges(setup_of("so101", "/dev/null").axes, ("wrist_roll",))
    for count in (low, high):
        ranges.record({joint: count if joint == "wrist_flex" else count % 2048 for joint in JOINTS})
    assert ranges.problems()["wrist_flex"].startswith(f"went from {low} to {high}, past its encoder's 0 to 4095")


def test_a_joint_that_passed_the_end_of_its_encoder_is_named() -> None:
    setup = setup_of("so101", "/dev/null")
    ranges = Ranges(setup.axes, ("wrist_roll",))
    for count in (10, 4090):
        ranges.record({axis.key: count for axis in setup.axes})
    assert set(ranges.problems()) == set(JOINTS) - {"wrist_roll"}
    assert "end of its encoder" in ranges.problems()["gripper"]


def test_a_joint_that_jumped_by_half_a_turn_between_two_readings_passed_the_end() -> None:
    """The hand moved so quickly that neither end of the encoder was read."""
    setup = setup_of("so101", "/dev/null")
    ranges = Ranges(setup.axes, ("wrist_roll",))
    for count in (2047, 2900, 3700, 300, 700):
        ranges.record({axis.key: count for axis in setup.axes})
    assert set(ranges.problems()) == set(JOINTS) - {"wrist_roll"}
    assert "end of its encoder" in ranges.problems()["gripper"]


def test_a_range_is_limited_to_the_readings() -> None:
    ranges = Ranges(setup_of("so101", "/dev/null").axes, ("wrist_roll",))
    for count in (4100, 4700):
        ranges.record(dict.fromkeys(JOINTS, count))
    assert "went from 4100 to 4700" in ranges.problems()["gripper"]


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

    monkeypatch.setattr(commands, "run_for_person", lambda *_: {})
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
        patch.setattr(commands.Terminal, "ready", pull)
        assert commands.ports([f"{tmp_path}/*"], as_json=True) == 0
    assert json.loads(capsys.readouterr().out)["port"] == f"{tmp_path}/right"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(commands.Terminal, "ready", _when_asked(lambda: None))
        with pytest.raises(commands.Problem, match=r"no adapter was unplugged\. Unplug only"):
            commands.ports([f"{tmp_path}/*"], as_json=True)


def _when_asked(act: Callable[[], None]) -> Any:
    async def ready(self: object, text: str) -> None:
        assert "unplug" in text
        act()

    return ready
