"""``Robot(name)`` is a simulation with the same tree and verbs as a real robot. The tests use its verbs
and pictures, and the real driver on its wire.
"""

from __future__ import annotations

import ctypes
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trio

from strands_actors import Robot, open_robot
from strands_actors.caller.handle.robot import RealRobot, SimRobot
from strands_actors.caller.processes import twin_process
from strands_actors.caller.session.tree import RobotTree
from strands_actors.simulation.handle import SimulationError
from strands_actors.testing import WireLog
from tests.answers import json_of, pids, state, status, task_ended, until, why
from tests.trees import connected

from .helpers import at

ROOT = Path(__file__).parents[2]

NewSim = Callable[..., SimRobot]
NewArm = Callable[..., RealRobot]

# For each robot: a joint, its target, and the tolerance.
SIMULATED = {
    "so100": ("shoulder_pan", -30.0, 1.0),
    "so101": ("shoulder_pan", 30.0, 1.0),
    "hope_jr": ("wrist_roll", 15.0, 1.0),
    "open_duck_mini": ("head_yaw", 25.0, 1.0),
    "koch": ("shoulder_pan", 20.0, 1.0),
    "ur5e": ("shoulder_pan_joint", 1.0, 0.01),  # much farther than a real robot may be sent in one command
    "xarm7": ("joint4", 1.5, 0.01),
    "robotiq_2f85": ("gripper", 0.5, 0.01),
    "kuka_iiwa": ("joint1", 1.0, 0.01),
    "kinova_gen3": ("joint_1", 1.0, 0.01),
    "rby1": ("head_0", 1.0, 0.01),
    "spot": ("arm_sh0", 1.0, 0.01),
    "panda": ("joint1", 1.0, 0.01),
    "fr3": ("fr3_joint6", 2.0, 0.01),
    "fr3_v2": ("fr3v2_joint4", -1.0, 0.01),
}


@pytest.fixture
def new_sim(run_dir: Path) -> Iterator[NewSim]:
    """Make a simulation. Afterwards, clean up all of them, with the robots on their wires."""
    made: list[SimRobot] = []

    def new(robot: str = "so101", **keywords: Any) -> SimRobot:
        made.append(Robot(robot, **keywords))
        return made[-1]

    yield new
    for sim in made:
        sim.cleanup()


@pytest.fixture
def new_arm(new_sim: NewSim) -> Iterator[NewArm]:
    """Connect the real driver to a simulation's wire."""
    made: list[RealRobot] = []

    def new(sim: SimRobot, robot: str = "so101") -> RealRobot:
        made.append(Robot(robot, mode="real", transport="twin", sim=sim))
        return connected(made[-1])

    yield new
    for arm in made:
        arm.cleanup()


# -- the verbs


@pytest.mark.quick_cases(5)
@pytest.mark.parametrize("robot", SIMULATED)
def test_a_robot_is_simulated_from_its_first_verb_on(new_sim: NewSim, robot: str) -> None:
    joint, place, within = SIMULATED[robot]
    sim = new_sim(robot)
    assert sim.tree() is None  # no process was started
    assert sim.get_task_status()["status"] == "success"
    answer = json_of(sim.send_action({joint: place}))
    rows = [row for row in answer.values() if isinstance(row, dict)]
    values = (*(row.get(joint) for row in rows), answer.get(joint))
    assert place in values or joint in answer.get("joint_speeds", ())
    at(sim, joint, place, within)
    assert "is not a" in why(sim.send_action({"left_wheel": 1.0}))
    assert "finite" in why(sim.send_action({joint: math.nan}))
    assert state(sim) == "armed"


