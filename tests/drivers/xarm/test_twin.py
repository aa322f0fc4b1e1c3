"""Test the twin's controller with its own clock: which requests move its arm."""

from __future__ import annotations

import errno
import math
import random
import socket
from collections.abc import Sequence

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.controlled_body import SharedBody
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.arms import arm_of, model_table
from strands_actors.drivers.xarm.protocol import ERROR, INVALID, NOT_READY, Mode, Register, State
from strands_actors.drivers.xarm.twin import controller_of, may_bind
from strands_actors.drivers.xarm.twin.controller import TICK_HZ, Controller


class World:
    def __init__(self, **options: object) -> None:
        self.now_s = 100.0
        self.controller: Controller = controller_of("xarm7", now_s=lambda: self.now_s, **options)  # type: ignore[arg-type]
        self.home = self.position

    @property
    def position(self) -> tuple[float, ...]:
        return self.controller.plant.position_rad

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * TICK_HZ)):
            self.now_s += 1 / TICK_HZ
            self.controller.tick()

    def say(self, register: int, data: bytes = b"") -> int:
        flags, _ = self.controller.obey(register, data)
        return flags

    def arm(self, mode: int = Mode.SERVO) -> None:
        assert self.say(Register.MOTION_ENABLE, b"\x08\x01") & INVALID == 0
        self.say(Register.SET_MODE, bytes((mode,)))
        assert self.say(Register.SET_STATE, b"\x00") == 0

    def at(self, **offsets: float) -> list[float]:
        """Return the home position with some joints moved: ``joint1=0.1``."""
        return [rad + offsets.get(f"joint{number}", 0.0) for number, rad in enumerate(self.home, 1)]

    def servo(self, goal: Sequence[float]) -> int:
        return self.say(Register.SERVO_JOINT, p.servo_data(goal))


def test_it_does_nothing_before_it_is_enabled() -> None:
    world = World()
    assert world.servo(world.at(joint1=0.1)) & NOT_READY
    world.say(Register.SET_MODE, b"\x01")
    world.say(Register.SET_STATE, b"\x00")
    assert world.controller.state == State.STOPPED
    world.run(1.0)
    assert np.allclose(world.position, world.home, atol=1e-3), "the brakes hold the arm"


def test_servo_mode_goes_to_the_last_target_and_holds_it() -> None:
    world = World()
    world.arm()
    assert world.servo(world.at(joint1=0.3)) == 0
    world.run(0.05)
    assert world.controller.state == State.MOVING
    assert 0.0 < world.position[0] < 0.3
    world.run(1.0)
    assert world.controller.state == State.READY
    assert world.position[0] == pytest.approx(0.3, abs=5e-3)
    world.run(5.0)
    assert world.position[0] == pytest.approx(0.3, abs=5e-3)


def test_stop_halts_it_and_a_target_after_it_counts_for_nothing() -> None:
    world = World()
    world.arm()
    world.servo(world.at(joint1=0.4))
    world.run(0.06)
    world.say(Register.SET_STATE, b"\x04")
    assert world.controller.state == State.STOPPED
    world.run(1.0)
    stood = world.position[0]
    assert stood < 0.35
    assert world.servo(world.at(joint1=stood)) & NOT_READY
    world.run(0.5)
    assert world.position[0] == pytest.approx(stood, abs=2e-3)


def test_a_jump_is_error_24_and_stays_until_it_is_cleared() -> None:
    world = World()
    world.arm()
    assert world.servo(world.at(joint1=1.0)) & ERROR
    assert (world.controller.error, world.controller.state, world.controller.enabled) == (24, State.STOPPED, 0)
    assert world.say(Register.SET_STATE, b"\x00") & (ERROR | NOT_READY) == ERROR | NOT_READY
    world.say(Register.CLEAR_ERROR)
    world.arm()
    assert world.controller.state == State.READY


def test_a_target_past_a_joints_range_is_an_error() -> None:
    world = World(arm_type=3)
    world.arm()
    world.controller.set_targets(world.home)
    for rad in (0.0, 0.15):
        goal = list(world.home)
        goal[3] = rad
        world.controller._goal = goal  # so that there is no step
        assert not world.servo(goal) & ERROR
    goal[3] = 0.25
    assert world.servo(goal) & ERROR
    assert world.controller.error == 23


def test_paused_it_keeps_the_newest_target_and_jumps_to_it_on_resume() -> None:
    world = World()
    world.arm()
    world.say(Register.SET_STATE, b"\x03")
    assert world.servo(world.at(joint1=0.3)) & NOT_READY
    world.run(0.5)
    assert world.position[0] == pytest.approx(0.0, abs=2e-3)
    world.say(Register.SET_STATE, b"\x00")
    world.run(0.5)
    assert world.position[0] == pytest.approx(0.3, abs=5e-3)


def test_a_velocity_ends_with_its_duration_and_without_one_never() -> None:
    world = World()
    world.arm(Mode.VELOCITY)
    rates = p.floats([0.5, *[0.0] * 6]) + b"\x01"
    world.say(Register.JOINT_VELOCITY, rates + p.floats([0.3]))
    world.run(1.0)
    assert world.position[0] == pytest.approx(0.15, abs=0.03)
    stood = world.position[0]
    world.say(Register.JOINT_VELOCITY, rates)
    world.run(2.0)
    assert world.position[0] == pytest.approx(stood + 1.0, abs=0.05)


