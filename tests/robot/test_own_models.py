"""The user's own model, MJCF or URDF, as a robot: it moves and is drawn, without a network."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from strands_actors import Robot, drivers, list_robots, register_robot
from strands_actors.caller.handle.robot import SimRobot
from strands_actors.policies import MockPolicy
from tests.answers import json_of, task_ended, until, why

from .own_models import MJCF, URDF, write_mjcf, write_urdf

HANGING = """<mujoco><compiler angle="radian"/><worldbody><body><joint name="lift" axis="0 1 0" range="-2 2"/>
  <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5"/></body></worldbody>
  <actuator><position joint="lift" kp="400" kv="20"/></actuator>
  <keyframe><key name="home" qpos=".3"/></keyframe></mujoco>"""

New = Callable[..., SimRobot]


@pytest.fixture
def new(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[New]:
    """Make a simulation. Registrations are undone afterwards."""
    list_robots()
    for name in ("_robots", "_aliases"):
        monkeypatch.setattr(drivers, name, getattr(drivers, name).copy())
    made: list[SimRobot] = []

    def make(*args: Any, **keywords: Any) -> SimRobot:
        made.append(Robot(*args, **keywords))
        return made[-1]

    yield make
    for sim in made:
        sim.cleanup()


def after(sim: SimRobot, steps: int) -> dict[str, float]:
    """Return the joints' positions after so many steps."""
    position: dict[str, float] = json_of(sim.step(steps))["position"]
    return position


def test_a_registered_mjcf_moves_and_is_drawn(new: New, tmp_path: Path) -> None:
    register_robot("crane", model_xml=write_mjcf(tmp_path))
    sim = new("crane")
    assert sim.get_observation() == pytest.approx({"turn": 0.0, "reach": 0.0}, abs=0.01)
    json_of(sim.send_action({"turn": 1.0, "reach": 0.05}))
    assert after(sim, 1500) == pytest.approx({"turn": 1.0, "reach": 0.05}, abs=0.02)
    whole = sim.render(96, 72)
    assert whole.shape == (72, 96, 3) and whole.std() > 5
    assert not np.array_equal(whole, sim.render(96, 72, "wrist")), "the model's own camera"
    assert "is not a joint" in why(sim.send_action({"hoist": 1.0})) or "hoist" in why(
        sim.send_action({"hoist": 1.0})
    )
    json_of(sim.run_policy(MockPolicy(0.1), n_steps=10))
    assert task_ended(sim)["exit_reason"] == "n_steps"
    assert json_of(sim.reset())["position"] == pytest.approx({"turn": 0.0, "reach": 0.0}, abs=0.02)


def test_a_model_whose_driver_is_not_registered_yet_can_be_simulated(new: New, tmp_path: Path) -> None:
    register_robot("crane", model_xml=write_mjcf(tmp_path), hardware={"driver": "strands"})
    assert set(new("crane").get_observation()) == {"turn", "reach"}
    with pytest.raises(ValueError, match="crane has no native driver"):
        new("crane", mode="real", port="/dev/ttyACM0")


def test_a_urdf_with_meshes_of_its_package_moves(new: New, tmp_path: Path) -> None:
    sim = new("lifter", urdf_path=write_urdf(tmp_path))
    json_of(sim.send_action({"shoulder": -0.8}))
    assert after(sim, 1500)["shoulder"] == pytest.approx(-0.8, abs=0.05)
    assert sim.render(64, 48).std() > 5


def test_a_known_robot_can_be_simulated_by_the_users_model(new: New, tmp_path: Path) -> None:
    sim = new("so101", urdf_path=write_mjcf(tmp_path), keyframe="folded")
    assert sim.get_observation() == pytest.approx({"turn": 1.2, "reach": -0.05}, abs=0.02)
    json_of(sim.send_action({"turn": 0.0}))
    json_of(sim.step(1000))
    assert json_of(sim.reset())["position"] == pytest.approx({"turn": 1.2, "reach": -0.05}, abs=0.02)


