"""Build robot models from the rows of ``kinematics/link_rows``, with ``mujoco.MjSpec``. There is no model file and
no mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.drivers.common.kinematics.link_rows import Row, numbers, parse_rows

from .body import TIMESTEP_S
from .lean_mujoco import mujoco

LOOKS = "strands_actors looks"
"""Name of the text in which a model carries the table of its looks."""

LINK_EXTENT_M = 0.1
"""Gyration length of a link with a ``com``. It need not be exact, since the rotor's armature outweighs it."""


def build(table: Mapping[str, Any]) -> Any:
    """Build the model of a robot, as an ``MjSpec``.

    Every joint with an effort gets a position servo with the joint's name, limited to the joint's velocity. The
    class ``Plant`` sets the servo's gains.

    Args:
        table: The robot's table in ``robots.toml``. It has ``model_rows``, and may have ``base``, ``armature``,
            ``damping``, ``friction``, ``gravity_compensated`` (no gravity acts on the arm) and ``looks`` (a table
            for ``drivers/common/simulation_control/looks``, which the model carries as a text for those who draw
            it). With ``torque_motors`` each joint gets a motor instead of a servo; its torque is the control minus
            ``biasprm`` times position and velocity. A ``base`` that is ``free`` is not fixed to the world.
    """
    rows = parse_rows(table["model_rows"])
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP_S
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[2, 2, 0.1], contype=1, conaffinity=2
    )
    if "looks" in table:
        spec.add_text(name=LOOKS, data=table["looks"])
    base = table.get("base", {})
    bodies = {"base": spec.worldbody.add_body(name="base", pos=numbers(base.get("xyz", "0,0,0")))}
    if "geom" in base:
        _add_geom(bodies["base"], base["geom"], (), float(base.get("kg", 1.0)))
    if base.get("free"):
        bodies["base"].add_freejoint()
        _add_point_mass(bodies["base"], float(base["kg"]), numbers(base.get("com", "0,0,0")))
    for row in rows:
        body = bodies[row.parent].add_body(name=row.body, pos=row.xyz, quat=row.quat)
        body.gravcomp = 1.0 if table.get("gravity_compensated") else 0.0
        bodies[row.body] = body
        _add_mass(body, row, [child for child in rows if child.parent == row.body])
        if row.joint:
            _add_joint(spec, body, row, table)
    return spec


def _add_mass(body: Any, row: Row, children: Sequence[Row]) -> None:
    if row.geom:
        towards = children[0].xyz if children else ()
        _add_geom(body, row.geom, towards, row.kg)
    if row.com or not row.geom:
        _add_point_mass(body, row.kg, row.com or (0.0, 0.0, 0.0))


def _add_point_mass(body: Any, kg: float, com: tuple[float, ...]) -> None:
    body.explicitinertial = True
    body.mass = kg
    body.ipos = com
    body.inertia = [kg * LINK_EXTENT_M**2 / 12] * 3


def _add_geom(body: Any, text: str, towards: Sequence[float], kg: float) -> None:
    shape, _, place = text[1:].partition("@")
    sizes = (*numbers(shape), 0.0, 0.0)[:3]
    point = numbers(place) if place else tuple(towards)
    geom_type = {
        "c": mujoco.mjtGeom.mjGEOM_CAPSULE,
        "b": mujoco.mjtGeom.mjGEOM_BOX,
        "s": mujoco.mjtGeom.mjGEOM_SPHERE,
        "y": mujoco.mjtGeom.mjGEOM_CYLINDER,
    }[text[0]]
    # Links collide with the floor, but not with each other, because these coarse shapes overlap at every joint.
    geom = body.add_geom(type=geom_type, size=sizes, mass=kg, contype=2, conaffinity=1)
    if text[0] == "c":
        if not point:
            raise ValueError(f"capsule {text} of {body.name} has no end point. Add @x,y,z or a child link")
        geom.fromto = [0.0, 0.0, 0.0, *point]
    elif place:
        geom.pos = point


def _add_joint(spec: Any, body: Any, row: Row, table: Mapping[str, Any]) -> None:
    kinds = mujoco.mjtJoint
    joint = body.add_joint(
        name=row.joint,
        type=kinds.mjJNT_SLIDE if row.slide else kinds.mjJNT_HINGE,
        axis=row.axis,
        armature=float(table.get("armature", 0.0)),
        damping=float(table.get("damping", 0.0)),
        frictionloss=float(table.get("friction", 0.0)),
    )
    if row.limits:
        joint.limited = True
        joint.range = row.limits
    if row.effort is None:
        return
    servo = spec.add_actuator(name=row.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=row.joint)
    if table.get("torque_motors"):
        servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    else:
        servo.set_to_pid(kp=1.0, kv=1.0, slewmax=row.velocity or 0.0)
    servo.forcelimited = True
    servo.forcerange = [-row.effort, row.effort]
