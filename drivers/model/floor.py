"""A floor for a model that has none, so that what is put into its scene does not fall for ever."""

from __future__ import annotations

from typing import Any

from strands_actors.drivers.common.lean_mujoco import PLAIN, mujoco

_TOUCHING_M = 1e-3
_OBJECTS = 2
"""Objects touch what has this bit, links (MuJoCo's default, 1) do not."""


def add_floor(spec: Any, model: Any) -> None:
    """Add one at height 0, or at the lowest point of what begins lower.

    The links of a robot that is mounted pass through it: they move as in MuJoCo, which knows no
    floor there. A robot that can fall, since its base is free, stands on it.
    """
    geoms = range(model.ngeom)
    flat = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
    if any(int(model.geom_type[geom]) in flat and not model.body_weldid[model.geom_bodyid[geom]] for geom in geoms):
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    lowest = min((_lowest_m(model, data, geom) for geom in geoms), default=0.0)
    falls = any(kind == mujoco.mjtJoint.mjJNT_FREE for kind in model.jnt_type)
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
    """Return the height of the lowest corner of the box around a shape."""
    down = data.geom_xmat[geom].reshape(3, 3)[2]
    middle, half = model.geom_aabb[geom][:3], model.geom_aabb[geom][3:]
    return float(data.geom_xpos[geom, 2] + down @ middle - abs(down) @ half)