@pytest.mark.long
@pytest.mark.parametrize("robot", ["so101", "unitree_go2"])
def test_the_position_of_a_robot_appears_in_its_picture(new: New, robot: str) -> None:
    """A camera that looks at the origin shows the robot only if it stands there."""

    def seen(**keywords: Any) -> Any:
        sim = new(robot, tool_name=f"{robot}{len(keywords)}", **keywords)
        json_of(sim.add_camera("above", position=[0.0, 0.0, 2.0], target=[0.0, 0.0, 0.0], fov=60))
        return sim.render(64, 64, "above").astype(int)

    home = seen()
    away = seen(position=[0.0, 3.0, 0.0])
    turned = seen(position=[0.0, 0.0, 0.0], orientation=[0.7071, 0.0, 0.0, 0.7071])
    assert np.abs(home - away).mean() > 1.0
    assert np.abs(home - turned).mean() > 0.5


def test_a_simulation_starts_at_its_keyframe_and_holds_it(new: New, tmp_path: Path) -> None:
    """It does not fall before its first command, nor after a reset."""
    (tmp_path / "arm.xml").write_text(HANGING)
    sim = new("arm", urdf_path=tmp_path / "arm.xml", keyframe="home", arm=False)
    assert sim.get_observation()["lift"] == pytest.approx(0.3, abs=0.02)
    assert after(sim, 1000)["lift"] == pytest.approx(0.3, abs=0.02)
    assert json_of(sim.reset())["position"]["lift"] == pytest.approx(0.3, abs=0.02)
    assert "Stay within -2.0000..2.0000" in why(sim.send_action({"lift": 1e300}))


WRONG: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"urdf_path": "no-such.xml"}, ValueError, "there is no model"),
    ({"position": [1.0, 2.0]}, ValueError, r"position is \[1.0, 2.0\]. Give 3 numbers"),
    ({"position": "here"}, ValueError, "position is 'here'"),
    ({"orientation": [0, 0, 0, 0]}, ValueError, "that is not zero"),
    ({"orientation": [1, 0, 0, float("nan")]}, ValueError, "Give finite numbers"),
    ({"keyframe": "folded"}, ValueError, "so101 has only 'home'"),
    ({"backend": "bullet"}, ValueError, "Use one of 'mujoco', 'newton', 'isaac'"),
    ({"backend": "isaac"}, ImportError, r"pip install 'isaacsim\[all,extscache\]>=5,<6'"),
    ({"mode": "real", "port": "x", "position": [0, 0, 1]}, TypeError, "only a simulation takes position="),
]


@pytest.mark.parametrize(("keywords", "error", "text"), WRONG)
def test_invalid_keywords_are_refused(keywords: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        Robot("so101", **keywords)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("arm.xml", "<mujoco><worldbody/></mujoco>", "has no joint that can be driven"),
        ("arm.xml", "<mujoco><worldbdy/></mujoco>", "MuJoCo cannot read this model"),
        ("arm.xml", MJCF, r"MuJoCo cannot read this model: .*hook\.stl"),
        ("arm.urdf", "<robot", "is no valid XML"),
        ("arm.urdf", "<sdf/>", "is no URDF or MJCF, since it begins with <sdf>"),
        ("arm.urdf", URDF.replace("visual>", "collision>"),
         r"link arm is 'package://lifter_description/meshes/arm\.stl': it is not there"),
        ("arm.xacro", URDF, "is a xacro. Expand it first"),
    ],
)  # fmt: skip
def test_a_model_that_cannot_be_read_is_refused(tmp_path: Path, file: str, text: str, message: str) -> None:
    (tmp_path / file).write_text(text)
    with pytest.raises(ValueError, match=message):
        Robot("arm", urdf_path=tmp_path / file)


def test_a_registered_model_is_checked(new: New, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"there is no file 'no-such\.xml'"):
        register_robot("crane", model_xml="no-such.xml")
    register_robot("crane", model_xml=write_mjcf(tmp_path))
    with pytest.raises(ValueError, match=r"keyframe is 'up'\. The model of crane has folded"):
        Robot("crane", keyframe="up")
    with pytest.raises(ValueError, match="crane has no native driver"):
        Robot("crane", mode="real", port="/dev/ttyACM0")
    with pytest.raises(ValueError, match="a model without a driver for hardware"):
        Robot("crane", mode="auto", port="/dev/ttyACM0")
    assert Robot("crane", mode="auto").transport == "sim"


