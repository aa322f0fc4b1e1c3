"""Compile the model of an arm, and decide which of its links may touch each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec
import numpy as np

from strands_actors.contract.arm_model import ArmModel
from strands_actors.contract.loading import load

from .request import Box

LEAN_MUJOCO = "strands_actors.drivers.common.physics.lean_mujoco"
"""Imports MuJoCo without OpenGL. Like a driver it is loaded by name, because drivers are below this module."""

mujoco: Any = load(f"{LEAN_MUJOCO}:mujoco")
PLAIN: Any = load(f"{LEAN_MUJOCO}:PLAIN")

Array = Any
"""A numpy array."""

Pair = tuple[int, int]
"""Two shapes of the model, by their index."""

KEEP_OUT = "strands_actors keep_out"
"""The names of the shapes of spaces that the arm may not enter begin so."""
SAMPLES = 1000
"""Number of random joint positions of which the nearest to a goal are starts of a search."""
OVERLAP_SAMPLES, OVERLAP_SHARE = 80, 0.3
"""Two links that touch in this share of random positions count as joined, since the shapes of a table are coarse.
Other motion planners leave out such pairs in the same way."""
ENDLESS = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
"""Shapes of a floor. A model's floor is not the one on which the real arm stands, so it does not count."""
WHOLE_TURN_RAD = math.pi
"""A joint without limits is searched from minus this to plus this."""


class Body(NamedTuple):
    """The compiled model of an arm. Nothing changes it.

    Attributes:
        spec: The model as it can be edited.
        model: The compiled model.
        tool: The tool in this model.
        pairs: Shapes of two links that may touch.
        moving: Shapes that a joint moves.
        samples: Random joint positions within the model's ranges, one in each row.
        places: The position of the tool in each of them.
        turns: The orientation of the tool there, as w, x, y, z.
    """

    spec: Any
    model: Any
    tool: Tool
    pairs: tuple[Pair, ...]
    moving: tuple[int, ...]
    samples: Array
    places: Array
    turns: Array


class Tool(NamedTuple):
    """The tool of an arm: a site, or a pose in the frame of a link."""

    link: int
    site: int | None
    xyz: Array
    quat: Array

    def pose(self, data: Any) -> tuple[Array, Array]:
        """Return position and orientation of the tool in the present positions of the links."""
        xyz, quat = np.zeros(3), np.zeros(4)
        if self.site is None:
            mujoco.mju_mulPose(xyz, quat, data.xpos[self.link], data.xquat[self.link], self.xyz, self.quat)
        else:
            xyz[:] = data.site_xpos[self.site]
            mujoco.mju_mat2Quat(quat, data.site_xmat[self.site])
        return xyz, quat


def body_of(arm: ArmModel) -> Body:
    """Return the compiled model of an arm. All plans of a process share it."""
    return _body_of(msgspec.json.encode(arm))


@lru_cache(maxsize=16)
def _body_of(encoded: bytes) -> Body:
    arm = msgspec.json.decode(encoded, type=ArmModel)
    joints, home = arm.joints, arm.home
    spec = load(arm.builder)(arm.table)
    model = spec.compile()
    site = model.site(arm.site).id if arm.site else None
    link = int(model.site_bodyid[site]) if site is not None else model.body(arm.link).id
    tool = Tool(link, site, np.array(arm.tool_xyz), np.array(arm.tool_quat))
    solid = [
        geom
        for geom in range(model.ngeom)
        if (model.geom_contype[geom] or model.geom_conaffinity[geom]) and int(model.geom_type[geom]) not in ENDLESS
    ]
    ids = [model.joint(name).id for name in joints]
    addresses = np.array([int(model.jnt_qposadr[joint]) for joint in ids])
    limited = model.jnt_limited[ids].astype(bool)
    low, high = (
        np.where(limited, model.jnt_range[ids, end], sign * WHOLE_TURN_RAD) for end, sign in ((0, -1), (1, 1))
    )
    samples = np.random.default_rng(0).uniform(low, high, (SAMPLES, len(ids)))
    data, pairs = mujoco.MjData(model), _separate(model, solid)
    counts = dict.fromkeys(pairs, 0)
    poses = []
    for number, rad in enumerate(samples):
        data.qpos[addresses] = rad
        mujoco.mj_kinematics(model, data)
        poses.append(tool.pose(data))
        for pair in pairs if number < OVERLAP_SAMPLES else ():
            counts[pair] += mujoco.mj_geomDistance(model, data, *pair, 1e-3, None) < 0
    data.qpos[addresses] = home or (low + high) / 2
    mujoco.mj_kinematics(model, data)
    kept = tuple(
        pair
        for pair in pairs
        if counts[pair] < OVERLAP_SHARE * OVERLAP_SAMPLES
        and (not home or mujoco.mj_geomDistance(model, data, *pair, 1e-3, None) >= 0)
    )
    moving = tuple(geom for geom in solid if model.body_weldid[model.geom_bodyid[geom]] != 0)
    places, turns = (np.array(rows) for rows in zip(*poses, strict=True))
    return Body(spec, model, tool, kept, moving, samples, places, turns)


def _separate(model: Any, solid: Sequence[int]) -> list[tuple[int, int]]:
    """Return the pairs of shapes of two links that no joint connects. Joined links overlap at their joint."""
    link_of = {geom: int(model.body_weldid[model.geom_bodyid[geom]]) for geom in solid}
    joined = {
        frozenset((link, int(model.body_weldid[model.body_parentid[link]]))) for link in link_of.values() if link
    }
    return [
        (first, second)
        for number, first in enumerate(solid)
        for second in solid[number + 1 :]
        if link_of[first] != link_of[second] and frozenset((link_of[first], link_of[second])) not in joined
    ]


def with_spaces(body: Body, keep_out: Sequence[Box]) -> tuple[Any, tuple[Pair, ...], tuple[Pair, ...]]:
    """Return the model with the spaces to keep out of, the pairs of its links, and its links with each space."""
    if not keep_out:
        return body.model, body.pairs, ()
    spec = body.spec.copy()
    for number, box in enumerate(keep_out):
        spec.worldbody.add_geom(
            default=PLAIN.default,
            name=f"{KEEP_OUT}{number}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=box.center,
            size=[edge / 2 for edge in box.size],
            contype=0,
            conaffinity=0,
        )
    # The shapes of the world come first, and these spaces are the last of them.
    first, count = int(body.model.body_geomnum[0]), len(keep_out)

    def moved(geom: int) -> int:
        return geom if geom < first else geom + count

    pairs = tuple((moved(one), moved(other)) for one, other in body.pairs)
    spaces = tuple((moved(geom), first + number) for geom in body.moving for number in range(count))
    return spec.compile(), pairs, spaces


__all__ = ["KEEP_OUT", "WHOLE_TURN_RAD", "Array", "Body", "Pair", "body_of", "mujoco", "with_spaces"]
