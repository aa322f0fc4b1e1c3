"""Test a twin's second simulation control: frames, which client may move which axes, and pictures of any solver."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.body import Body, Commander
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.simulation_control import protocol as p
from strands_actors.drivers.common.simulation_control import renderer as renderer
from strands_actors.drivers.common.simulation_control.client import Refusal, SimulationClient
from strands_actors.drivers.common.simulation_control.server import SimulationControl
from strands_actors.drivers.common.twin import WireLog
from strands_actors.drivers.dynamixel.robots import TABLES as DYNAMIXEL
from strands_actors.drivers.dynamixel.twin import DynamixelBus
from strands_actors.drivers.feetech import protocol as feetech
from strands_actors.drivers.feetech.robots import TABLES as FEETECH
from strands_actors.drivers.feetech.twin import FeetechBus
from strands_actors.drivers.robotiq import protocol as robotiq
from strands_actors.drivers.robotiq.robots import TABLES as ROBOTIQ
from strands_actors.drivers.robotiq.twin import twin_of
from strands_actors.drivers.ur.arms import TABLES as UR
from strands_actors.drivers.ur.arms import arm_of
from strands_actors.drivers.ur.twin.body import URBody
from strands_actors.drivers.ur.twin.controller import Controller
from strands_actors.drivers.ur.twin.script import Standing
from strands_actors.testing import WireLog as ReadLog

ANSWER_S = 20.0

REQUESTS: tuple[p.Request, ...] = (
    p.Handshake(1),
    p.Take(2),
    p.Aim(0, (1.0, -0.5)),
    p.Safe(3, p.LIMP),
    p.Read(4),
    p.Reset(5),
    p.Render(6, 64, 48, "top"),
    p.GetModel(7),
    p.GetPose(8),
)


class Time:
    """A clock in seconds that the test sets."""

    def __init__(self) -> None:
        self.s = 100.0

    def __call__(self) -> float:
        return self.s


class Ticking:
    """A body with its own passing time."""

    def __init__(self, body: Body, now: Time, tick: Callable[[], None]) -> None:
        self.body = body
        self._now = now
        self._tick = tick

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.01)):
            self._now.s += 0.01
            self._tick()


def ticking(robot: str) -> tuple[Ticking, Any]:
    """Return a robot's body, and the device that its wire uses."""
    now = Time()
    if robot in FEETECH.robots:
        feetech_bus = FeetechBus.for_robot(robot, now)
        return Ticking(feetech_bus.body, now, feetech_bus.pass_time), feetech_bus
    if robot in DYNAMIXEL.robots:
        dynamixel_bus = DynamixelBus.for_robot(robot, now)
        return Ticking(dynamixel_bus.body, now, dynamixel_bus.pass_time), dynamixel_bus
    if robot in ROBOTIQ.robots:
        twin = twin_of(robot, now)
        return Ticking(twin.body, now, twin.body.pass_time), twin
    controller = Controller(arm_of(robot), now_s=now)
    return Ticking(URBody(controller), now, controller.tick), controller


ROBOTS = (*FEETECH.robots, *DYNAMIXEL.robots, *ROBOTIQ.robots, *UR.robots)


# -- frames


@given(st.lists(st.integers(1, 40)))
def test_frames_come_through_in_any_pieces(sizes: list[int]) -> None:
    stream = b"".join(map(p.encode, REQUESTS))
    decoder, received, at = p.request_decoder(), [], 0
    for size in [*sizes, len(stream)]:
        received += decoder.feed(stream[at : at + size])
        at += size
    assert received == list(REQUESTS)


@given(st.binary(max_size=200))
def test_invalid_frames_raise_only_the_codecs_error(noise: bytes) -> None:
    decoder = p.request_decoder()
    try:
        frames = list(decoder.feed(len(noise).to_bytes(4, "little") + noise))
    except MalformedFrame:
        return
    assert all(isinstance(frame, p.Frame) for frame in frames)


def test_a_frame_that_is_too_long_is_refused_before_it_is_there() -> None:
    with pytest.raises(MalformedFrame, match="more than 65536"):
        list(p.request_decoder().feed((1 << 20).to_bytes(4, "little")))


# -- bodies


