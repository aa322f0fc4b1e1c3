"""Write models like those of users: an MJCF and a URDF, each with a mesh in a separate file."""

from __future__ import annotations

import struct
from pathlib import Path

MJCF = """
<mujoco model="crane">
  <compiler angle="degree" meshdir="meshes"/>
  <asset><mesh name="hook" file="hook.stl"/></asset>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <body name="mast" pos="0 0 .1">
      <geom type="cylinder" size=".05 .1" mass="2"/>
      <body name="boom" pos="0 0 .1">
        <joint name="turn" axis="0 0 1" range="-150 150" damping=".2"/>
        <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".5" rgba="1 .5 0 1"/>
        <body name="cart" pos=".25 0 0">
          <joint name="reach" type="slide" axis="1 0 0" range="-.1 .1" damping="5"/>
          <geom type="mesh" mesh="hook" mass=".1"/>
          <camera name="wrist" pos="0 0 .2" xyaxes="0 -1 0 1 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="turn_servo" joint="turn" kp="40" kv="4" ctrlrange="-2.6 2.6"/>
    <motor name="reach_motor" joint="reach" gear="20" ctrlrange="-1 1"/>
  </actuator>
  <sensor><actuatorfrc actuator="turn_servo"/></sensor>
  <keyframe><key name="folded" qpos="1.2 -.05" ctrl="1.2 0"/></keyframe>
</mujoco>
"""

URDF = """<?xml version="1.0"?>
<robot name="lifter">
  <link name="base"><visual><geometry><box size=".1 .1 .1"/></geometry></visual>
    <inertial><mass value="2"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial></link>
  <link name="arm">
    <visual><origin xyz=".1 0 0"/><geometry><mesh filename="package://lifter_description/meshes/arm.stl"/></geometry></visual>
    <visual><geometry><mesh filename="package://lifter_description/meshes/cover.dae"/></geometry></visual>
    <collision><origin xyz=".1 0 0"/><geometry><box size=".2 .04 .04"/></geometry></collision>
    <inertial><origin xyz=".1 0 0"/><mass value=".5"/>
      <inertia ixx=".001" ixy="0" ixz="0" iyy=".002" iyz="0" izz=".002"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
    <origin xyz="0 0 .3"/><axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="30" velocity="2"/></joint>
</robot>
"""


def tetrahedron(path: Path, size: float) -> None:
    """Write a tetrahedron as a binary STL."""
    corners = [(0.0, 0.0, 0.0), (size, 0.0, 0.0), (0.0, size, 0.0), (0.0, 0.0, size)]
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    rows = b"".join(
        struct.pack("<12fH", 0, 0, 0, *(value for corner in face for value in corners[corner]), 0) for face in faces
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"\0" * 80 + struct.pack("<I", len(faces)) + rows)


def write_mjcf(folder: Path) -> Path:
    tetrahedron(folder / "meshes" / "hook.stl", 0.08)
    (folder / "crane.xml").write_text(MJCF)
    return folder / "crane.xml"


def write_urdf(folder: Path) -> Path:
    """Write a ROS package, with the URDF in one folder and its meshes in another."""
    package = folder / "lifter_description"
    tetrahedron(package / "meshes" / "arm.stl", 0.2)
    (package / "urdf").mkdir()
    (package / "urdf" / "lifter.urdf").write_text(URDF)
    return package / "urdf" / "lifter.urdf"