def test_a_target_beyond_a_joints_range_is_refused(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": 30.0}))
    json_of(sim.step(1000))
    assert why(sim.send_action({"shoulder_pan": 400.0})).startswith(
        "move: shoulder_pan 400.0 deg is past 110.1. Stay within -110.0..110.1"
    )
    for huge in (1e300, 1e11, -1e9):
        assert "move: shoulder_pan" in why(sim.send_action({"shoulder_pan": huge}))
    assert json_of(sim.step(1000))["position"]["shoulder_lift"] == pytest.approx(30.0, abs=3.0)


def test_a_connected_robot_holds_its_position_before_the_first_command(new_sim: NewSim) -> None:
    sim = new_sim(arm=False)
    assert sim.connect_eagerly() is None
    began = sim.get_observation()
    assert json_of(sim.step(2000))["position"] == pytest.approx(began, abs=3.0), "the joints keep their torque"


def test_with_gated_false_nothing_is_refused(new_sim: NewSim) -> None:
    sim = new_sim(gated=False)
    assert "is too large for the physics" in why(sim.send_action({"shoulder_pan": 1e11}))
    json_of(sim.send_action({"shoulder_pan": 400.0}))  # the joint's limit stops it
    until(lambda: sim.get_observation()["shoulder_pan"] > 100.0, "the joint reaches its limit")
    policy = iter(range(-50, 1000, 25))  # steps that are too large for any servo
    json_of(sim.run_policy(lambda _: {"shoulder_pan": next(policy)}, n_steps=5, control_frequency=50.0))
    ended = task_ended(sim)
    assert (ended["exit_reason"], ended["steps"], ended["refusal"]) == ("n_steps", 5, None)


def test_a_stop_makes_the_robot_limp_and_only_a_resume_moves_it_again(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    at(sim, "shoulder_lift", -40.0, 5.0)
    report = json_of(sim.stop())
    assert (report["stopped"], report["safe_state"], report["unconfirmed"]) == (True, "limp", [])
    until(lambda: sim.get_observation()["shoulder_lift"] > -30.0, "the arm falls")
    assert "disarmed" in why(sim.send_action({"shoulder_lift": -40.0}))
    json_of(sim.resume())
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    at(sim, "shoulder_lift", -40.0, 5.0)


def test_a_reset_returns_to_the_first_position(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 60.0, "gripper": 80.0}))
    at(sim, "shoulder_pan", 60.0)
    began = json_of(sim.reset())["position"]
    assert abs(began["shoulder_pan"]) < 1.0
    json_of(sim.send_action({"gripper": 50.0}))
    at(sim, "gripper", 50.0)
    assert abs(sim.get_observation()["shoulder_pan"]) < 1.0  # no earlier target is applied again


def test_saf_003_008_a_simulation_whose_wire_is_killed_becomes_limp_and_waits(
    new_sim: NewSim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = WireLog(tmp_path / "wire.ndjson")
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log.path))
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    wire = pids(sim)["wire"]
    os.kill(wire, signal.SIGKILL)
    until(lambda: [entry for entry in control(log) if entry.kind == "safe"], "the root's stop channel writes")
    until(lambda: state(sim) == "disarmed" and pids(sim)["wire"] != wire, "another wire, disarmed")
    assert "disarmed" in why(sim.send_action({"shoulder_lift": 0.0}))
    kinds = [entry.kind for entry in control(log)]
    assert "setpoint" not in kinds[kinds.index("safe") :]
    json_of(sim.resume())
    json_of(sim.send_action({"shoulder_lift": -20.0}))


def control(log: WireLog) -> list[Any]:
    return [entry for entry in log.entries() if entry.sender == "control"]


def test_a_cleaned_up_simulation_has_no_processes_and_refuses_verbs(new_sim: NewSim) -> None:
    sim, second = new_sim(), new_sim()
    for one in (sim, second):
        assert one.connect_eagerly() is None
    assert (sim.name, second.name) == ("so101", "so101-2")
    processes = pids(sim)
    assert processes["twin"] != pids(second)["twin"]
    sim.cleanup()
    for role in ("root", "twin"):  # children of this process
        with pytest.raises(ProcessLookupError):
            os.kill(processes[role], 0)
    assert "cleaned up" in why(sim.send_action({"shoulder_pan": 1.0}))
    assert sim.get_observation() == {}
    with pytest.raises(SimulationError, match=r"render: the simulation was cleaned up\. Make a new one"):
        sim.render()
    json_of(second.send_action({"shoulder_pan": 5.0}))


def test_wire_and_root_of_a_simulation_do_not_load_the_physics(new_sim: NewSim) -> None:
    sim = new_sim()
    assert sim.connect_eagerly() is None
    mapped = {role: Path(f"/proc/{pid}/maps").read_text() for role, pid in pids(sim).items()}
    assert "mujoco" in mapped["twin"]
    for role in ("root", "wire"):
        assert "mujoco" not in mapped[role]
        assert "/numpy" not in mapped[role]