@pytest.mark.parametrize("robot", ROBOTS)
def test_what_is_taken_goes_where_it_is_aimed_and_holds_there(robot: str) -> None:
    time, _ = ticking(robot)
    body = time.body
    assert set(body.felt().commanders) == {Commander.NONE}
    body.set_targets([0.3] * len(body.axes))  # no client holds these axes
    time.run(0.2)
    body.energise(True)
    felt = body.felt()
    assert set(felt.commanders) == {Commander.SIM}
    goal = [position + (0.05 if at % 2 else -0.05) for at, position in enumerate(felt.position)]
    if robot in ROBOTIQ.robots:
        goal = [0.5]
    body.set_targets(goal)
    time.run(2.0)
    there = [abs(position - wanted) < 0.07 for position, wanted in zip(body.felt().position, goal, strict=True)]
    moved = [abs(now - then) > 0.02 for now, then in zip(body.felt().position, felt.position, strict=True)]
    assert all(there)
    assert sum(moved) >= len(moved) / 2  # some are at the end of their range
    body.hold()
    body.reset()
    assert body.felt().position == pytest.approx(ticking(robot)[0].body.felt().position)
    assert set(body.felt().commanders) == {Commander.NONE}


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_body_shows_its_whole_model(robot: str) -> None:
    body = ticking(robot)[0].body
    model = body.spec.copy().compile()
    assert len(body.pose()) == model.nq
    assert body.spec.worldbody.geoms[0].name == "floor"


def test_a_servo_that_is_energised_on_the_wire_follows_the_wire() -> None:
    time, bus = ticking("so101")
    body = time.body
    body.energise(True)
    body.set_targets([0.2] * 6)
    time.run(1.0)
    list(bus.receive(feetech.write(1, feetech.TORQUE_ENABLE, 1), None))
    assert body.felt().commanders == [Commander.WIRE] + [Commander.SIM] * 5
    list(bus.receive(feetech.goals({1: 2048 + 300}), None))
    body.set_targets([-0.2] * 6)
    body.energise(False)
    time.run(1.0)
    assert body.felt().commanders == [Commander.WIRE] + [Commander.NONE] * 5
    assert body.felt().position[0] == pytest.approx(300 * math.tau / 4096, abs=0.02)
    list(bus.receive(feetech.LIMP, None))
    assert set(body.felt().commanders) == {Commander.NONE}
    body.energise(True)
    list(bus.receive(feetech.LIMP, None))  # releases only the axes that the wire holds
    assert set(body.felt().commanders) == {Commander.SIM}


def test_an_arm_whose_controller_runs_a_program_follows_the_program() -> None:
    time, controller = ticking("ur5e")
    body = time.body
    body.energise(True)
    body.set_targets([0.4, -1.57, 1.57, -1.57, -1.57, 0.0])
    time.run(0.1)
    controller.start_program(Standing)
    assert set(body.felt().commanders) == {Commander.WIRE}
    time.run(0.5)
    stood = body.felt().position[0]
    assert 0.0 < stood < 0.39  # it was on its way when control was taken away
    body.set_targets([1.0, -1.57, 1.57, -1.57, -1.57, 0.0])
    time.run(0.5)
    assert body.felt().position[0] == pytest.approx(stood, abs=0.01)
    controller.stop_program()
    body.set_targets([1.0, -1.57, 1.57, -1.57, -1.57, 0.0])
    time.run(0.5)
    assert set(body.felt().commanders) == {Commander.NONE}  # control was taken back, not returned
    assert body.felt().position[0] == pytest.approx(stood, abs=0.01)


def test_a_gripper_with_a_goal_of_the_wires_follows_the_wire() -> None:
    time, twin = ticking("robotiq_2f85")
    body = time.body
    body.energise(True)
    body.set_targets([0.5])
    time.run(1.0)
    assert body.felt().position[0] == pytest.approx(0.5)
    twin.write(0, robotiq.ACTIVATE.registers())
    assert body.felt().commanders == (Commander.WIRE,)
    time.run(2.0)
    assert body.felt().commanders == (Commander.NONE,)
    assert body.felt().position[0] == pytest.approx(3 / 255)  # the activation has opened it
    twin.write(0, robotiq.Command(go_to=True, position=100).registers())
    body.energise(True)
    body.set_targets([0.8])
    time.run(1.0)
    assert body.felt().commanders == (Commander.WIRE,)
    assert body.felt().position[0] == pytest.approx(100 / 255)


# -- the simulation control itself


@asynccontextmanager
async def open_control(path: Path, body: Body) -> AsyncIterator[str]:
    log = WireLog(str(path / "control.ndjson"))
    control = SimulationControl(str(path / "control"), body, log)
    try:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(control.serve)
            yield str(path / "control")
            nursery.cancel_scope.cancel()
    finally:
        control.close()
        log.close()


