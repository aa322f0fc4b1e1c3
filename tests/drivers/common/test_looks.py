"""A robot's looks are closed surfaces that are only drawn: physics is the same with and without them."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.common.physics.model_rows import LOOKS, build
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.scenery import Object, Scenery
from strands_actors.drivers.common.simulation_control.looks.dress import HIDDEN_GROUP, dress
from strands_actors.drivers.common.simulation_control.looks.outlines import (
    Outline,
    Station,
    ball,
    box,
    joined,
    mirrored,
    rod,
)
from strands_actors.drivers.common.simulation_control.looks.rows import parts
from strands_actors.drivers.common.simulation_control.scene import View, decorate
from strands_actors.drivers.feetech.robots import TABLES

STRAIGHT = rod([Station((0, 0, 0), (0.02, 0.03)), Station((0, 0, 0.2), (0.04, 0.01))])
BENT = rod(
    [Station((0, 0, 0), (0.02, 0.02)), Station((0.1, 0, 0.1), (0.03, 0.02), 4), Station((0.3, 0, 0), (0.01, 0.01))]
)
FLAT = rod([Station((0, 0.1, 0), (0.05, 0.05)), Station((0, -0.1, 0), (0.05, 0.05))], rounding=0.01, smooth=False)
BRICK = box((0.1, 0, 0), (0.05, 0.03, 0.02), 0.005)
EGG = ball((0, 0, 0), (0.01, 0.02, 0.03))


def volume(outline: Outline) -> float:
    """Return the volume inside a surface. It is negative if its triangles are clockwise."""
    a, b, c = (outline.points[outline.faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("outline", [STRAIGHT, BENT, FLAT, BRICK, EGG, mirrored(BENT), joined([BRICK, EGG])])
def test_a_surface_is_closed_and_its_triangles_face_outwards(outline: Outline) -> None:
    edges = {tuple(face[[i, (i + 1) % 3]].tolist()) for face in outline.faces for i in range(3)}
    assert len(edges) == 3 * len(outline.faces), "no edge is twice in the same direction"
    assert all((b, a) in edges for a, b in edges), "each edge has a triangle on both sides"
    assert volume(outline) > 0


def test_shapes_have_their_sizes() -> None:
    for outline, low, high in (
        (BRICK, (0.05, -0.03, -0.02), (0.15, 0.03, 0.02)),
        (EGG, (-0.01, -0.02, -0.03), (0.01, 0.02, 0.03)),
        (FLAT, (-0.05, -0.1, -0.05), (0.05, 0.1, 0.05)),
    ):
        assert outline.points.min(axis=0) == pytest.approx(low, abs=0.001)
        assert outline.points.max(axis=0) == pytest.approx(high, abs=0.001)
    assert volume(FLAT) == pytest.approx(math.pi * 0.05**2 * 0.2, rel=0.05)
    # A rod along z has its first half size along x, the second along y.
    assert np.abs(STRAIGHT.points[STRAIGHT.points[:, 2] < 0.05]).max(axis=0)[:2] == pytest.approx(
        (0.025, 0.03), abs=0.006
    )


def test_a_row_gives_a_part_to_each_of_its_bodies() -> None:
    left, right = parts("# a comment\nleft,~right white box 0,.1,0 .01,.02,.03 .001")
    assert (left.body, right.body, left.material) == ("left", "right", "white")
    assert left.outline.points[:, 1].mean() == pytest.approx(0.1, abs=0.01)
    assert right.outline.points[:, 1].mean() == pytest.approx(-0.1, abs=0.01)


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("base pink ball 0,0,0 .1", "there is no material pink"),
        ("base white cube 0,0,0 .1", "there is no shape cube"),
        ("base white rod 0,0,0 0,0,1:.1", "a station has 1 to 3 sizes: 0,0,0"),
        ("base white ball 0,0 .1", "a row of looks is wrong"),
        ("base", "a row of looks is wrong"),
    ],
)
def test_a_wrong_row_is_named(row: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as wrong:
        list(parts(row))
    assert row in str(wrong.value)


def test_physics_is_the_same_with_and_without_looks() -> None:
    table = TABLES.table("so101")
    assert table["looks"].strip()

    def fallen(looks: bool) -> tuple[Any, list[float]]:
        plant = Plant.from_table(table if looks else {key: value for key, value in table.items() if key != "looks"})
        plant.step(300)
        return plant.model, plant.data.qpos.tolist()

    (dressed, pose), (bare, bare_pose) = fallen(True), fallen(False)
    assert pose == bare_pose
    assert pose != Plant.from_table(table).data.qpos.tolist(), "the arm has fallen"
    assert (dressed.ngeom, dressed.nmesh, dressed.nbody) == (bare.ngeom, bare.nmesh, bare.nbody)


def test_looks_hide_the_shapes_of_physics_in_the_drawn_copy_only() -> None:
    spec = build(TABLES.table("so101"))
    spec.compile()
    drawn = decorate(spec, View((0.0, 0.0, 0.0), 1.0)).compile()
    meshes = drawn.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    links = drawn.geom_bodyid > 0
    assert meshes.sum() >= len(drawn.body_mass) - 1
    assert (drawn.geom_group[links & ~meshes] == HIDDEN_GROUP).all()
    assert not (drawn.geom_contype[meshes] | drawn.geom_conaffinity[meshes]).any()
    plain = spec.compile()
    assert plain.nmesh == 0
    assert not (plain.geom_group == HIDDEN_GROUP).any()
    assert drawn.body_mass.sum() == pytest.approx(plain.body_mass.sum())


def test_an_object_in_the_scene_stays_visible() -> None:
    plant = Plant.from_table(TABLES.table("so101"))
    cube = Object(
        "cube", "box", (1.0, 0.0, 0.1), (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 0.1), (1.0, 0.0, 0.0, 1.0), 0.1, False
    )
    Scenery(plant).add_object(cube)
    drawn = decorate(plant.spec, View((0.0, 0.0, 0.0), 1.0)).compile()
    assert int(drawn.geom("cube").group[0]) == 0
    assert HIDDEN_GROUP in drawn.geom_group


def test_a_model_without_looks_is_not_changed_and_a_foreign_body_is_named() -> None:
    spec = mujoco.MjSpec()
    assert not dress(spec)
    spec.add_text(name=LOOKS, data="tail white ball 0,0,0 .1")
    with pytest.raises(ValueError, match="the looks name a body 'tail' that the model does not have"):
        dress(spec)
