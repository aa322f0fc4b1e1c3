"""``Robot(name)``: a simulation with the same tree and verbs, its pictures, and the real driver on
its wire."""

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

# a joint, where it is sent, and within what it gets there
SIMULATED = {
    "so100": ("shoulder_pan", -30.0, 1.0),
    "so101": ("shoulder_pan", 30.0, 1.0),
    "hope_jr": ("wrist_roll", 15.0, 1.0),
    "open_duck_mini": ("head_yaw", 25.0, 1.0),
    "koch": ("shoulder_pan", 20.0, 1.0),
    "ur5e": ("shoulder_pan_joint", 1.0, 0.01),  # far more than a real one may be sent in one go
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
    """Make a simulation. It and whatever is on its wire is cleaned up."""
    made: list[SimRobot] = []

    def new(robot: str = "so101", **keywords: Any) -> SimRobot:
        made.append(Robot(robot, **keywords))
        return made[-1]

    yield new
    for sim in made:
        sim.cleanup()


@pytest.fixture
def new_arm(new_sim: NewSim) -> Iterator[NewArm]:
    """The real driver on a simulation's wire, connected."""
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
    assert sim.tree() is None  # nothing was started
    assert sim.get_task_status()["status"] == "success"
    answer = json_of(sim.send_action({joint: place}))
    rows = [row for row in answer.values() if isinstance(row, dict)]
    told = (*(row.get(joint) for row in rows), answer.get(joint))
    assert place in told or joint in answer.get("joint_speeds", ())
    at(sim, joint, place, within)
    assert "is not a" in why(sim.send_action({"left_wheel": 1.0}))
    assert "finite" in why(sim.send_action({joint: math.nan}))
    assert state(sim) == "armed"


def test_a_target_is_gated_by_its_joints_range(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": 30.0}))
    json_of(sim.step(1000))
    assert why(sim.send_action({"shoulder_pan": 400.0})).startswith(
        "move: shoulder_pan 400.0 deg is past 110.1. stay within -110.0..110.1"
    )
    for huge in (1e300, 1e11, -1e9):
        assert "move: shoulder_pan" in why(sim.send_action({"shoulder_pan": huge}))
    assert json_of(sim.step(1000))["position"]["shoulder_lift"] == pytest.approx(30.0, abs=3.0)


def test_it_holds_where_it_begins_before_it_is_commanded(new_sim: NewSim) -> None:
    sim = new_sim(arm=False)
    assert sim.connect_eagerly() is None
    began = sim.get_observation()
    assert json_of(sim.step(2000))["position"] == pytest.approx(began, abs=3.0), "not let go of"


def test_nothing_is_gated_for_who_asks(new_sim: NewSim) -> None:
    sim = new_sim(gated=False)
    assert "farther than physics can be computed" in why(sim.send_action({"shoulder_pan": 1e11}))
    json_of(sim.send_action({"shoulder_pan": 400.0}))  # the joint's own end stops it
    until(lambda: sim.get_observation()["shoulder_pan"] > 100.0, "it goes as far as it can")
    policy = iter(range(-50, 1000, 25))  # steps that no servo can follow
    json_of(sim.run_policy(lambda _: {"shoulder_pan": next(policy)}, n_steps=5, control_frequency=50.0))
    ended = task_ended(sim)
    assert (ended["exit_reason"], ended["steps"], ended["refusal"]) == ("n_steps", 5, None)


def test_a_stop_lets_go_and_only_a_resume_moves_again(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    at(sim, "shoulder_lift", -40.0, 5.0)
    report = json_of(sim.stop())
    assert (report["stopped"], report["safe_state"], report["unconfirmed"]) == (True, "limp", [])
    until(lambda: sim.get_observation()["shoulder_lift"] > -30.0, "it falls")
    assert "disarmed" in why(sim.send_action({"shoulder_lift": -40.0}))
    json_of(sim.resume())
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    at(sim, "shoulder_lift", -40.0, 5.0)


def test_a_reset_is_a_fresh_start(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 60.0, "gripper": 80.0}))
    at(sim, "shoulder_pan", 60.0)
    began = json_of(sim.reset())["position"]
    assert abs(began["shoulder_pan"]) < 1.0
    json_of(sim.send_action({"gripper": 50.0}))
    at(sim, "gripper", 50.0)
    assert abs(sim.get_observation()["shoulder_pan"]) < 1.0  # no old target comes back


def test_saf_003_008_a_simulation_whose_wire_is_killed_is_let_go_of_and_waits(
    new_sim: NewSim, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = WireLog(tmp_path / "wire.ndjson")
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log.path))
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    wire = pids(sim)["wire"]
    os.kill(wire, signal.SIGKILL)
    until(lambda: [entry for entry in control(log) if entry.kind == "safe"], "the root's own path writes")
    until(lambda: state(sim) == "disarmed" and pids(sim)["wire"] != wire, "another wire, disarmed")
    assert "disarmed" in why(sim.send_action({"shoulder_lift": 0.0}))
    kinds = [entry.kind for entry in control(log)]
    assert "setpoint" not in kinds[kinds.index("safe") :]
    json_of(sim.resume())
    json_of(sim.send_action({"shoulder_lift": -20.0}))


