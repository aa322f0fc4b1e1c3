"""Common contents of users' MJCF files: defaults, damping ratios, keyframes, orientations, and names that
this package also uses.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.scenery import Object, Scenery
from strands_actors.drivers.common.simulation_control.renderer import CannotRender, SceneRenderer
from strands_actors.drivers.common.simulation_control.scene import View, decorate
from strands_actors.drivers.model.reading import Read, read_model

AT_BOTH = '<{0} joint="one" {1}/><{0} joint="two" {1}/>'
TWO_SERVOS = AT_BOTH.format("position", 'kp="40" kv="4"')
BOX = '<body name="box" pos="0 1 1"><freejoint/><geom size=".1"/></body>'


def mjcf(actuators: str, *, head: str = "", world: str = "", tail: str = "", base: str = "") -> str:
    return f"""<mujoco>{head}<worldbody><body name="first" {base}>
      <joint name="one" axis="0 1 0" range="-120 120" damping=".1"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5" contype="0"/>
      <body name="second" pos=".3 0 0"><joint name="two" axis="0 1 0" range="-120 120" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3" contype="0"/></body></body>
      {world}</worldbody><actuator>{actuators}</actuator>{tail}</mujoco>"""


def read(folder: Path, text: str) -> Read:
    (folder / "arm.xml").write_text(text)
    return read_model(folder / "arm.xml")


def plant_of(model: Read, keyframe: str = "", *, held: bool = True) -> Plant:
    gains = [(joint.kp, joint.kv) for joint in model.joints]
    home = model.keyframes[keyframe] if keyframe else ()
    plant = Plant(model.spec, [joint.name for joint in model.joints], gains=gains, home_qpos=home)
    for index in range(len(model.joints)):
        plant.energise(index, held)
    return plant


SERVOS = {
    "damping ratio": mjcf(AT_BOTH.format("position", 'kp="40" dampratio="1"')),
    "velocity beside": mjcf(AT_BOTH.format("position", 'kp="40"') + AT_BOTH.format("velocity", 'kv="4"')),
    "velocity before": mjcf(AT_BOTH.format("velocity", 'kv="4"') + AT_BOTH.format("position", 'kp="40"')),
    "in the parent": mjcf(TWO_SERVOS.replace("joint=", "jointinparent=")),
    "main default": mjcf(
        AT_BOTH.format("position", ""),
        head='<default><position kp="40" kv="4" gear="2" ctrlrange="-3 3"/></default>',
    ),
}


@pytest.mark.parametrize("case", SERVOS)
def test_a_models_own_servos_move_as_in_mujoco(tmp_path: Path, case: str) -> None:
    plant = plant_of(read(tmp_path, SERVOS[case]))
    own = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    own.opt.timestep, own.opt.integrator = plant.model.opt.timestep, plant.model.opt.integrator
    data = mujoco.MjData(own)
    gear = own.actuator_gear[0, 0]
    for index, target in enumerate((0.4, -0.3)):
        plant.set_simulation_target(index, target)
    data.ctrl[[own.actuator_trntype.size - 2, own.actuator_trntype.size - 1]] = 0.4 * gear, -0.3 * gear
    if case == "velocity beside":
        data.ctrl[:] = 0.4, -0.3, 0.0, 0.0
    for _ in range(3):
        plant.step(60)
        mujoco.mj_step(own, data, 60)
        assert plant.position_rad == pytest.approx(data.qpos.tolist(), abs=1e-6)


DEFAULTS = {
    "gear": '<default><motor gear="50" ctrllimited="true" ctrlrange="-1 1"/></default>',
    "range": '<default><motor ctrlrange="-.2 .2" gear="90" forcerange="-90 90"/></default>',
}


@pytest.mark.parametrize("head", DEFAULTS.values(), ids=DEFAULTS)
def test_a_main_default_of_motors_does_not_change_the_servos(tmp_path: Path, head: str) -> None:
    plant = plant_of(read(tmp_path, mjcf(AT_BOTH.format("motor", ""), head=head)))
    plant.set_simulation_target(0, 0.8)
    plant.set_simulation_target(1, -1.1)
    plant.step(1500)
    assert plant.position_rad == pytest.approx((0.8, -1.1), abs=0.1)  # gravity bends the arm a little


EFFORTS = {
    '<damper joint="one" kv="4" ctrlrange="0 1"/>': np.inf,
    '<motor joint="one" gear="30" ctrlrange="-1 0"/>': 30.0,
    '<position joint="one" kp="40" forcerange="-20 0"/>': 20.0,
    '<motor joint="one" gear="-30" ctrlrange="-1 1"/>': 30.0,
}


@pytest.mark.parametrize(("actuator", "effort"), EFFORTS.items())
def test_an_actuator_that_only_pulls_has_an_effort(tmp_path: Path, actuator: str, effort: float) -> None:
    assert read(tmp_path, mjcf(actuator)).joints[0].effort == effort


def test_an_unnamed_joint_gets_no_name_that_the_model_uses(tmp_path: Path) -> None:
    text = mjcf(TWO_SERVOS, world=BOX + '<body><joint/><geom size=".1"/></body>')
    model = read(tmp_path, text.replace('"one"', '"joint3"').replace('"two"', '"joint2"'))
    assert [joint.name for joint in model.joints] == ["joint3", "joint2"]


def test_ranges_of_an_attached_model_keep_its_own_unit(tmp_path: Path) -> None:
    part = mjcf(TWO_SERVOS, head='<compiler angle="radian"/>').replace('"-120 120"', '"-1.5 1.5"')
    (tmp_path / "part.xml").write_text(part)
    whole = """<mujoco><asset><model name="part" file="part.xml"/></asset><worldbody><body name="mount">
      <attach model="part" body="first" prefix="left_"/></body></worldbody></mujoco>"""
    assert [joint[:3] for joint in read(tmp_path, whole).joints] == [
        ("left_one", -1.5, 1.5),
        ("left_two", -1.5, 1.5),
    ]


KEYS = '<keyframe><key name="home" qpos=".5 .7 2 2 .1 0 0 0 1"/><key name="zero" ctrl="0 0"/></keyframe>'


def test_the_whole_model_begins_at_its_keyframe(tmp_path: Path) -> None:
    model = read(tmp_path, mjcf(TWO_SERVOS, world=BOX, tail=KEYS))
    plant = plant_of(model, "home", held=False)
    assert plant.data.qpos.tolist() == [0.5, 0.7, 2.0, 2.0, 0.1, 0.0, 0.0, 0.0, 1.0]
    plant.step(10)
    Scenery(plant).place([0.0, 0.0, 1.0], [2**-0.5, 0.0, 0.0, 2**-0.5])  # a quarter of a turn
    assert plant.data.qpos == pytest.approx([0.5, 0.7, -2.0, 2.0, 1.1, -(2**-0.5), 0.0, 0.0, 2**-0.5])
    assert model.keyframes["zero"] == (0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0)


BASES = {
    "euler": {"base": 'euler="0 0 90"'},
    "axis": {"base": 'pos="1 0 0" axisangle="1 0 0 30"'},
    "frames": {"base": 'pos="1 0 0"', "framed": True},
}


@pytest.mark.parametrize("words", BASES.values(), ids=BASES)
def test_a_robot_is_placed_for_any_orientation_in_its_file(tmp_path: Path, words: Mapping[str, Any]) -> None:
    text = mjcf(TWO_SERVOS, base=words["base"])
    if "framed" in words:
        text = text.replace("<worldbody>", '<worldbody><frame pos="0 2 0"><frame euler="0 90 0">')
        text = text.replace("</worldbody>", "</frame></frame></worldbody>")
    plant = plant_of(read(tmp_path, text))
    before = plant.pose_of("second", (0.1, 0.2, 0.3))
    turn, place = np.array([0.5, 0.5, -0.5, 0.5]), np.array([0.0, 3.0, 1.0])
    Scenery(plant).place(place.tolist(), turn.tolist())
    expected, rotation = np.eye(4), np.zeros(9)
    mujoco.mju_quat2Mat(rotation, turn)
    expected[:3, :3], expected[:3, 3] = rotation.reshape(3, 3), place
    expected = expected @ np.reshape(before, (4, 4), "F")
    assert np.reshape(plant.pose_of("second", (0.1, 0.2, 0.3)), (4, 4), "F") == pytest.approx(expected, abs=1e-9)


def test_main_defaults_of_a_model_do_not_change_added_objects(tmp_path: Path) -> None:
    head = """<default><geom contype="0" conaffinity="0" group="4" quat="0 1 0 0" condim="1"/>
      <joint damping="50"/><equality solref="1 1"/></default>"""
    plant = plant_of(read(tmp_path, mjcf(TWO_SERVOS, head=head)))
    look = ((1.0, 1.0, 1.0), (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (1.0, 0.0, 0.0, 1.0))
    Scenery(plant).add_object(Object("cube", "box", *look, 0.1, False))
    plant.step(1500)
    geom = plant.model.geom("cube")
    assert (int(geom.group[0]), int(geom.condim[0]), geom.quat.tolist()) == (0, 3, [1.0, 0.0, 0.0, 0.0])
    assert plant.data.body("cube").xpos[2] == pytest.approx(-0.02 + 0.05, abs=0.005)  # the floor is below the links
    assert plant.model.equality("one_jam").solref.tolist() == [0.02, 1.0]


def test_a_camera_of_the_model_is_used_by_its_name(tmp_path: Path) -> None:
    """``front`` is also the name of a built-in view of the whole robot."""
    camera = "".join(f'<camera name="{name}" pos="0 0 5" quat="0 1 0 0"/>' for name in ("front", "lens"))
    spec = read(tmp_path, mjcf(TWO_SERVOS, world=camera)).spec
    spec.compile()
    view = View((0.0, 0.0, 0.0), 1.0)
    renderer = SceneRenderer(decorate(spec, view).compile(), view, 32, 32)
    front, lens, side = (renderer.shoot([0.0, 0.0], 32, 32, name) for name in ("front", "lens", "side"))
    with pytest.raises(CannotRender, match="There are front, side, top, lens, and None"):
        renderer.shoot([0.0, 0.0], 32, 32, "back")
    renderer.close()
    assert front == lens != side


def test_a_model_with_a_sky_and_a_ground_and_without_names_is_drawn(tmp_path: Path) -> None:
    head = """<asset><texture name="sky" type="skybox" builtin="flat" width="8" height="48"/>
      <texture name="ground" type="2d" builtin="flat" width="8" height="8"/>
      <material name="ground" texture="ground"/></asset>"""
    world = '<geom type="plane" size="1 1 1" material="ground"/>'
    text = mjcf(TWO_SERVOS, head=head, world=world + "<body><body><body><geom size='.1'/></body></body></body>")
    spec = read(tmp_path, text).spec
    spec.compile()
    decorate(spec, View((0.0, 0.0, 0.0), 1.0)).compile()
