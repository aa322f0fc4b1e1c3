"""The description of a robot puts each link where the robot's own table puts it."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class, list_native_drivers
from strands_actors.drivers.common.kinematics.link_rows import quaternion
from strands_actors.drivers.common.kinematics.urdf import rpy_of, urdf_of
from strands_actors.drivers.common.physics.model_rows import build


def drivers() -> Mapping[str, Driver]:
    found = {}
    for robot in list_native_drivers():
        driver_class = get_native_driver_class(robot)
        assert driver_class is not None
        driver = driver_class(robot, "", driver_class.resolve(robot, {}))
        if driver.link_rows():
            found[robot] = driver
    return found


DRIVERS = drivers()


def test_the_arms_have_a_description() -> None:
    assert {"so100", "so101", "koch", "kinova_gen3", "rby1", "xarm7", "panda", "fr3"} <= DRIVERS.keys()


@pytest.mark.parametrize("robot", sorted(DRIVERS))
def test_links_are_where_the_twin_has_them(robot: str) -> None:
    driver = DRIVERS[robot]
    urdf = urdf_of(robot, driver.link_rows())
    root = ElementTree.fromstring(urdf)
    moving = [joint.get("name") for joint in root.findall("joint") if joint.get("type") != "fixed"]
    assert moving == list(driver.axes)
    ours = build({"model_rows": driver.link_rows()}).compile()
    spec = mujoco.MjSpec.from_string(urdf)
    theirs = spec.compile()
    pose = {name: 0.3 * (-1) ** index for index, name in enumerate(driver.axes)}
    assert _places(ours, pose) == pytest.approx(_places(theirs, pose), abs=1e-5)


def _places(model: mujoco.MjModel, pose: Mapping[str, float]) -> np.ndarray:
    """Return the origins of the moving links, by the names of their joints."""
    data = mujoco.MjData(model)
    for name, angle in pose.items():
        data.qpos[model.joint(name).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return np.array([data.xanchor[model.joint(name).id] for name in pose])


angles = st.floats(-180.0, 180.0)


@given(st.tuples(angles, st.sampled_from([-90.0, 90.0, 0.0, 37.0]), angles))
def test_angles_are_those_of_the_quaternion(degrees: Sequence[float]) -> None:
    quat = quaternion(",".join(map(str, degrees)))
    again = quaternion(",".join(str(math.degrees(angle)) for angle in rpy_of(quat)))
    same = abs(sum(a * b for a, b in zip(quat, again, strict=True)))
    assert same == pytest.approx(1.0, abs=1e-6)


def test_a_name_is_escaped() -> None:
    assert ElementTree.fromstring(urdf_of('a"<&', "")).get("name") == 'a"<&'