def control(log: WireLog) -> list[Any]:
    return [entry for entry in log.entries() if entry.sender == "control"]


def test_what_is_cleaned_up_is_gone(new_sim: NewSim) -> None:
    sim, other = new_sim(), new_sim()
    for one in (sim, other):
        assert one.connect_eagerly() is None
    assert (sim.name, other.name) == ("so101", "so101-2")
    processes = pids(sim)
    assert processes["twin"] != pids(other)["twin"]
    sim.cleanup()
    for role in ("root", "twin"):  # children of this process
        with pytest.raises(ProcessLookupError):
            os.kill(processes[role], 0)
    assert "cleaned up" in why(sim.send_action({"shoulder_pan": 1.0}))
    assert sim.get_observation() == {}
    with pytest.raises(SimulationError, match=r"render: the simulation was cleaned up\. make a new one"):
        sim.render()
    json_of(other.send_action({"shoulder_pan": 5.0}))


def test_wire_and_root_of_a_simulation_know_no_physics(new_sim: NewSim) -> None:
    sim = new_sim()
    assert sim.connect_eagerly() is None
    mapped = {role: Path(f"/proc/{pid}/maps").read_text() for role, pid in pids(sim).items()}
    assert "mujoco" in mapped["twin"]
    for role in ("root", "wire"):
        assert "mujoco" not in mapped[role]
        assert "/numpy" not in mapped[role]


def test_a_trio_program_has_it_too(run_dir: Path) -> None:
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


def test_the_pages_example_prints_what_the_page_says(run_dir: Path, tmp_path: Path) -> None:
    said, complained = tmp_path / "out", tmp_path / "err"
    with said.open("w") as out, complained.open("w") as err:  # no pipes: the twin outlives the script for a moment
        done = subprocess.run(
            [sys.executable, str(ROOT / "examples" / "twin.py")],
            stdout=out,
            stderr=err,
            timeout=60,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )
    assert (done.returncode, complained.read_text()) == (0, "")
    assert said.read_text() == (
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
def test_what_the_real_driver_does_is_seen_in_the_simulation(
    new_sim: NewSim, new_arm: NewArm, robot: str, joint: str, step: float
) -> None:
    sim = new_sim(robot)  # used by the arm before it is used itself
    arm = new_arm(sim, robot)
    goal = arm.get_observation()[joint] + step
    json_of(arm.send_action({joint: goal}))
    at(sim, joint, goal, abs(step) / 4)
    at(arm, joint, goal, abs(step) / 4)
    assert pids(sim)["twin"] == pids(arm)["twin"]
    assert (sim.name, arm.name) == (f"{robot}-2", robot)


def test_what_is_energised_on_the_wire_follows_the_wire(new_sim: NewSim, new_arm: NewArm) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 20.0}))
    at(sim, "shoulder_pan", 20.0)
    arm = new_arm(sim)
    at(arm, "shoulder_pan", 20.0)  # no jump when it changes hands
    until(lambda: status(sim)["faults"].get("gripper"), "the simulation has seen it")
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
    at(arm, "shoulder_pan", -15.0)  # whose positions are still read
    json_of(sim.stop())
    json_of(arm.resume())
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    at(sim, "shoulder_pan", 5.0)
    assert "not confirmed by shoulder_pan (id 1): held by the robot on its wire" in why(sim.reset())


def test_the_arm_goes_when_its_simulation_goes(new_sim: NewSim, new_arm: NewArm) -> None:
    sim = new_sim()
    arm = new_arm(sim)
    sim.cleanup()
    until(lambda: not status(arm)["connected"], "the arm notices")
    assert "not connected" in why(arm.send_action({"shoulder_pan": 1.0}))
    arm.cleanup()
    late = Robot("so101", mode="real", transport="twin", sim=sim)
    assert late.connect_eagerly() == "connect: the simulation was cleaned up. make a new one"


# -- pictures


def has_egl() -> bool:
    """Asked of the system, not of what is tested."""
    try:
        ctypes.CDLL("libEGL.so.1")
    except OSError:
        return False
    return bool(list(Path("/usr/share/glvnd/egl_vendor.d").glob("*.json")))