# # -- objects, cameras and states


@pytest.fixture
def arm(new: New) -> SimRobot:
    return new("so101")


def rows_of(picture: Any, channel: int) -> Any:
    """Return the rows, from the top of the picture, that contain a colour."""
    others = [index for index in range(3) if index != channel]
    lit = (picture[..., channel] > 90) & (picture[..., others] < 60).all(axis=-1)
    return np.nonzero(lit)[0]


@pytest.mark.long
def test_objects_are_drawn_fall_and_can_be_removed(arm: SimRobot) -> None:
    json_of(arm.send_action({"shoulder_pan": 20.0}))
    json_of(arm.step(500))
    json_of(arm.add_camera("front", position=[1.2, 0.3, 0.2], target=[0.2, 0.3, 0.2], fov=50))
    cube: dict[str, Any] = {"size": [0.05, 0.05, 0.05], "mass": 0.05}
    green = {"position": [0.2, 0.4, 0.4], "color": [0, 1, 0], "is_static": True}
    assert json_of(arm.add_object("green", **cube, **green)) == {"added": "green"}
    json_of(arm.add_object("blue", position=[0.2, 0.2, 0.4], color=[0, 0, 1, 1], **cube))
    assert after(arm, 500)["shoulder_pan"] == pytest.approx(20.0, abs=1.0), "the arm keeps its target"
    picture = arm.render(96, 72, "front").astype(int)
    high, low = rows_of(picture, 1), rows_of(picture, 2)
    assert len(high) > 4 and len(low) > 4
    assert low.mean() > high.mean() + 15, "the green cube is fixed, and the blue one has fallen"
    json_of(arm.remove_object("green"))
    assert len(rows_of(arm.render(96, 72, "front").astype(int), 1)) < 3
    json_of(arm.send_action({"shoulder_pan": 0.0}))
    until(lambda: abs(arm.get_observation()["shoulder_pan"]) < 1.5, "the arm still moves")


def test_a_saved_state_can_be_loaded(arm: SimRobot) -> None:
    json_of(arm.send_action({"shoulder_pan": 20.0}))
    json_of(arm.step(500))
    json_of(arm.save_state("before"))
    json_of(arm.send_action({"shoulder_pan": -30.0}))
    assert after(arm, 500)["shoulder_pan"] < -20.0
    assert json_of(arm.load_state("before"))["position"]["shoulder_pan"] == pytest.approx(20.0, abs=1.5)
    assert after(arm, 500)["shoulder_pan"] == pytest.approx(20.0, abs=1.5), "no earlier target moves the arm away"


def test_a_camera_can_be_attached_to_a_link(arm: SimRobot) -> None:
    json_of(
        arm.add_camera("eye", position=[0, 0, 0.1], target=[0, 0, -0.1], width=48, height=36, parent_body="hand")
    )
    before = arm.render(camera="eye").astype(int)
    assert before.shape == (36, 48, 3), "the picture has the camera's size"
    json_of(arm.send_action({"shoulder_lift": 40.0, "wrist_roll": 60.0}))
    json_of(arm.step(800))
    assert np.abs(arm.render(48, 36, "eye").astype(int) - before).mean() > 2


SCENE: list[tuple[str, dict[str, Any], str]] = [
    ("add_object", {"name": "cube", "shape": "cone"}, "shape is 'cone'. Use one of box, sphere"),
    ("add_object", {"name": "", "shape": "box"}, "the name is ''"),
    ("add_camera", {"name": "wide", "width": 0}, "size is 0 x 480. Give width and height as whole numbers"),
    ("add_object", {"name": "hand"}, "there is a body 'hand' already"),
    ("add_object", {"name": "cube", "mass": 0}, "mass is 0. Give kilograms, above 0"),
    ("add_object", {"name": "cube", "mass": float("nan")}, "mass is nan"),
    ("add_object", {"name": "cube", "size": [0.1]}, "Give 3 numbers"),
    ("add_object", {"name": "cube", "size": [0.1, 0.1, -1]}, "Give metres, above 0"),
    ("add_object", {"name": "cube", "color": [2, 0, 0]}, "0 to 1"),
    ("add_object", {"name": "cube", "is_static": "no"}, "is_static is 'no'"),
    ("add_object", {"name": "cup", "mesh_path": "no-such.stl"}, "there is no mesh file"),
    ("add_object", {"name": "cup", "shape": "mesh"}, "shape='mesh' and mesh_path= belong together"),
    ("remove_object", {"name": "hand"}, "no object 'hand' was added to this simulation"),
    ("add_camera", {"name": "c", "fov": 200}, "fov is 200"),
    ("add_camera", {"name": "c", "position": [0, 0, 1], "target": [0, 0, 1]}, "position is its target"),
    ("add_camera", {"name": "c", "parent_body": "foot"}, "there is no body 'foot'. Use one of base, shoulder"),
    ("load_state", {"name": "never"}, "no state 'never' was saved. Saved states: none"),
]