def test_a_client_that_sends_garbage_is_disconnected_and_others_are_not(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_control(tmp_path, ticking("so101")[0].body) as path:
            good = SimulationClient(path)
            bad = await trio.open_unix_socket(path)
            await bad.send_all(b"\xff" * 64)
            assert await bad.receive_some(1) == b""
            axes = (await good.call(p.Handshake(0), p.Axes, ANSWER_S)).axes
            assert axes[0] == "shoulder_pan"
            good.tell(p.Aim(0, (math.nan,) * 6))
            good.tell(p.Aim(0, (0.1,)))
            assert (await good.call(p.Read(0), p.Sample, ANSWER_S)).commanders == (0,) * 6
            good.close()
            await bad.aclose()
        with pytest.raises(WireDown, match="does not run"):
            SimulationClient(path)

    trio.run(main)
    assert not (tmp_path / "control").exists()


def test_saf_002_a_clients_command_after_anothers_safe_state_is_ignored(tmp_path: Path) -> None:
    time, _ = ticking("ur5e")

    async def main() -> None:
        async with open_control(tmp_path, time.body) as path:
            gone, guardian = SimulationClient(path), SimulationClient(path)
            stood = (await gone.call(p.Take(0), p.Sample, ANSWER_S)).position
            goal = tuple(rad + 0.2 for rad in stood)

            async def aim() -> float:
                """Return how far the first joint moves to the goal."""
                gone.tell(p.Aim(0, goal))
                await gone.call(p.Read(0), p.Sample, ANSWER_S)
                before = time.body.felt().position[0]
                time.run(1.0)
                return time.body.felt().position[0] - before

            await guardian.call(p.Safe(0, p.HOLD), p.Sample, ANSWER_S)
            assert abs(await aim()) < 0.01
            await gone.call(p.Take(0), p.Sample, ANSWER_S)
            await gone.call(p.Safe(0, p.HOLD), p.Sample, ANSWER_S)  # its own axes, which go on from there
            assert await aim() > 0.1
            gone.close()
            guardian.close()

    trio.run(main)
    kinds = [entry.kind for entry in ReadLog(tmp_path / "control.ndjson").entries()]
    assert kinds == ["enable", "safe", "enable", "safe", "setpoint"]


def test_the_scene_can_be_taken_away_and_posed_elsewhere(tmp_path: Path) -> None:
    async def main() -> tuple[bytes, tuple[float, ...], tuple[float, ...]]:
        async with open_control(tmp_path, ticking("koch")[0].body) as path:
            client = SimulationClient(path)
            file = (await client.call(p.GetModel(0), p.Model, ANSWER_S)).binary
            pose = (await client.call(p.GetPose(0), p.Pose, ANSWER_S)).qpos
            sample = await client.call(p.Read(0), p.Sample, ANSWER_S)
            client.close()
            return file, pose, sample.position

    file, pose, position = trio.run(main)
    model = mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": file})
    assert model.nq == len(pose)
    assert model.nlight == 2
    assert pose == position


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        (p.Render(0, 4000, 48, ""), "4000 x 48 pixels. Ask for at most"),
        (p.Render(0, 0, 48, ""), "0 x 48 pixels. Ask for at most"),
        (
            p.Render(0, 64, 48, "nose"),
            "no camera 'nose'. There are front, side, top, wrist, and None for the whole robot",
        ),
    ],
)
def test_a_picture_that_cannot_be_is_refused(tmp_path: Path, request_: p.Request, text: str) -> None:
    async def main() -> None:
        async with open_control(tmp_path, ticking("so101")[0].body) as path:
            client = SimulationClient(path)
            with pytest.raises(Refusal, match=text):
                await client.call(request_, p.Picture, ANSWER_S)
            client.close()

    trio.run(main)


# -- OpenGL


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("", r"no OpenGL .*Install libegl1 \(egl\) or libosmesa6 \(osmesa\): apt install libegl1"),
        ("glfw", r"no OpenGL .*Install libegl1 \(egl\) or libosmesa6 \(osmesa\)"),
        ("EGL", r"no OpenGL .*Install libegl1 \(egl\): apt install libegl1"),
        ("osmesa", r"no OpenGL .*Install libosmesa6 \(osmesa\): apt install libosmesa6"),
        (
            "mesa",
            r"MUJOCO_GL is 'mesa'\. Unset it, or use MUJOCO_GL=egl \(Debian package libegl1\) or MUJOCO_GL=osmesa",
        ),
    ],
)
def test_on_a_machine_that_cannot_draw_the_package_is_named(
    monkeypatch: pytest.MonkeyPatch, word: str, text: str
) -> None:
    missing = {name: (("libNoSuchThing.so.1",), package) for name, (_, package) in renderer.LIBRARIES.items()}
    monkeypatch.setattr(renderer, "LIBRARIES", missing)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("MUJOCO_GL", word)
    with pytest.raises(renderer.CannotRender, match=text):
        renderer.open_gl(64, 48)
    assert os.environ["MUJOCO_GL"] == word


def test_mujoco_works_with_any_opengl_setting() -> None:
    script = "from strands_actors.drivers.common import physics; import os; print(os.environ['MUJOCO_GL'])"
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env={**os.environ, "MUJOCO_GL": "impossible", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    assert (done.stdout, done.returncode) == ("impossible\n", 0), done.stderr


def test_physics_is_not_timed_part_by_part() -> None:
    """MuJoCo's bindings time every part of a step, which takes a sixth of its time."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    step = data.timer[mujoco.mjtTimer.mjTIMER_STEP]
    assert (step.number, step.duration) == (100, 0.0)