def test_a_trio_program_can_use_a_simulation(run_dir: Path) -> None:
    async def main() -> dict[str, float]:
        async with open_robot("so101") as sim, open_arm(sim) as arm:
            await arm.send_action({"shoulder_pan": 20.0})
            async for observation in sim.observations(hz=30):
                if abs(observation["shoulder_pan"] - 20.0) < 1.0:
                    return observation
        raise AssertionError("not reached")

    def open_arm(sim: RobotTree) -> Any:
        return open_robot("so101", mode="real", transport="twin", sim=sim)

    async def in_time() -> dict[str, float]:
        with trio.fail_after(60.0):
            return await main()

    assert abs(trio.run(in_time)["shoulder_pan"] - 20.0) < 1.0


# -- the real driver on a simulation's wire


def test_the_example_of_the_page_prints_the_text_on_the_page(run_dir: Path, tmp_path: Path) -> None:
    output, errors = tmp_path / "out", tmp_path / "err"
    # files instead of pipes, because the twin outlives the script for a moment
    with output.open("w") as out, errors.open("w") as err:
        done = subprocess.run(
            [sys.executable, str(ROOT / "examples" / "twin.py")],
            stdout=out,
            stderr=err,
            timeout=60,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )
    assert (done.returncode, errors.read_text()) == (0, "")
    assert output.read_text() == (
        "{'status': 'success', 'content': [{'json': {'commanded': {'shoulder_pan': 10.0}, "
        "'unit': 'degrees (gripper: percent open)'}}]}\n"
    )


@pytest.mark.parametrize(
    ("robot", "joint", "step"),
    [
        ("so101", "shoulder_pan", 10.0),
        ("koch", "wrist_flex", -10.0),
        ("ur5e", "elbow_joint", 0.01),
        ("xarm7", "joint4", 0.02),
        ("rby1", "torso_5", 0.05),
        ("robotiq_2f85", "gripper", 0.4),
    ],
)
def test_motion_by_the_real_driver_appears_in_the_simulation(
    new_sim: NewSim, new_arm: NewArm, robot: str, joint: str, step: float
) -> None:
    sim = new_sim(robot)  # the arm uses the simulation first
    arm = new_arm(sim, robot)
    goal = arm.get_observation()[joint] + step
    json_of(arm.send_action({joint: goal}))
    at(sim, joint, goal, abs(step) / 4)
    at(arm, joint, goal, abs(step) / 4)
    assert pids(sim)["twin"] == pids(arm)["twin"]
    assert (sim.name, arm.name) == (f"{robot}-2", robot)


def test_joints_that_the_wire_energises_follow_the_wire(new_sim: NewSim, new_arm: NewArm) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 20.0}))
    at(sim, "shoulder_pan", 20.0)
    arm = new_arm(sim)
    at(arm, "shoulder_pan", 20.0)  # the joint does not jump when the commander changes
    until(lambda: status(sim)["faults"].get("gripper"), "the simulation reports the held joint")
    refused = why(sim.send_action({"shoulder_pan": 0.0}))
    assert "shoulder_pan is held by the robot on its wire" in refused
    assert "stop() and resume()" in refused
    stopped = sim.stop()
    assert "not confirmed by shoulder_pan (id 1): held by the robot on its wire" in why(stopped)
    json_of(arm.send_action({"shoulder_pan": 10.0}))
    at(sim, "shoulder_pan", 10.0)
    json_of(arm.stop())
    assert "reset" not in why(sim.send_action({"shoulder_pan": 0.0}))
    json_of(sim.resume())
    json_of(sim.send_action({"shoulder_pan": -15.0}))
    at(arm, "shoulder_pan", -15.0)  # the arm's positions are still read
    json_of(sim.stop())
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    at(sim, "shoulder_pan", 5.0)
    assert "not confirmed by shoulder_pan (id 1): held by the robot on its wire" in why(sim.reset())


def test_the_arm_loses_its_connection_when_its_simulation_is_cleaned_up(new_sim: NewSim, new_arm: NewArm) -> None:
    sim = new_sim()
    arm = new_arm(sim)
    sim.cleanup()
    until(lambda: not status(arm)["connected"], "the arm notices")
    assert "not connected" in why(arm.send_action({"shoulder_pan": 1.0}))
    arm.cleanup()
    late = Robot("so101", mode="real", transport="twin", sim=sim)
    assert late.connect_eagerly() == "connect: the simulation was cleaned up. Make a new one"


# -- pictures