def test_motors_off_is_stopped_and_braked() -> None:
    world = World()
    world.arm()
    world.servo(world.at(joint2=0.2))
    world.run(0.5)
    world.say(Register.MOTION_ENABLE, b"\x08\x00")
    stood = world.position
    world.run(1.0)
    assert world.controller.state == State.STOPPED
    assert np.allclose(world.position, stood, atol=2e-3)


def test_the_simulation_moves_it_until_it_is_energised_on_the_wire() -> None:
    world = World()
    body = SharedBody(world.controller, lambda: world.controller.runs)
    body.energise(True)
    assert set(body.commanders) == {Commander.SIM}
    body.set_targets(world.at(joint1=0.5))
    world.run(1.0)
    assert world.position[0] == pytest.approx(0.5, abs=5e-3)
    world.arm()
    assert set(body.commanders) == {Commander.WIRE}
    body.set_targets(world.at(joint1=-0.5))
    world.run(1.0)
    assert world.position[0] == pytest.approx(0.5, abs=5e-3)
    world.say(Register.SET_STATE, b"\x04")
    assert set(body.commanders) == {Commander.NONE}
    body.reset()
    assert world.position == pytest.approx(world.home)


# -- its body

DH = (
    (0.0, 0.0, 0.267),
    (-math.pi / 2, 0.0, 0.0),
    (math.pi / 2, 0.0, 0.293),
    (math.pi / 2, 0.0525, 0.0),
    (math.pi / 2, 0.0775, 0.3425),
    (math.pi / 2, 0.0, 0.0),
    (-math.pi / 2, 0.076, 0.097),
)
"""Alpha, a and d of the modified DH parameters that the vendor publishes for the xArm 7."""


def flange(radians: Sequence[float]) -> np.ndarray:
    pose = np.eye(4)
    for theta, (alpha, a, d) in zip(radians, DH, strict=True):
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        step = [[c, -s, 0, a], [s * ca, c * ca, -sa, -sa * d], [s * sa, c * sa, ca, ca * d], [0, 0, 0, 1]]
        pose = pose @ np.array(step)
    return pose


def test_the_model_has_the_kinematics_of_the_arm() -> None:
    arm = arm_of("xarm7")
    kind = next(kind for kind in arm.types if kind.number == 7)
    plant = Plant.from_table(model_table("xarm7", kind))
    chance = random.Random(7)
    for _ in range(20):
        radians = [chance.uniform(*ends) for ends in kind.range_rad]
        plant.data.qpos[:] = radians
        mujoco.mj_kinematics(plant.model, plant.data)
        body, pose = plant.data.body("link7"), flange(radians)
        assert np.allclose(body.xpos, pose[:3, 3], atol=1e-9)
        assert np.allclose(body.xmat.reshape(3, 3), pose[:3, :3], atol=1e-9)


def test_every_type_stands_alike_at_home_within_its_range() -> None:
    arm = arm_of("xarm7")
    places = []
    for kind in arm.types:
        plant = Plant.from_table(model_table("xarm7", kind))
        places.append(plant.data.body("link7").xpos.copy())
        for rad, (low, high) in zip(plant.position_rad, kind.range_rad, strict=True):
            assert low <= rad <= high
    assert np.allclose(places, places[0], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "high_rad"),
    [
        ("7,7,XF1300012345,AC1300012345,v1.12.10", (2.094395, 3.92699)),
        ("7,7,XF1305012345,AC1300012345,v2.5.0", (2.024581, 3.92699)),
        ("7,7,XF8500012345,AC1300012345,v2.5.0", (2.094395, 3.92699)),
        ("7,7,,,v1.8.0", (2.094395, 3.92699)),
        ("7,3,XF1000012345,AC1000012345,v1.5.0", (2.094395, 0.191986)),
        ("7,13,XF1400012345,AC1300012345,v2.5.0", (2.059488, 0.191986)),
        ("6,6,XF1300012345,AC1300012345,v1.12.10", None),
        ("6,7,XF1300012345,AC1300012345,v1.12.10", None),
        ("7,99,XF1300012345,AC1300012345,v1.12.10", None),
    ],
)
def test_the_type_decides_how_far_joints_2_and_4_go(text: str, high_rad: tuple[float, float] | None) -> None:
    arm = arm_of("xarm7")
    at = arm.type_index(p.parse_version(text.encode()))
    found = None if at is None else (arm.types[at].range_rad[1][1], arm.types[at].range_rad[3][1])
    assert found == high_rad


def test_an_unknown_type_is_refused() -> None:
    with pytest.raises(ValueError, match="Use one of 3, 7, 13"):
        controller_of("xarm7", arm_type=5)


# -- its port


def test_a_user_without_the_right_to_the_vendors_port_gets_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: socket.socket, address: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    assert may_bind(0)
    monkeypatch.setattr(socket.socket, "bind", refuse)
    assert not may_bind(502)