def test_invalid_objects_cameras_and_states_are_refused_and_the_arm_still_moves(arm: SimRobot) -> None:
    for verb, keywords, text in SCENE:
        assert text in why(getattr(arm, verb)(**keywords)), (verb, keywords)
    json_of(arm.add_object("cube"))
    assert "there is a body 'cube' already" in why(arm.add_object("cube"))
    json_of(arm.save_state())
    json_of(arm.add_object("ball", shape="sphere", size=[0.03], position=[0.3, 0.2, 0.1]))
    assert "objects were added or removed since" in why(arm.load_state())
    json_of(arm.send_action({"gripper": 30.0}))
    until(lambda: abs(arm.get_observation()["gripper"] - 30.0) < 2.0, "the gripper moves")


def test_a_mesh_can_be_an_object(arm: SimRobot, tmp_path: Path) -> None:
    write_mjcf(tmp_path)
    json_of(arm.add_object("rock", mesh_path=tmp_path / "meshes" / "hook.stl", position=[0.3, 0, 0.1]))
    json_of(arm.step(10))


# # -- evaluation of a policy


def test_a_policy_is_evaluated_in_episodes(arm: SimRobot) -> None:
    begun: list[float] = []

    def policy(observation: dict[str, float]) -> dict[str, float]:
        begun.append(observation["shoulder_pan"])
        return {"shoulder_pan": observation["shoulder_pan"] + 2.0}

    tried = json_of(
        arm.eval_policy(
            policy_object=policy,
            n_episodes=2,
            max_steps=60,
            success_fn=lambda seen: seen["shoulder_pan"] > 15.0,
            seed=3,
        )
    )
    assert (tried["n_episodes"], tried["success_rate"]) == (2, 1.0)
    assert [each["seed"] for each in tried["episodes"]] == [3, 4]
    assert all(5 < each["steps"] < 60 for each in tried["episodes"]), tried
    assert sum(abs(start) < 2.0 for start in begun[:1]) == 1
    missed = json_of(arm.eval_policy("mock", max_steps=5, success_fn=lambda seen: False))
    assert (missed["success_rate"], missed["episodes"][0]["steps"]) == (0.0, 5)
    assert json_of(arm.eval_policy("mock", max_steps=3))["success_rate"] is None


@pytest.mark.parametrize(
    ("keywords", "text"),
    [
        ({"n_episodes": 0}, "n_episodes is 0"),
        ({"max_steps": 1.5}, "max_steps is 1.5"),
        ({"seed": -1}, "seed is -1"),
        ({"control_frequency": 0}, "control_frequency is 0"),
        ({"success_fn": "lifted"}, "success_fn is 'lifted'"),
        ({"policy_provider": "smooth_talk"}, "Use one of"),
        ({"policy_object": 7}, "is no policy"),
        ({"policy_object": lambda seen: {"hoist": 1.0}}, "hoist"),
        ({"policy_object": lambda seen: []}, "gave no action"),
        ({"robot_name": "koch"}, "robot_name is 'koch'"),
    ],
)
def test_an_invalid_evaluation_is_refused(arm: SimRobot, keywords: dict[str, Any], text: str) -> None:
    assert text in why(arm.eval_policy(**keywords))


def test_a_backend_that_is_not_installed_is_refused_with_the_command_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ImportError, match=r"needs newton and mujoco_warp: pip install 'strands-actors\[newton\]'"):
        Robot("so101", backend="newton")