def accent(picture: Any) -> Any:
    """Where the picture is orange, as the last link is."""
    red, green, blue = (picture[:, :, at].astype(int) for at in range(3))
    return (red > 150) & (green < 0.75 * red) & (blue < 0.6 * red)


def test_a_picture_shows_the_whole_robot_and_what_it_does(new_sim: NewSim, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    sim = new_sim()
    json_of(sim.send_action({"shoulder_pan": 40.0}))
    at(sim, "shoulder_pan", 40.0)
    if not has_egl():
        with pytest.raises(SimulationError, match=r"render: no OpenGL .* install libegl1 \(egl\) or libosmesa6"):
            sim.render()
        return
    before = sim.render()
    assert (before.shape, before.dtype) == ((480, 640, 3), np.uint8)
    assert before.flags.writeable
    assert len(np.unique(before.reshape(-1, 3), axis=0)) > 500  # light and shade
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
    assert state(sim) == "armed"  # a picture keeps nobody waiting
    with pytest.raises(SimulationError, match=r"render: no camera 'nose'\. there are front, side, top"):
        sim.render(camera="nose")


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("impossible", r"MUJOCO_GL is 'impossible'. unset it, or use MUJOCO_GL=egl \(Debian package libegl1\) or "),
        ("off", "MUJOCO_GL is 'off'. unset it, or use MUJOCO_GL=egl"),
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


@pytest.mark.parametrize("size", [(0, 480), (640, 0.5), (640, -1), (100_000, 480)])
def test_a_picture_of_no_size_is_refused(new_sim: NewSim, size: tuple[Any, Any]) -> None:
    with pytest.raises(SimulationError, match="render: a picture of"):
        new_sim().render(*size)


def test_without_a_display_there_is_no_window(new_sim: NewSim, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(SimulationError, match=r"view: there is no display \(DISPLAY is not set\). use render\(\)"):
        new_sim().view()


def test_a_display_that_does_not_answer_opens_no_window(
    new_sim: NewSim, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DISPLAY", ":4711")
    with pytest.raises(SimulationError, match="view: the viewer did not open"):
        new_sim().view()


# -- faster than the clock


def test_a_step_lets_time_pass_that_no_clock_has_seen(new_sim: NewSim) -> None:
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
    assert 0.4 < then < 20.0, "between steps it keeps to the clock"


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
    assert json_of(sim.step())["sim_time_s"] < before_s + 50.0, "no step of those passed"
    json_of(sim.stop())
    assert "call resume() first" in why(sim.step(50_000, {"shoulder_pan": 0.0}))
    json_of(sim.resume())
    json_of(sim.step(1, {"shoulder_pan": 0.0}))


def test_a_robot_that_was_let_go_of_falls_in_no_time(new_sim: NewSim) -> None:
    sim = new_sim()
    json_of(sim.send_action({"shoulder_lift": -40.0}))
    json_of(sim.step(2000))
    json_of(sim.stop())
    assert json_of(sim.step(2000))["position"]["shoulder_lift"] > -30.0


@pytest.mark.parametrize("steps", [0, -1, 1.5, True, 100_001, math.inf, "1"])
def test_steps_are_counted(new_sim: NewSim, steps: Any) -> None:
    assert "give a whole number, 1 to 100000" in why(new_sim().step(steps))


def test_the_time_of_a_robot_on_its_wire_is_the_clocks(new_sim: NewSim, new_arm: NewArm) -> None:
    sim = new_sim()
    arm = new_arm(sim)
    json_of(arm.send_action({"shoulder_pan": 1.0}))
    assert "step: the robot on the wire is energised" in why(sim.step(10))
    json_of(arm.stop())
    json_of(sim.step(10))


@pytest.mark.parametrize("robot", ["robotiq_2f85", "ur5e", "xarm7", "rby1", "spot", "panda"])
def test_other_bodies_step_too(robot: str, new_sim: NewSim) -> None:
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


def test_a_simulation_that_starts_too_late_is_not_taken_for_one_that_serves(
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


def test_what_a_step_did_is_what_is_observed_after_it(run_dir: Path) -> None:
    with Robot("so101") as sim:
        for goal in (20.0, -20.0, 20.0, -20.0):
            stepped = json_of(sim.step(150, {"shoulder_pan": goal}))["position"]["shoulder_pan"]
            seen = sim.get_observation()["shoulder_pan"]
            # The physics goes on meanwhile, towards the goal: never back to where it was.
            assert abs(seen - goal) <= abs(stepped - goal) + 0.5
