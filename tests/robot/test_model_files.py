"""A model file that MuJoCo loads also loads here, with the same joints, limits, masses and motion."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.model.driver import ModelDriver
from strands_actors.drivers.model.reading import Read, read_model

from .own_models import URDF, tetrahedron

INERTIA = '<inertia ixx=".01" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"/>'
ARM_INERTIAL = f'<inertial><origin xyz=".2 0 0"/><mass value=".5"/>{INERTIA}</inertial>'
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 99\n"


def urdf(*, arm: str = "", base: str = "", more: str = "", extension: str = "", head: str = "") -> str:
    return f"""{head}<robot name="two">{extension}
  <link name="base">{base}<inertial><mass value="2"/>{INERTIA}</inertial></link>
  <link name="arm">{arm}{ARM_INERTIAL}</link>
  <link name="tool"><inertial><mass value=".1"/>{INERTIA}</inertial></link>
  <joint name="lift" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1.2" upper="1.1" effort="30" velocity="2"/><dynamics damping=".3" friction=".1"/></joint>
  <joint name="flange" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz=".3 0 0"/></joint>
  {more}</robot>"""


def shape(kind: str, mesh: str) -> str:
    return f'<{kind}><geometry><mesh filename="{mesh}"/></geometry></{kind}>'


BOX = '<{0}><geometry><box size="{1} {1} {1}"/></geometry></{0}>'
MESHES = '<mujoco><compiler meshdir="meshes" strippath="true"/></mujoco>'

LOADED = {
    "prefix": urdf(more='<drake:joint name="x"/><gazebo><plugin:ros a:b="1"/></gazebo>'),
    "transmission": urdf(more='<transmission><joint name="lift"><hardwareInterface/></joint></transmission>'),
    "comment": urdf(more="<!-- a -- b --><![CDATA[ <x> ]]>"),
    "entities": urdf(more='<x a="b & c > d" c="&nbsp;"/>'),
    "declaration": urdf(head='\ufeff\n<?xml version="1.0" encoding="latin-99"?><!-- <robot> -->'),
    "doctype": urdf(head="<!DOCTYPE robot>"),
    "after": urdf() + "<other/>",
    "collada": urdf(arm=shape("visual", "arm.dae")),
    "missing": urdf(arm=shape("visual", "meshes/gone.stl")),
    "ascii": urdf(arm=shape("visual", "meshes/ascii.stl")),
    "pointer": urdf(arm=shape("visual", "meshes/pointer.stl")),
    "mesh": urdf(arm=shape("collision", "meshes/arm.stl") + shape("visual", "meshes/arm.stl")),
    "meshdir": urdf(arm=shape("collision", "package://far/away/arm.stl"), extension=MESHES),
    "fused": urdf(extension='<mujoco><compiler fusestatic="true"/><option gravity="0 0 -3"/></mujoco>'),
    "empty": urdf(extension="<mujoco/>"),
    "mass": urdf(arm=BOX.format("visual", 0.1) + BOX.format("collision", 0.2)).replace(ARM_INERTIAL, ""),
    "mimic": urdf(
        more=f'<link name="k"><inertial><mass value="1"/>{INERTIA}</inertial></link>'
        '<joint name="k" type="continuous"><parent link="arm"/><child link="k"/><axis xyz="1 0 0"/>'
        '<mimic joint="lift" multiplier="2"/></joint>'
    ),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    tetrahedron(tmp_path / "meshes" / "arm.stl", 0.2)
    (tmp_path / "meshes" / "ascii.stl").write_text("solid arm\nendsolid arm\n")
    (tmp_path / "meshes" / "pointer.stl").write_text(POINTER)
    return tmp_path


def written(folder: Path, text: str, name: str = "two.urdf") -> Path:
    (folder / name).write_text(text)
    return folder / name


def motion(model: Any, joint: str, pushed: float) -> list[float]:
    """Return the positions of a joint that is pushed for a second, without motors."""
    data = mujoco.MjData(model)
    model.opt.timestep, model.opt.integrator = 0.002, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    seen = []
    for _ in range(500):
        data.qfrc_applied[model.joint(joint).dofadr[0]] = pushed
        mujoco.mj_step(model, data)
        seen.append(float(data.qpos[model.joint(joint).qposadr[0]]))
    return seen


@pytest.mark.parametrize("case", LOADED)
def test_a_model_that_mujoco_loads_has_the_same_joints_masses_and_motion(folder: Path, case: str) -> None:
    file = written(folder, LOADED[case])
    own = mujoco.MjModel.from_xml_path(str(file))
    read = read_model(file).spec.compile()
    names = [own.joint(index).name for index in range(own.njnt)]
    assert names == [read.joint(index).name for index in range(read.njnt)]
    np.testing.assert_allclose(read.jnt_range, own.jnt_range)
    np.testing.assert_allclose(read.dof_M0, own.dof_M0, rtol=1e-9)
    np.testing.assert_allclose(read.dof_damping, own.dof_damping)
    assert read.neq == own.neq
    assert read.body_subtreemass[read.body("arm").id] == pytest.approx(own.body_subtreemass[own.body("arm").id])
    read.body_gravcomp[:] = 0.0  # the model has no motors, so its gravity is compensated
    read.actuator_gainprm[:], read.actuator_biasprm[:] = 0.0, 0.0
    np.testing.assert_allclose(motion(read, "lift", 2.0), motion(own, "lift", 2.0), atol=1e-6)


@pytest.mark.parametrize(
    ("case", "named"),
    [
        ("collada", r"two\.urdf: left out .* arm\.dae of link arm \(MuJoCo reads no \.dae"),
        ("missing", r"meshes/gone\.stl of link arm \(it is not there\. It was looked for as .*/meshes/gone\.stl"),
        ("ascii", r"meshes/ascii\.stl of link arm \(MuJoCo cannot read it"),
        ("pointer", r"meshes/pointer\.stl of link arm \(.*pointer\.stl is a git-lfs pointer.*git lfs pull"),
    ],
)
def test_an_omitted_visual_is_named(folder: Path, case: str, named: str, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        ModelDriver.resolve("two", {"model": written(folder, LOADED[case])})
    assert len(caplog.messages) == 1 and re.search(named, caplog.messages[0]), caplog.messages
    caplog.clear()
    ModelDriver.resolve("two", {"model": written(folder, LOADED["mesh"])})
    assert caplog.messages == []


REFUSED: list[tuple[str, str, str]] = [
    ("two.urdf", urdf(arm=shape("collision", "meshes/gone.stl")), r"arm is 'meshes/gone\.stl': it is not there"),
    ("two.urdf", urdf(arm=shape("collision", "arm.dae")), r"'arm\.dae': MuJoCo reads no \.dae\. Convert it"),
    ("two.urdf", urdf(arm=shape("collision", "meshes/pointer.stl")), "is a git-lfs pointer, not the file itself"),
    ("two.urdf", urdf(arm=shape("collision", "meshes/ascii.stl")), r"two\.urdf: .*/meshes/ascii\.stl"),
    ("two.urdf", POINTER, r"two\.urdf is a git-lfs pointer"),
    ("two.urdf", urdf(more="<a>" * 200_000 + "</a>" * 200_000), "nested more than 500 deep"),
    ("two.xml", "<mujoco><asset><mesh name='m' file='meshes/pointer.stl'/></asset><worldbody><body><joint/>"
     "<geom type='mesh' mesh='m'/></body></worldbody></mujoco>", r"meshes/pointer\.stl is a git-lfs pointer"),
    ("two.xml", "<mujoco><asset><hfield name='h' nrow='60000' ncol='60000' size='1 1 1 1'/></asset></mujoco>",
     "hfield 'h' has 60000 x 60000 cells. Give at most"),
    ("two.xml", "<mujoco><asset><texture name='t' builtin='flat' width='60000' height='60000'/></asset></mujoco>",
     "texture 't' has 60000 x 60000 cells"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "text", "why"), REFUSED)
def test_the_refusal_of_a_model_names_the_users_file(folder: Path, name: str, text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read_model(written(folder, text, name))


def test_a_mesh_is_found_in_its_package(tmp_path: Path) -> None:
    tetrahedron(tmp_path / "lifter_description" / "meshes" / "arm.stl", 0.2)
    (tmp_path / "lifter_description" / "urdf").mkdir()
    read = read_model(written(tmp_path / "lifter_description" / "urdf", URDF))
    assert [left.mesh for left in read.omitted_visuals] == ["package://lifter_description/meshes/cover.dae"]


def driven(read: Read) -> Plant:
    gains = [(joint.kp, joint.kv) for joint in read.joints]
    plant = Plant(read.spec, [joint.name for joint in read.joints], 30.0, (), gains=gains)
    for index in range(len(read.joints)):
        plant.energise(index, True)
    return plant


def test_only_base_and_first_link_of_a_urdf_do_not_collide(folder: Path) -> None:
    far = '<origin xyz="1 0 0"/>'
    text = urdf(base=BOX.format("collision", 0.2), arm=BOX.format("collision", 0.2)).replace(
        "</robot>",
        f'<link name="last"><inertial><mass value=".1"/>{INERTIA}</inertial>{BOX.format("collision", 0.1)}</link>'
        f'<joint name="far" type="revolute"><parent link="tool"/><child link="last"/>{far}<axis xyz="0 1 0"/>'
        '<limit lower="-3" upper="3" effort="30" velocity="2"/></joint></robot>',
    )
    plant = driven(read_model(written(folder, text)))
    plant.set_simulation_target(0, 0.7)
    plant.step(2000)
    assert plant.position_rad[0] == pytest.approx(0.7, abs=0.01)
    excluded = [divmod(int(pair), 1 << 16) for pair in plant.model.exclude_signature]
    name = plant.model.body
    assert [{name(first).name, name(second).name} for first, second in excluded] == [{"base", "arm"}]


def test_a_scaled_general_actuator_reaches_its_target(folder: Path) -> None:
    """0 to 255 correspond to 0 to 1.6 rad, and the stiffness comes from ``biasprm``."""
    text = """<mujoco><worldbody><body><joint name="turn" axis="0 1 0" range="0 91.7"/>
      <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".3"/></body></worldbody><actuator>
      <general joint="turn" ctrlrange="0 255" gainprm="0.2509" biasprm="0 -40 -4" biastype="affine" gear="2"/>
      </actuator></mujoco>"""
    read = read_model(written(folder, text, "scaled.xml"))
    assert (read.joints[0].kp, read.joints[0].kv) == pytest.approx((160.0, 16.0))
    plant = driven(read)
    plant.set_simulation_target(0, 0.5)
    plant.step(2000)
    assert plant.position_rad[0] == pytest.approx(0.5, abs=0.01)


def planes(model: Any) -> list[float]:
    kind = mujoco.mjtGeom.mjGEOM_PLANE
    return [float(model.geom_pos[geom, 2]) for geom in range(model.ngeom) if model.geom_type[geom] == kind]


def test_a_model_without_a_floor_gets_one_that_carries_objects_and_does_not_touch_its_links(folder: Path) -> None:
    assert planes(read_model(written(folder, urdf(base=BOX.format("collision", 0.2)))).spec.compile()) == [-0.1]
    own = "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body><joint/><geom size='.1'/></body>"
    own += "</worldbody></mujoco>"
    assert planes(read_model(written(folder, own, "own.xml")).spec.compile()) == [0.0]
    spec = read_model(written(folder, urdf(arm=BOX.format("collision", 0.02)))).spec
    cube = spec.worldbody.add_body(name="cube", pos=[1, 0, 0.5])
    cube.add_freejoint()
    cube.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.05] * 3, contype=3, conaffinity=3)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[0] = 1.0  # the arm reaches below the floor
    mujoco.mj_step(model, data, 1000)
    assert data.body("cube").xpos[2] == pytest.approx(planes(model)[0] + 0.05, abs=0.005)