def has_egl() -> bool:
    """Look for EGL in the system, independently of the code under test."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    return bool(list(Path("/usr/share/glvnd/egl_vendor.d").glob("*.json")))


def accent(picture: Any) -> Any:
    """Return the pixels that are orange, which is the colour of the last link."""
    red, green, blue = (picture[:, :, channel].astype(int) for channel in range(3))
    return (red > 150) & (green < 0.75 * red) & (blue < 0.6 * red)


def test_a_picture_shows_the_whole_robot_and_its_motion(new_sim: NewSim, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 40.0}))
    at(sim, "shoulder_pan", 40.0)
    if not has_egl():
        with pytest.raises(SimulationError, match=r"render: no OpenGL .* Install libegl1 \(egl\) or libosmesa6"):
            sim.render()
        return
    before = sim.render()
    assert (before.shape, before.dtype) == ((480, 640, 3), np.uint8)
    assert before.flags.writeable
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 500  # the picture has light and shade
    assert 100 < accent(before).sum() < 0.2 * before[:, :, 0].size
    for edge in (before[0], before[-1], before[:, 0], before[:, -1]):
        assert not accent(edge[None]).any()
    json_of(sim.send_action({"shoulder_pan": -40.0}))
    at(sim, "shoulder_pan", -40.0)
    after = sim.render(width=320, height=240, camera="top")
    assert after.shape == (240, 320, 3)
    again = sim.render()
    moved = np.argwhere(accent(again)).mean(axis=0) - np.argwhere(accent(before)).mean(axis=0)
    assert np.linalg.norm(moved) > 30  # pixels
    assert state(sim) == "armed"  # rendering does not block the tree
    with pytest.raises(SimulationError, match=r"render: no camera 'nose'\. There are front, side, top"):
        sim.render(camera="nose")


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("impossible", r"MUJOCO_GL is 'impossible'. Unset it, or use MUJOCO_GL=egl \(Debian package libegl1\) or "),
        ("off", "MUJOCO_GL is 'off'. Unset it, or use MUJOCO_GL=egl"),
    ],
)
def test_without_opengl_the_error_names_the_package_and_the_robot_moves(
    new_sim: NewSim, monkeypatch: pytest.MonkeyPatch, word: str, text: str
) -> None:
    monkeypatch.setenv("MUJOCO_GL", word)
    sim = new_sim()
    with pytest.raises(SimulationError, match=text) as refusal:
        sim.render()
    assert "libosmesa6" in str(refusal.value)
    json_of(sim.send_action({"shoulder_pan": 5.0}))
    at(sim, "shoulder_pan", 5.0)


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ((0, 480), "render: the picture's size is"),
        ((640, 0.5), "render: the picture's size is"),
        ((640, -1), "render: the picture's size is"),
        ((100_000, 480), "render: a picture of 100000 x 480 pixels"),
    ],
)
def test_a_picture_of_an_invalid_size_is_refused(new_sim: NewSim, size: tuple[Any, Any], message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        new_sim().render(*size)


def test_without_a_display_there_is_no_window(new_sim: NewSim, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SimulationError, match=r"view: there is no display \(DISPLAY is not set\). Use render\(\)"):
        new_sim().view()


def test_a_display_that_does_not_answer_opens_no_window(
    new_sim: NewSim, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(SimulationError, match="view: the viewer did not open"):
        new_sim().view()


# -- faster than the clock


def test_a_step_lets_simulated_time_pass_faster_than_real_time(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 60.0}))
    began_s = time.monotonic()
    before = json_of(sim.step())
    after = json_of(sim.step(50_000))
    took_s = time.monotonic() - began_s
    assert 100.0 <= after["sim_time_s"] - before["sim_time_s"] <= 100.0 + took_s
    assert took_s < 50.0
    assert abs(after["position"]["shoulder_pan"] - 60.0) < 1.0
    at(sim, "shoulder_pan", 60.0)
    time.sleep(0.5)
    then = json_of(sim.step())["sim_time_s"] - after["sim_time_s"]
    assert 0.4 < then < 20.0, "between steps the simulation runs in real time"


def test_a_target_that_was_sent_before_counts_from_the_first_step_on(new_sim: NewSim) -> None:
    sim = new_sim()
    for target in [-40.0, 40.0] * 20:
        json_of(sim.send_action({"shoulder_pan": target}))
        assert abs(json_of(sim.step(2000))["position"]["shoulder_pan"] - target) < 1.0


def test_an_action_and_the_steps_after_it_are_one_call(new_sim: NewSim) -> None:
    sim = new_sim()
    for target in [-40.0, 40.0] * 20:
        assert abs(json_of(sim.step(2000, {"shoulder_pan": target}))["position"]["shoulder_pan"] - target) < 1.0
    before_s = json_of(sim.step())["sim_time_s"]
    assert "elbow" in why(sim.step(50_000, {"elbow": 1.0}))
    assert "the action is a list" in why(sim.step(50_000, [1.0]))  # type: ignore[arg-type]
    assert json_of(sim.step())["sim_time_s"] < before_s + 50.0, "none of the refused steps ran"
    json_of(sim.stop())
    assert "Call resume() first" in why(sim.step(50_000, {"shoulder_pan": 0.0}))
    json_of(sim.resume())
    json_of(sim.step(1, {"shoulder_pan": 0.0}))


def test_a_limp_robot_falls_during_steps(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    json_of(sim.step(2000))
    json_of(sim.stop())
    assert json_of(sim.step(2000))["position"]["shoulder_lift"] > -30.0


@pytest.mark.parametrize("steps", [0, -1, 1.5, True, 100_001, math.inf, "1"])
def test_an_invalid_number_of_steps_is_refused(new_sim: NewSim, steps: Any) -> None:
    assert "Give a whole number, 1 to 100000" in why(new_sim().step(steps))


def test_steps_are_refused_while_the_robot_on_the_wire_is_energised(new_sim: NewSim, new_arm: NewArm) -> None:
    sim = new_sim()
    arm = new_arm(sim)
    json_of(arm.send_action({"shoulder_pan": 1.0}))
    assert "step: the robot on the wire is energised" in why(sim.step(10))
    json_of(arm.stop())
    json_of(sim.step(10))


@pytest.mark.parametrize("robot", ["robotiq_2f85", "ur5e", "xarm7", "rby1", "spot", "panda"])
def test_other_robots_step_too(robot: str, new_sim: NewSim) -> None:
    sim = new_sim(robot)
    axis, value = {
        "robotiq_2f85": ("gripper", 0.5),
        "ur5e": ("shoulder_pan_joint", 0.5),
        "xarm7": ("joint1", 0.5),
        "rby1": ("right_arm_0", 0.5),
        "spot": ("arm_sh0", 0.5),
        "panda": ("joint1", 0.5),
    }[robot]
    json_of(sim.send_action({axis: value}))
    began_s = time.monotonic()
    stepped = json_of(sim.step(2000))
    assert time.monotonic() - began_s < 3.0
    assert abs(stepped["position"][axis] - value) < 0.05 * value


def test_a_simulation_of_a_trio_program_steps(run_dir: Path) -> None:
    async def main() -> None:
        async with open_robot("so101") as robot:
            await robot.send_action({"shoulder_pan": 30.0})
            stepped = json_of(await robot.step(steps=2000))
            assert abs(stepped["position"]["shoulder_pan"] - 30.0) < 1.0
            stepped = json_of(await robot.step(steps=2000, action={"shoulder_pan": -30.0}))
            assert abs(stepped["position"]["shoulder_pan"] + 30.0) < 1.0
            assert "the action is a list" in why(await robot.step(steps=2000, action=[1.0]))
            with pytest.raises(AttributeError):
                robot.release_sport_mode  # noqa: B018

    trio.run(main)


def test_a_simulation_that_starts_too_late_is_reported_as_not_started(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sim = Robot("so101")
    try:
        with monkeypatch.context() as impatient:
            impatient.setattr(twin_process, "START_S", 0.0)
            assert sim.connect_eagerly() == "connect: the twin did not start"
        assert sim.connect_eagerly() is None
        assert json_of(sim.step(1))["sim_time_s"] > 0
    finally:
        sim.cleanup()


def test_an_observation_after_a_step_matches_the_result_of_the_step(run_dir: Path) -> None:
    with Robot("so101") as sim:
        for goal in (20.0, -20.0, 20.0, -20.0):
            stepped = json_of(sim.step(150, {"shoulder_pan": goal}))["position"]["shoulder_pan"]
            seen = sim.get_observation()["shoulder_pan"]
            # The physics continues towards the goal meanwhile, and never away from it.
            assert abs(seen - goal) <= abs(stepped - goal) + 0.5
