"""Add a floor to a model without a floor, so that objects in its scene do not fall for ever."""

from __future__ import annotations

from typing import Any

from strands_actors.drivers.common.physics.lean_mujoco import PLAIN, mujoco

_TOUCHING_M = 1e-3
_OBJECTS = 2
"""Contact bit of objects. Links have MuJoCo's default bit, 1, and do not touch shapes with this one only."""


def add_floor(spec: Any, model: Any) -> None:
    """Add a floor at height 0, or at the lowest point of the model if that is lower.

    A robot whose base is fixed does not touch the floor, so it moves as in MuJoCo without a floor. A robot with a
    free base stands on the floor.
    """
    geoms = range(model.ngeom)
    flat = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
    if any(int(model.geom_type[geom]) in flat and not model.body_weldid[model.geom_bodyid[geom]] for geom in geoms):
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = min((_lowest_m(model, data, geom) for geom in geoms), default=0.0)
    falls = any(joint_type == mujoco.mjtJoint.mjJNT_FREE for joint_type in model.jnt_type)
    touches = _OBJECTS | 1 if falls else _OBJECTS
    spec.worldbody.add_geom(
        default=PLAIN.default,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        pos=[0, 0, lowest if lowest < -_TOUCHING_M else 0.0],
        contype=touches,
        conaffinity=touches,
    )


def _lowest_m(model: Any, data: Any, geom: int) -> float:
    """Return the height of the lowest corner of a shape's bounding box."""
    down = data.geom_xmat[geom].reshape(3, 3)[2]
    middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
    return float(data.geom_xpos[geom, 2] + down @ middle - abs(down) @ half)
